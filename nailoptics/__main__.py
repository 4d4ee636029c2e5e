"""`python -m nailoptics` is the command line."""

import gc
import os
import signal

# Before NumPy is loaded: matrices here are small, and threads of BLAS that wait for them take a fifth of the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main() -> None:
    """Run the command line."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # A Ctrl-C while the program is loaded or ends makes no traceback.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Nearly all that a command loads and makes lives as long as it does: garbage is seldom looked for among it.
    gc.set_threshold(500_000)
    from .cli import main as run

    run()


if __name__ == "__main__":
    main()
