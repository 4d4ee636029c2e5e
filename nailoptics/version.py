"""Which version and, where it is known, which commit this code is of; the build runs this file alone."""

import subprocess
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path

__version__ = "0.3.0.dev0"  # between releases it ends in .dev0

_ROOT = Path(__file__).resolve().parents[1]
# Written into wheels and sdists as they are built.
_BUILT_FROM = Path(__file__).resolve().with_name("_commit.txt")


def code_versions(*packages: str) -> dict[str, str]:
    """Versions of this code, of which an editable installation may state an older one, and of packages."""
    return {"nailoptics": __version__} | {name: metadata.version(name) for name in packages}


def code_attributes(versions: Mapping[str, str] | None = None) -> dict[str, str]:
    """Attributes of a result that say which code made it: versions and, where it is known, the commit.

    versions : of packages; of nailoptics and NumPy if not given, for what traces no light of its own.
    """
    numbers = versions or code_versions("numpy")
    attributes = {"versions": " ".join(f"{name}={number}" for name, number in numbers.items())}
    return attributes | ({"commit": known} if (known := commit()) else {})


@cache
def commit() -> str | None:
    """The commit of the clone that this code runs from or was built from; None where neither is known.

    Changes in the clone that were not committed are not reported.
    """
    try:
        if _BUILT_FROM.is_file():
            return _BUILT_FROM.read_text(encoding="utf-8").strip()
        if (_ROOT / ".git").exists():
            # Said so, git does not look for a repository: nor at GIT_DIR, nor whether the folder is another user's.
            command = ["git", "--git-dir", str(_ROOT / ".git"), "rev-parse", "HEAD"]
            return subprocess.run(command, capture_output=True, encoding="utf-8", check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        pass
    return None
