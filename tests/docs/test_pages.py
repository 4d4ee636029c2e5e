"""The pages are built, and every notebook among them runs, with few photons."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from page_links import broken_in_markdown, broken_in_pages

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.long
@pytest.mark.jit
def test_all_pages_build_and_their_notebooks_run(tmp_path, chosen_jit, coarse_cells, store):
    """With warnings as errors, of which an exception in a cell is one; each page of the gallery that is run draws."""
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        str(DOCS),
        str(tmp_path / "html"),
    ]
    environment = os.environ | {"NAILOPTICS_DOCS": "quick"}
    built = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    assert len(list((tmp_path / "html").rglob("*.html"))) > 20 and not broken_in_pages(tmp_path / "html")
    for name in ("README.md", "CHANGELOG.md"):
        assert not broken_in_markdown(DOCS.parent / name, tmp_path / "html")
    for page in (DOCS / "gallery").glob("*.md"):
        downloaded = tmp_path / "html/_downloads/gallery" / f"{page.stem}.ipynb"
        cells = json.loads(downloaded.read_text(encoding="utf-8"))["cells"]
        drawn = [one for cell in cells for one in cell.get("outputs", []) if "image/png" in one.get("data", {})]
        assert drawn, page.name


def test_a_broken_link_is_detected(tmp_path):
    html, readme = tmp_path / "html", tmp_path / "README.md"
    html.mkdir()
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/a.md").touch()
    (html / "a.html").write_text(
        '<h1 id="here">A</h1><a href="#here">x</a><a href="b.html#gone">y</a><img src="c.png">'
    )
    (html / "b.html").write_text('<a href="a.html#here">x</a><a href="https://example.org/none">y</a>')
    assert broken_in_pages(html) == ["a.html: b.html#gone", "a.html: c.png"]
    readme.write_text("[a](docs/a.md) [b](docs/a.md#here) [c](docs/a.md#gone) [d](docs/b.md) [e](https://example.org)")
    assert broken_in_markdown(readme, html) == ["README.md: docs/a.md#gone", "README.md: docs/b.md"]
