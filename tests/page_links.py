"""Links of the built pages, and of the Markdown files beside them that Sphinx does not read."""

import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

MARKDOWN_LINK = re.compile(r"\]\(([^)\s]+)\)")


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.ids: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        of = dict(attrs)
        self.links += [link for name in ("href", "src") if (link := of.get(name))]
        self.ids |= {name for key in ("id", "name") if (name := of.get(key))}


@cache
def _page(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def broken_in_pages(html: Path) -> list[str]:
    """Links between the built pages whose file or place in it does not exist."""
    pages = sorted(html.rglob("*.html"))
    return [f"{path.relative_to(html)}: {link}" for path in pages for link in _page(path).links if _broken(path, link)]


def broken_in_markdown(file: Path, html: Path) -> list[str]:
    """The same of a Markdown file of the repository, whose pages of the documentation are built."""
    broken = []
    for link in MARKDOWN_LINK.findall(file.read_text(encoding="utf-8")):
        parts, source = urlsplit(link), file.parent / "docs"
        target = file.parent / unquote(parts.path)
        if parts.scheme or not parts.path:
            continue
        is_page = target.suffix == ".md" and target.is_relative_to(source)
        built = html / target.relative_to(source).with_suffix(".html") if is_page else target
        if not target.exists() or (is_page and _broken(built, f"#{parts.fragment}")):
            broken.append(f"{file.name}: {link}")
    return broken


def _broken(page: Path, link: str) -> bool:
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return False
    target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    if not target.exists():
        return True
    return bool(parts.fragment) and target.suffix == ".html" and unquote(parts.fragment) not in _page(target).ids
