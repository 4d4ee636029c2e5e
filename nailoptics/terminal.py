"""The terminal and the files around a command: messages, progress, Ctrl-C, JSON, folders that results go to."""

import json
import logging
import math
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import InputError, NotReachedError
from .io import held

if TYPE_CHECKING:
    from .light import Progress


def complain(line: str, code: int) -> int:
    """Say it in one line on stderr; hands the exit code back."""
    print(f"nailoptics: {' '.join(line.split())}", file=sys.stderr)
    return code


def silence_stdout() -> None:
    """Nothing more can be written there, and Python must not try when it ends."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError, AttributeError):  # no real file, as under a test
        pass


@contextmanager
def plain_messages() -> Iterator[None]:
    """Our own warnings become one line each on stderr; what other packages say is for NAILOPTICS_DEBUG only."""
    debug = bool(os.environ.get("NAILOPTICS_DEBUG"))

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None, line: Any = None
    ) -> None:
        if category.__module__.startswith("nailoptics"):
            complain(str(message), 0)
        elif debug:
            complain(f"{filename}:{lineno}: {category.__name__}: {message}", 0)

    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("nailoptics: %(message)s"))
    handler.setLevel(logging.WARNING)
    handler.addFilter(lambda record: debug or record.name.startswith("nailoptics"))
    logging.getLogger().addHandler(handler)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show
            yield
    finally:
        logging.getLogger().removeHandler(handler)


@contextmanager
def writable(folder: Path, *files: str) -> Iterator[Path]:
    """The folder, made if need be, and taken away again if nothing came to lie in it, of this command or another.

    Raises: InputError before any work is done if nothing can be written there.
    """
    made: list[Path] = []
    try:
        with suppress(OSError):  # a name too long, say; then nothing can be made either
            made = [path for path in (folder, *folder.parents) if not path.exists()]
        with held(folder):
            for name in files:
                if (folder / name).is_dir():
                    raise InputError(f"{folder / name}: is a folder where a file is to be written; choose another.")
            yield folder
    finally:
        for path in made:
            try:
                path.rmdir()
            except OSError:  # something lies in it, or it was never made
                pass


@contextmanager
def writable_file(path: Path | None) -> Iterator[None]:
    """The same for a file, if there is one to write."""
    if path is None:
        yield
        return
    with writable(path.parent, path.name):
        yield


def as_far_as_reached(work: Callable[[Any], Any]) -> tuple[Any, NotReachedError | None]:
    """What work(progress) returns, or what it had when time or Ctrl-C ended it, and the reason."""
    try:
        with progress() as told:
            return work(told), None
    except NotReachedError as error:
        if error.result is None:
            raise
        return error.result, error


@contextmanager
def progress() -> Iterator[Any]:
    """A progress callback that shows how far a trace is, and hears Ctrl-C."""
    with _shown() as show, _interrupts() as interrupted:

        def told(p: "Progress") -> None:
            show(p)
            if interrupted():
                raise KeyboardInterrupt

        yield told


@contextmanager
def _interrupts() -> Iterator[Any]:
    """Whether Ctrl-C was pressed, which is asked between batches; a second one ends everything at once.

    Compiled code turns an interrupt into errors of its own, and what was traced would be lost.
    """
    pressed: list[int] = []

    def note(number: int, frame: Any) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        pressed.append(number)
        complain("stopping after this batch; press Ctrl-C again to stop at once.", 0)

    try:
        before = signal.signal(signal.SIGINT, note)
    except ValueError:  # not the main thread
        yield lambda: False
        return
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _shown() -> Iterator[Any]:
    """Shows progress: a bar with time left on a terminal, a line every ten seconds elsewhere."""
    if not (sys.stderr and sys.stderr.isatty()):
        told: dict[str, float] = {}

        def log_line(p: "Progress") -> None:
            done = p.fraction_done >= 1
            if p.seconds - told.get(p.led, 0.0) < 10 and not done or told.get(p.led) == math.inf:
                return
            told[p.led] = math.inf if done else p.seconds
            when = f"{p.seconds:.0f} s" if done else f"{p.seconds_left:.0f} s left"
            complain(f"LED {p.led}, {_told(p)}, {when}", 0)

        yield log_line
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[told]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=Console(stderr=True)) as bar:
        tasks: dict[str, Any] = {}

        def show(p: "Progress") -> None:
            if p.led not in tasks:
                tasks[p.led] = bar.add_task(f"LED {p.led}", total=1.0, told="")
            bar.update(tasks[p.led], completed=p.fraction_done, told=_told(p))

        yield show


def _told(p: "Progress") -> str:
    error = f"error {p.relative_error:.2%}" if p.relative_error < 1 else "error not known yet"
    return error + (f" ({p.target:.2%} asked)" if p.target else "")


@contextmanager
def batch_progress() -> Iterator[Any]:
    """The same over scenes: a bar with time left, or a line every ten seconds; failures as they come."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True, soft_wrap=True)
    live = bool(sys.stderr and sys.stderr.isatty())
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    last = 0.0
    with Bar(*columns, console=console, disable=not live) as bar:
        task = bar.add_task("", total=None)

        def show(p: Any) -> None:
            nonlocal last
            left = "" if p.seconds_left is None else f", {p.seconds_left:.0f} s left"
            bar.update(task, completed=p.done + p.failed, total=p.total, description=left[2:])
            if p.said:
                bar.console.print(f"nailoptics: {p.said}", markup=False, highlight=False)
            elif not live and p.seconds - last >= 10:
                last = p.seconds
                failed = f", {p.failed} failed" if p.failed else ""
                print(f"nailoptics: {p.done} of {p.total} scenes{failed}{left}", file=sys.stderr, flush=True)

        yield show


def print_json(value: Any) -> None:
    print(json.dumps(finite(value), indent=2, allow_nan=False))


def finite(value: Any) -> Any:
    """JSON has neither NaN nor infinity: what is not known is null."""
    if isinstance(value, dict):
        return {name: finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    return float(value) if math.isfinite(value) else None
