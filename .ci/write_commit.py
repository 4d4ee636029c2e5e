"""What the wheel and the sdist carry besides the code: the commit that they were built from, where that is known."""

import runpy
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class WriteCommit(BuildHookInterface):
    """Adds `nailoptics/_commit.txt`, which `nailoptics.version` reads."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before it builds; an editable install reads its clone."""
        commit = runpy.run_path(str(Path(self.root) / "nailoptics/version.py"))["commit"]()
        if commit is None or version == "editable" or (Path(self.root) / "nailoptics/_commit.txt").is_file():
            return
        self.folder = tempfile.TemporaryDirectory()
        written = Path(self.folder.name) / "_commit.txt"
        written.write_text(f"{commit}\n", encoding="utf-8")
        build_data["force_include"][str(written)] = "nailoptics/_commit.txt"
