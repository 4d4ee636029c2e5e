"""What a new process of this machine does first to become a batch's worker, before it loads the rest of the package."""

import gc
import multiprocessing
import os
import signal
import threading

from .io import block_dask_import


def prepare(threads: int) -> None:
    """Make a new local process a worker: few threads, deaf to Ctrl-C, and gone when its parent is."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if parent := multiprocessing.parent_process():

        def watch() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()
    gc.set_threshold(100_000)  # as on the command line
    block_dask_import()
    from .light import backend

    backend.set_threads(threads)
