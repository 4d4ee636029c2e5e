"""The pages are built, and every notebook among them runs, with few photons."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.long
@pytest.mark.jit
def test_all_pages_build_and_their_notebooks_run(tmp_path, chosen_jit, shared_light):
    """With warnings as errors, of which an exception in a cell is one; each page of the gallery that is run draws."""
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-j",
        "auto",
        str(DOCS),
        str(tmp_path / "html"),
    ]
    environment = os.environ | {"NAILOPTICS_DOCS": "quick"}
    built = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    for page in (page for page in (DOCS / "gallery").glob("*.md") if "quick: false" not in page.read_text()):
        downloaded = tmp_path / "html/_downloads/gallery" / f"{page.stem}.ipynb"
        cells = json.loads(downloaded.read_text(encoding="utf-8"))["cells"]
        drawn = [one for cell in cells for one in cell.get("outputs", []) if "image/png" in one.get("data", {})]
        assert drawn, page.name
