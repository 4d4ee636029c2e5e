"""Names that attack a browser, and whether a page shows them as text."""

from html.parser import HTMLParser

HOSTILE = [
    "<script>alert(1)</script>$a_b^{c$ & <b>",
    '"><img src=x onerror=y>',
    "</title></svg><svg onload=z>",
    "'><i>",
]


class Tags(HTMLParser):
    """Every tag of a page, and every attribute that runs something."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.visible_text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [tag, *(name for name, _ in attrs if name.startswith("on"))]

    def handle_data(self, data: str) -> None:
        self.visible_text += data


def assert_text_alone(text: str, name: str) -> None:
    """The name is read on the page, and made nothing of it a tag."""
    page = Tags(text)
    assert not set(page.found) & {"script", "img", "i", "onerror", "onload"}, page.found
    assert name in page.visible_text
