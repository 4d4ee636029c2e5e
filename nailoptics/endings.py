"""How a command ends that does not end well: in one line, which tells what files there are, and an exit code."""

import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from cyclopts import CycloptsError

from .errors import NailopticsError
from .io import LIGHT, RESULT, abandon_files
from .terminal import silence_stdout, written_out


def interrupted(why: str, files: Iterable[tuple[str, Path]]) -> str:
    """What an interrupted command says: of its results those that are whole, and whether its light is kept."""
    results = list(dict.fromkeys(str(path) for what, path in files if what == RESULT))
    written = f"only these results were written: {', '.join(results)}." if results else "no result was written."
    light = " The light that was traced is kept for the next time." if any(what == LIGHT for what, _ in files) else ""
    return (why or f"interrupted; {written}") + light


def end_at_once(files: Iterable[tuple[str, Path]]) -> None:
    """End the process where it is, with a word on what is kept; no exception passes through compiled code."""
    abandon_files()
    cursor = "\x1b[?25h" if sys.stderr and sys.stderr.isatty() else ""  # a bar of progress hides it
    with suppress(OSError):
        os.write(2, f"{cursor}nailoptics: {written_out(interrupted('', files))}\n".encode(errors="replace"))
    os._exit(130)


def told(error: Exception) -> tuple[str, int]:
    """An error in one line, and the exit code."""
    match error:
        case CycloptsError():
            return f"{error} (nailoptics --help shows what is known)", 2
        case NailopticsError():
            return str(error), error.exit_code
        case OSError():
            silence_stdout()
            return f"{error.filename or 'the output'}: {error.strerror or error}.", 1
        case MemoryError():
            return "not enough memory; ask for fewer samples (touch.sample_rate_hz) or photons.", 1
    if os.environ.get("NAILOPTICS_DEBUG"):
        raise error
    what = f"{type(error).__name__}: {error}"
    return f"internal error, our fault: {what} (NAILOPTICS_DEBUG=1 shows where; please report it)", 1
