"""The terminal around a command: messages, Ctrl-C, progress and results."""

import logging
import math
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from .errors import InputError, NotReachedError, as_far_as_reached
from .io import to_json
from .options import TraceOptions

if TYPE_CHECKING:
    from .batch import BatchProgress
    from .light import TraceProgress
    from .report.files import Report

# Time between two lines of progress in a log. [s]
LOG_EVERY_S = 10.0
# Of --max-seconds, the part that is left for starting and for writing the results; the rest bounds the tracing.
RESERVE = 0.1


def say(line: str) -> None:
    """Print one line on stderr."""
    print(f"nailoptics: {escaped(' '.join(line.split()))}", file=sys.stderr, flush=True)


def escaped(text: str, *, lines: bool = False) -> str:
    """The text with what would steer a terminal, such as a name that clears it, escaped as in Python.

    lines : whether it may have several; else a line break is escaped, too.
    """
    return "".join(c if c.isprintable() or (lines and c == "\n") else ascii(c)[1:-1] for c in text)


def silence_stdout() -> None:
    """Write nothing more there; Python must not try when it ends."""
    with suppress(OSError, ValueError, AttributeError):  # no real file, as under a test
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def text_lines(stream: TextIO | None) -> Iterator[str]:
    """The lines of a stream as they come, whatever bytes they hold; raises InputError where it cannot be read."""
    if stream is None:
        raise InputError("stdin is closed; pipe a recording into it.")
    if isinstance(stream, TextIOWrapper):
        stream.reconfigure(encoding="utf-8", errors="replace")
    try:
        yield from stream
    except OSError as error:
        raise InputError(f"stdin: cannot be read: {error.strerror}; pipe a recording into it.") from None


class _Lines(logging.Handler):
    """Each message of the log once, from warnings on."""

    def __init__(self, show: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self.lines, self.show = list[str](), show

    def emit(self, record: logging.LogRecord) -> None:
        if (line := record.getMessage()) not in self.lines:
            self.lines.append(line)
            self.show(line)


@contextmanager
def plain_messages() -> Iterator[None]:
    """Our own warnings become one line each on stderr; those of other packages are for NAILOPTICS_DEBUG only."""
    debug, log, handler = bool(os.environ.get("NAILOPTICS_DEBUG")), logging.getLogger(), _Lines(say)

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None, line: Any = None
    ) -> None:
        if category.__module__.startswith("nailoptics"):
            say(str(message))
        elif debug:
            say(f"{filename}:{lineno}: {category.__name__}: {message}")

    handler.addFilter(lambda record: debug or record.name.startswith("nailoptics"))
    log.addHandler(handler)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show
            yield
    finally:
        log.removeHandler(handler)


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Our own warnings meanwhile, each once; they are lines on stderr only where an error ends this."""
    ours, collector = logging.getLogger("nailoptics"), _Lines(lambda line: None)
    ours.addHandler(collector)
    ours.propagate = False
    try:
        yield collector.lines
    except Exception:
        for line in collector.lines:
            say(line)
        raise
    finally:
        ours.removeHandler(collector)
        ours.propagate = True


@contextmanager
def counted() -> Iterator[list[int]]:
    """Every Ctrl-C meanwhile; each raises KeyboardInterrupt, of which imports and compiled code make other errors."""
    pressed: list[int] = []

    def interrupt(number: int, frame: Any) -> None:
        pressed.append(number)
        raise KeyboardInterrupt

    with _handled_by(interrupt):
        yield pressed


@contextmanager
def interruptible() -> Iterator[Callable[[], None]]:
    """A check for between batches that raises KeyboardInterrupt after a first Ctrl-C; a second raises it at once."""
    pressed: list[int] = []
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: Any) -> None:
        pressed.append(number)
        signal.signal(signal.SIGINT, before)
        say("stopping after this batch; press Ctrl-C again to stop at once.")

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    with _handled_by(note):
        yield check


@contextmanager
def _handled_by(handler: Callable[[int, Any], None]) -> Iterator[None]:
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


# Shows how far something is: its name, a text, the fraction done, seconds passed and left, and a line that stays.
_Show = Callable[[str, str, float, float, float | None, str], None]


@contextmanager
def trace_progress() -> "Iterator[Callable[[TraceProgress], None]]":
    """A callback that shows how far a trace is, and raises KeyboardInterrupt after a Ctrl-C."""
    with _display() as show, interruptible() as check:

        def report_progress(p: "TraceProgress") -> None:
            show(*_trace_shown(p))
            check()

        yield report_progress


def _trace_shown(p: "TraceProgress") -> tuple[str, str, float, float, float | None, str]:
    form = "{:.2g} " + p.unit if p.unit else "{:.2%}"
    known = p.relative_error < (math.inf if p.unit else 1)
    error = f"error {form.format(p.relative_error)}" if known else "error not known yet"
    target = f" ({form.format(p.target)} requested)" if p.target else ""
    name, text = (p.led if p.is_stage else f"LED {p.led}"), error + target
    if p.is_stage and not (known or p.target):
        text = f"{p.fraction_done:.0%} done"
    return name, text, p.fraction_done, p.seconds, p.seconds_left, ""


@contextmanager
def batch_progress() -> "Iterator[Callable[[BatchProgress], None]]":
    """A callback that shows how many scenes of a batch are done, and its news as it comes."""
    with _display() as show:
        yield lambda p: show(*_batch_shown(p))


def _batch_shown(p: "BatchProgress") -> tuple[str, str, float, float, float | None, str]:
    failed = f", {p.failed} failed" if p.failed else ""
    text, fraction = f"{p.done} of {p.total} scenes{failed}", (p.done + p.failed) / max(p.total, 1)
    return "batch", text, fraction, p.seconds, p.seconds_left, p.news


def show_progress(p: "TraceProgress | BatchProgress") -> None:
    """Show how far a study is, in one line on stderr that is written anew: `simulate(scene, progress=show_progress)`.

    p : what every study passes to its `progress`, and `sweep` with the scenes that are done.
    """
    from .light import TraceProgress

    name, text, fraction, _, left_s, _ = _trace_shown(p) if isinstance(p, TraceProgress) else _batch_shown(p)
    line, ends = f"{name}, {text}{_left(fraction, left_s)}", fraction >= 1 and "not known" not in text
    print(f"\r{line:<70}", end="\n" if ends else "", file=sys.stderr, flush=True)


@contextmanager
def _display() -> Iterator[_Show]:
    """Shows progress: bars on a terminal, a line every ten seconds and one at the end elsewhere."""
    if not (sys.stderr and sys.stderr.isatty()):
        logged: dict[str, float] = {}

        def log_line(name: str, text: str, fraction: float, seconds: float, left_s: float | None, news: str) -> None:
            if news:
                say(news)
            done, last = fraction >= 1, logged.get(name, 0.0)
            if not math.isinf(last) and (done or seconds - last >= LOG_EVERY_S):
                logged[name] = math.inf if done else seconds
                say(f"{name}, {text}{_left(fraction, left_s)}" + (f", {seconds:.0f} s" if done else ""))

        yield log_line
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[words]}"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True, soft_wrap=True)) as bars:
        tasks: dict[str, Any] = {}

        def draw(name: str, text: str, fraction: float, seconds: float, left_s: float | None, news: str) -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(name, total=1.0, words="")
            bars.update(tasks[name], completed=fraction, words=text + _left(fraction, left_s))
            if news:
                bars.console.print(f"nailoptics: {escaped(news)}", markup=False, highlight=False)

        yield draw


def _left(fraction: float, seconds_left: float | None) -> str:
    """The time left while it is known and not over."""
    known = seconds_left is not None and seconds_left < math.inf and fraction < 1
    return f", {seconds_left:.0f} s left" if known else ""


def traced(
    study: Callable[..., Any],
    *arguments: Any,
    options: TraceOptions,
    shown: Callable[[], Any] = trace_progress,
    **parameters: Any,
) -> tuple[Any, NotReachedError | None]:
    """The result of a study as far as it was reached, and why not all of it, with its progress on the terminal."""
    if options.max_seconds is not None:
        options = replace(options, max_seconds=(1 - RESERVE) * options.max_seconds)
    with shown() as progress:
        result, unmet = as_far_as_reached(study, *arguments, progress=progress, **parameters, **options.fields)
    if unmet and "interrupted" in str(unmet):
        say("no more light is traced; writing what was reached.")
    return result, unmet


def shown(report: "Report", result: Any, **more: Any) -> tuple[dict[str, Any], Iterable[object]]:
    """A result's summary and lines of text, by its kind, for `finish`; its warnings are printed on stderr."""
    summary = report.summary(result)
    for line in summary.get("warnings", ()):
        say(line)
    return summary | more, report.lines(result, summary)


def finish(
    paths: Mapping[str, Path],
    summary: Mapping[str, Any],
    text: Iterable[object],
    as_json: bool,
    unmet: NotReachedError | None = None,
    where: Path | None = None,
) -> None:
    """Print a result and where it lies, as one JSON object or lines of text, and raise what was not reached.

    where : what the error calls the place of the results.
    """
    cut_off = {"cut_off": str(unmet)} if unmet else {}
    if as_json:
        print(to_json({**summary, **cut_off, **{name: str(path) for name, path in paths.items()}}))
    else:
        # A study's own table has several lines; a text or a path, and what is called so, one.
        shown = [escaped(str(row), lines=not isinstance(row, str | Path)) for row in (*text, *paths.values())]
        if unmet:
            shown.insert(0, escaped(f"Cut off: {unmet}"))
        print(*shown, sep="\n")
    if unmet:
        raise NotReachedError(
            f"{unmet} What was reached is in {where}." if where else str(unmet), full=unmet.exit_code == 1
        )
