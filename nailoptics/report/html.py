"""What all pages are made of: one self-contained HTML document, its sections, figures and tables."""

import base64
import hashlib
import html
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any
from unicodedata import category

from . import style
from .numbers import significant

# Unicode's categories of invisible characters: they control, turn the writing round, or are no text at all.
INVISIBLE = ("Cc", "Cf", "Cs")


class Html(str):
    """Text that is HTML already; any other is escaped where it comes onto a page."""


class Script(str):
    """JavaScript that runs at the end of a page; no other does, nor does a page load anything unless it is served."""

    is_served = False  # whether it may read from the server that its page comes from


def texts(page: str) -> dict[str, Any]:
    """The longer texts and the tables of words of a page, by their names in texts.toml."""
    return {name: " ".join(text.split()) if isinstance(text, str) else text for name, text in _PAGES[page].items()}


@cache
def file_text(name: str) -> str:
    """The text of a file of the report, by its path from here."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


_PAGES = tomllib.loads(file_text("pages/texts.toml"))
# What makes a result again, by its attributes.
PROVENANCE = texts("provenance")


def document(
    *,
    kicker: str,
    title: str,
    lead: str,
    body: Iterable[str],
    attributes: Mapping[str, Any],
    warnings: str | Iterable[str] = (),
    cards: Sequence[tuple[str, str]] = (),
) -> str:
    """A whole page as text; body is HTML and scripts, everything else plain words.

    attributes : of the result, from which the page says what makes it again, and whether it was cut off.
    cards : figures in large type, each with what it is.
    """
    template, css = (file_text(f"page.{kind}") for kind in ("html", "css"))
    body = list(body)
    scripts = [part for part in body if isinstance(part, Script)]
    # A file keeps a list of one text as that text.
    warnings = [warnings] if isinstance(warnings, str) else warnings
    cut_off = [f"Cut off: {attributes['cut_off']}"] if attributes.get("cut_off") else []
    items = [f"<li><b>{escaped(number)}</b><span>{escaped(words)}</span></li>" for number, words in cards]
    parts = [
        f"<header><p class='kicker'>nailoptics · {escaped(kicker)}</p><h1>{escaped(title)}</h1>",
        paragraph(lead, kind="lead"),
        *(paragraph(line, kind="warning") for line in (*cut_off, *warnings)),
        *(["<ul class='findings'>", *items, "</ul>"] if items else []),
        "</header>",
        *(part for part in body if not isinstance(part, Script)),
        _provenance(attributes),
        *(f"<script>{script}</script>" for script in scripts),
    ]
    main = "\n".join(part for part in parts if part)
    # What a browser may do on the page: run its scripts, show what is in it, and read from the server of a served one.
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes) or "'none'"
    policy = f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:"
    policy += "; connect-src 'self'" if any(script.is_served for script in scripts) else ""
    policy += "; base-uri 'none'; form-action 'none'"
    return template.format(policy=policy, title=escaped(title), css=css, main=main)


def section(heading: str, *content: str) -> Html:
    """A part of a page under a heading; text that is no HTML is a paragraph, and what is empty is left out."""
    parts = [item if isinstance(item, Html) else paragraph(item) for item in content if item]
    return Html("\n".join([f"<section><h2>{escaped(heading)}</h2>", *parts, "</section>"]))


def subheading(text: str) -> Html:
    """A heading within a section."""
    return Html(f"<h3>{escaped(text)}</h3>")


def paragraph(text: str, *, kind: str = "") -> Html:
    """A paragraph; kind : its class in the style sheet."""
    return Html(f"<p class='{kind}'>{escaped(text)}</p>" if kind else f"<p>{escaped(text)}</p>")


def preformatted(text: object) -> Html:
    """Lines as they are, in a font of one width."""
    return Html(f"<pre>{escaped(text)}</pre>")


def small(text: str) -> Html:
    """A paragraph in small type, for notes; empty without a text."""
    return paragraph(text, kind="small") if text else Html()


def details(summary: str, *content: Html) -> Html:
    """What is shown once its summary is opened."""
    return Html("\n".join([f"<details><summary>{escaped(summary)}</summary>", *content, "</details>"]))


def figure(drawing: "style.Figure", caption: str, *, narrow: bool = False) -> Html:
    """A figure with its caption."""
    svg, kind = style.to_svg(drawing, description=caption), ' class="narrow"' if narrow else ""
    return Html(f'<figure{kind}><div class="scroll">{svg}</div><figcaption>{escaped(caption)}</figcaption></figure>')


def image(data: bytes, caption: str) -> Html:
    """A picture inside the page."""
    source = f"data:image/png;base64,{base64.b64encode(data).decode()}"
    alt = escaped(caption)
    return Html(f'<figure><img alt="{alt}" src="{source}"><figcaption>{alt}</figcaption></figure>')


def table(rows: Sequence[Mapping[str, object]], *, kind: str = "", groups: Sequence[str] | None = None) -> Html:
    """A table of records with the same keys, which are the heads, units below; the first cell of each heads its row.

    kind : its class in the style sheet.
    groups : what each row belongs to; where that is not the same for all, each group has a heading.
    """
    opening, head = f'<table class="{kind}">' if kind else "<table>", list(rows[0]) if rows else []
    heads = (f"<th>{escaped(title).replace(' [', '<br>[')}</th>" for title in head)
    lines = [f'<div class="scroll">{opening}<thead><tr>', *heads, "</tr></thead><tbody>"]
    shown = groups[0] if groups and len(set(groups)) == 1 else None
    for i, row in enumerate(rows):
        if groups and groups[i] != shown:
            shown = groups[i]
            lines.append(f'<tr class="group"><th colspan="{len(head)}">{escaped(shown)}</th></tr>')
        first, *rest = map(escaped, row.values())
        lines.append(f'<tr><th scope="row">{first}</th>' + "".join(f"<td>{cell}</td>" for cell in rest) + "</tr>")
    return Html("\n".join([*lines, "</tbody></table></div>"]))


def escaped(text: object) -> Html:
    """Plain words as HTML; invisible characters, such as one that turns the writing round, are written out."""
    if isinstance(text, Html):
        return text
    shown = (c if c in "\n\t" or category(c) not in INVISIBLE else ascii(c)[1:-1] for c in str(text))
    return Html(html.escape("".join(shown)))


def _provenance(attributes: Mapping[str, Any]) -> str:
    known = {label: attributes[name] for name, label in PROVENANCE.items() if name in attributes}
    shown = {label: significant(value) if isinstance(value, float) else value for label, value in known.items()}
    lines = [f"<div><dt>{label}</dt><dd>{escaped(value)}</dd></div>" for label, value in shown.items()]
    lines = ["<section class='provenance'><h2>Reproduce this result</h2><dl>", *lines, "</dl>"]
    if "scene" in attributes:
        lines.append(details("The scene, complete", preformatted(attributes["scene"])))
    return "\n".join([*lines, small("Terms and symbols: docs/glossary.md in the repository."), "</section>"])
