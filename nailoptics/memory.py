"""Memory that was freed, given back to the system."""

import ctypes
import sys
from contextlib import suppress


def give_back() -> None:
    """Give memory that is free back to the system, as far as libraries keep it for their next need.

    Compiled kernels, and arrays of a few megabytes that come and go, leave 0.1 GB of it behind.
    """
    if "drjit" in sys.modules:
        sys.modules["drjit"].flush_malloc_cache()
    with suppress(OSError, AttributeError):  # a C library other than GNU's
        ctypes.CDLL(None).malloc_trim(0)
