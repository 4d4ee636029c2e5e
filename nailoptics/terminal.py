"""The terminal around a command: messages, progress, Ctrl-C and JSON."""

import logging
import math
import os
import select
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from io import BufferedReader, RawIOBase, TextIOWrapper
from typing import TYPE_CHECKING, Any, TextIO

from .errors import InputError
from .io import to_json

if TYPE_CHECKING:
    from .batch import BatchProgress
    from .light import TraceProgress

# Time between two lines of progress in a log. [s]
LOG_EVERY_S = 10.0
# A wait for input is broken off so often to look for a Ctrl-C. [s]
WAIT_S = 0.5
# Each Ctrl-C that asked this command to end after its batch.
_ASKED: list[int] = []


def say(line: str) -> None:
    """Say it in one line on stderr."""
    print(f"nailoptics: {written_out(' '.join(line.split()))}", file=sys.stderr, flush=True)


def written_out(text: str, *, lines: bool = False) -> str:
    """The text, in which what would steer a terminal, such as a name that clears it, is written out as in Python.

    lines : whether it may have several; else a line break is written out, too.
    """
    return "".join(c if c.isprintable() or (lines and c == "\n") else ascii(c)[1:-1] for c in text)


def silence_stdout() -> None:
    """Nothing more can be written there, and Python must not try when it ends."""
    with suppress(OSError, ValueError, AttributeError):  # no real file, as under a test
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def text_lines(stream: TextIO | None) -> Iterator[str]:
    """The lines of a stream as they come, whatever bytes they hold; raises InputError where it cannot be read."""
    if stream is None:
        raise InputError("stdin is closed; pipe a recording into it.")
    if isinstance(stream, TextIOWrapper):
        whole = stream.buffer if sys.platform == "win32" else BufferedReader(_Waiting(stream.fileno()))
        stream = TextIOWrapper(whole, encoding="utf-8", errors="replace")
    try:
        yield from stream
    except OSError as error:
        raise InputError(f"stdin: cannot be read: {error.strerror}; pipe a recording into it.") from None


class _Waiting(RawIOBase):
    """Bytes as they come, waited for in short turns: an interrupt that comes just before a wait is seen after it."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        while not select.select([self._descriptor], [], [], WAIT_S)[0]:
            pass
        return os.readv(self._descriptor, [buffer])


class _Plain(logging.Formatter):
    """Messages in which names steer no terminal; only a traceback, for NAILOPTICS_DEBUG, has lines."""

    def format(self, record: logging.LogRecord) -> str:
        return written_out(super().format(record), lines=bool(record.exc_info))


@contextmanager
def plain_messages() -> Iterator[None]:
    """Our own warnings become one line each on stderr; what other packages say is for NAILOPTICS_DEBUG only."""
    debug = bool(os.environ.get("NAILOPTICS_DEBUG"))

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None, line: Any = None
    ) -> None:
        if category.__module__.startswith("nailoptics"):
            say(str(message))
        elif debug:
            say(f"{filename}:{lineno}: {category.__name__}: {message}")

    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Plain("nailoptics: %(message)s"))
    handler.setLevel(logging.WARNING)
    handler.addFilter(lambda record: debug or record.name.startswith("nailoptics"))
    said: set[str] = set()

    def is_new(record: logging.LogRecord) -> bool:
        line, count = record.getMessage(), len(said)
        said.add(line)
        return len(said) > count

    handler.addFilter(is_new)
    logging.getLogger().addHandler(handler)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show
            yield
    finally:
        logging.getLogger().removeHandler(handler)


@contextmanager
def kept_warnings() -> Iterator[list[str]]:
    """Our own warnings meanwhile, each once; they are lines on stderr only where an error ends this."""
    lines: dict[str, None] = {}

    class Keeper(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            lines[record.getMessage()] = None

    ours, keeper, found = logging.getLogger("nailoptics"), Keeper(logging.WARNING), list[str]()
    ours.addHandler(keeper)
    ours.propagate = False
    try:
        yield found
    except Exception:
        for line in lines:
            say(line)
        raise
    finally:
        ours.removeHandler(keeper)
        ours.propagate = True
        found += lines


@contextmanager
def trace_progress() -> "Iterator[Callable[[TraceProgress], None]]":
    """A callback that shows how far a trace is, and raises KeyboardInterrupt after Ctrl-C."""
    with _display() as show, soft_interrupts() as interrupted:

        def report_progress(p: "TraceProgress") -> None:
            form = "{:.2g} " + p.unit if p.unit else "{:.2%}"
            known = p.relative_error < (math.inf if p.unit else 1)
            error = f"error {form.format(p.relative_error)}" if known else "error not known yet"
            target = f" ({form.format(p.target)} requested)" if p.target else ""
            name, text = (p.led if p.is_stage else f"LED {p.led}"), error + target
            if p.is_stage and not (known or p.target):
                text = f"{p.fraction_done:.0%} done"
            show(_State(name, text, p.fraction_done, p.seconds, p.seconds_left))
            if interrupted():
                raise KeyboardInterrupt

        yield report_progress


@contextmanager
def batch_progress() -> "Iterator[Callable[[BatchProgress], None]]":
    """A callback that shows how many scenes of a batch are done, and its news as it comes."""
    with _display() as show:

        def report_progress(p: "BatchProgress") -> None:
            failed = f", {p.failed} failed" if p.failed else ""
            text = f"{p.done} of {p.total} scenes{failed}"
            show(_State("batch", text, (p.done + p.failed) / max(p.total, 1), p.seconds, p.seconds_left, p.news))

        yield report_progress


class StopAtOnce(BaseException):
    """A second Ctrl-C, after which nothing is finished; studies keep what they have at a KeyboardInterrupt."""


@contextmanager
def hard_interrupts(end_at_once: Callable[[], None] | None = None) -> Iterator[Callable[[], bool]]:
    """Ctrl-C raises KeyboardInterrupt, and StopAtOnce where another asked before to end after a batch.

    Yields whether it did: imports and compiled code make other errors of it.

    end_at_once : called first where StopAtOnce would be raised, of which compiled code may make a crash.
    """
    pressed: list[int] = []
    _ASKED.clear()

    def end(number: int, frame: Any) -> None:
        pressed.append(number)
        if _ASKED and end_at_once:
            end_at_once()
        raise StopAtOnce if _ASKED else KeyboardInterrupt

    with _on_interrupt(end):
        yield lambda: bool(pressed)


@contextmanager
def soft_interrupts() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C was pressed, now or earlier so in this command; a second one ends everything at once.

    Compiled code turns an interrupt into errors of its own, and what was traced would be lost.
    """
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: Any) -> None:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)
        _ASKED.append(number)
        say("stopping after this batch; press Ctrl-C again to stop at once.")

    with nullcontext() if _ASKED else _on_interrupt(note):
        yield lambda: bool(_ASKED)


@contextmanager
def _on_interrupt(handler: Callable[[int, Any], None]) -> Iterator[None]:
    """Ctrl-C is handled so; not where this process is to ignore it, as in the background of a script."""
    before = signal.getsignal(signal.SIGINT)
    if before == signal.SIG_IGN or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@dataclass(frozen=True)
class _State:
    """How far one thing is; news is a line that is shown at once and stays."""

    name: str
    text: str
    share: float
    seconds: float
    seconds_left: float | None
    news: str = ""

    def words(self) -> str:
        """How far it is, and the time left while it is known and not over."""
        known = self.seconds_left is not None and self.seconds_left < math.inf and self.share < 1
        return f"{self.text}, {self.seconds_left:.0f} s left" if known else self.text


@contextmanager
def _display() -> Iterator[Callable[[_State], None]]:
    """Shows progress: bars on a terminal, a line every ten seconds and one at the end elsewhere."""
    if not (sys.stderr and sys.stderr.isatty()):
        logged: dict[str, float] = {}

        def log_line(state: _State) -> None:
            if state.news:
                say(state.news)
            done, last = state.share >= 1, logged.get(state.name, 0.0)
            if not math.isinf(last) and (done or state.seconds - last >= LOG_EVERY_S):
                logged[state.name] = math.inf if done else state.seconds
                say(f"{state.name}, {state.words()}" + (f", {state.seconds:.0f} s" if done else ""))

        yield log_line
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[words]}"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True, soft_wrap=True)) as bars:
        tasks: dict[str, Any] = {}

        def draw(state: _State) -> None:
            if state.name not in tasks:
                tasks[state.name] = bars.add_task(state.name, total=1.0, words="")
            bars.update(tasks[state.name], completed=state.share, words=state.words())
            if state.news:
                bars.console.print(f"nailoptics: {written_out(state.news)}", markup=False, highlight=False)

        yield draw


def print_json(value: Any, *, indent: int = 2) -> None:
    """Print a value as JSON on stdout."""
    print(to_json(value, indent=indent))
