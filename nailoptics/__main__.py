"""`python -m nailoptics` is the command line."""

import os

# Before NumPy is loaded: matrices here are small, and threads of BLAS that wait for them take a fifth of the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from .cli import main  # noqa: E402

if __name__ == "__main__":
    main()
