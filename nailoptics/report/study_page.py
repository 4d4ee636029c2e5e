"""The frame of a study's page: one self-contained HTML file with cards, figures, tables and what reproduces it."""

import html
from collections.abc import Iterable, Sequence
from importlib import resources
from typing import TYPE_CHECKING

from . import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def document(
    *,
    kicker: str,
    title: str,
    lead: str,
    cards: Iterable[tuple[str, str]],
    body: Iterable[str],
    provenance: dict[str, str],
    scene: str,
) -> str:
    """A whole page as text; body holds HTML, everything else plain words."""
    css = resources.files(__package__).joinpath("page.css").read_text(encoding="utf-8")
    rows = "".join(f"<div><dt>{_(name)}</dt><dd>{_(value)}</dd></div>" for name, value in provenance.items())
    parts = [
        f"<header><p class='kicker'>nailoptics · {_(kicker)}</p><h1>{_(title)}</h1><p class='lead'>{_(lead)}</p>",
        "<ul class='findings'>",
        *(f"<li><b>{_(figure)}</b><span>{_(words)}</span></li>" for figure, words in cards),
        "</ul></header>",
        *body,
        f"<section class='provenance'><h2>To make this again</h2><dl>{rows}</dl>",
        f"<details><summary>The scene, complete</summary><pre>{_(scene)}</pre></details></section>",
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{_(title)} – nailoptics</title><style>{css}</style></head>\n<body><main>\n"
        + "\n".join(parts)
        + "\n</main></body></html>\n"
    )


def drawing(figure: "Figure", name: str, caption: str) -> str:
    """A figure with its caption, as HTML."""
    svg = style.to_svg(figure, name=name, description=caption)
    return f'<figure><div class="scroll">{svg}</div><figcaption>{_(caption)}</figcaption></figure>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table as HTML: heads and cells are HTML, the first cell of a row heads it."""
    lines = ['<div class="scroll"><table><thead><tr>', *(f"<th>{title}</th>" for title in head), "</tr></thead><tbody>"]
    for first, *rest in rows:
        lines.append(f'<tr><th scope="row">{first}</th>' + "".join(f"<td>{cell}</td>" for cell in rest) + "</tr>")
    return "\n".join([*lines, "</tbody></table></div>"])


def provenance(attributes: dict) -> dict[str, str]:
    """What made a result, from its attributes."""
    names = {"digest": "Digest of the scene", "photons": "Photons", "seeds": "Seeds", "engine": "Engine"}
    names |= {"backend": "Backend", "versions": "Versions", "cpu_seconds": "Processor time [s]"}
    return {label: str(attributes[key]) for key, label in names.items() if key in attributes}


def _(text: object) -> str:
    return html.escape(str(text))
