"""Ctrl-C: the first lets a study end after its batch, with what it has; the next is Python's own KeyboardInterrupt."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


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
def after_batch(announce: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """A check for between batches that raises KeyboardInterrupt after a first Ctrl-C; a second one raises it at once.

    announce : called when it is pressed first.
    """
    pressed: list[int] = []
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: Any) -> None:
        pressed.append(number)
        signal.signal(signal.SIGINT, before)
        announce()

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
