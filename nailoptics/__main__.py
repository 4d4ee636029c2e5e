"""`python -m nailoptics` is the command line."""

import os
import signal

# Before NumPy is loaded: matrices here are small, and threads of BLAS that wait for them take a fifth of the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main() -> None:
    """Run the command line, which processes that a batch spawns, and which load this file too, have no use for."""
    is_heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_heard:
        signal.signal(signal.SIGINT, _end)
    from .cli import main as run

    if is_heard:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def _end(number: int, frame: object) -> None:
    """End at once: an exception in the midst of an import becomes a traceback, or another error."""
    os.write(2, b"nailoptics: interrupted; no result was written.\n")
    os._exit(130)


if __name__ == "__main__":
    main()
