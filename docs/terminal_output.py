"""Write what the commands of tutorials print below them, as blocks of the language `output`.

    python docs/terminal_output.py docs/tutorials/tradeoff.md ...

Each page is followed in a folder of its own with the photons that it names, as the tests follow it
with few. Warnings and progress, which go to standard error, are left out.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

# A fenced block, with the output that follows it, if any.
BLOCK = re.compile(
    r"^```(?:\{code-block\} )?(?P<language>\w+)\n(?::caption: (?P<file>\S+)\n)?(?P<text>.*?)^```$"
    r"(?P<output>\n\n```output\n.*?^```$)?",
    re.M | re.S,
)


def printed(page: str, folder: Path) -> str:
    """The page with the present output below each block that prints something."""
    python: list[str] = []

    def followed(block: re.Match[str]) -> str:
        fenced = block[0].removesuffix(block["output"] or "")
        if block["file"]:
            (folder / block["file"]).write_text(block["text"], encoding="utf-8")
            return fenced
        if block["language"] == "sh":
            text = run(["bash", "-c", block["text"]], folder)
        elif block["language"] == "python":
            text = run([sys.executable, "-c", "\n".join([*python, "print('\\f')", block["text"]])], folder)
            text = text.rpartition("\f\n")[2]
            python.append(block["text"])
        else:
            return block[0]
        return f"{fenced}\n\n```output\n{text}```" if text.strip() else fenced

    return BLOCK.sub(followed, page)


def run(command: list[str], folder: Path) -> str:
    """What a command prints to standard output."""
    ended = subprocess.run(command, cwd=folder, env=os.environ | {"COLUMNS": "110"}, capture_output=True, text=True)
    print(ended.stderr[-2000:], file=sys.stderr)
    return "".join(f"{line.rstrip()}\n" for line in ended.stdout.split("\n")).strip("\n") + "\n"


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]):
        with tempfile.TemporaryDirectory() as folder:
            path.write_text(printed(path.read_text(encoding="utf-8"), Path(folder)), encoding="utf-8")
