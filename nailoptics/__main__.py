"""`python -m nailoptics` is the command line."""

import os

# Before NumPy is loaded: matrices here are small, and threads of BLAS that wait for them take a fifth of the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main() -> None:
    """Run the command line, which processes that a batch spawns, and which load this file too, have no use for."""
    from .cli import main as run

    run()


if __name__ == "__main__":
    main()
