"""Where jobs run: one process per slot on this machine, or the workers of a Dask cluster."""

import contextlib
import multiprocessing
import os
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor

from ..errors import InputError, NailopticsError
from ..io import let_dask_in
from ..local_worker import prepare

# Read by NumPy's BLAS when a worker imports it; one thread each, so that sums are the same on every machine.
_SINGLE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# A worker may be killed by chance while it starts, but hardly so often.
_STARTS = 5


class Slots:
    """Executors that take one job at a time; one that broke is replaced."""

    executors: list[Executor]
    # Whether a slot has its own process, so that its death tells which job it was.
    own_process: bool
    # Workers of one machine that have yet to divide its cores.
    sharers = 0

    def start(self) -> None:
        """Wait until there is someone to work."""

    def renew(self, slot: int) -> None:
        """Replace a slot whose worker died, unless that happens by itself."""

    def deserted(self) -> bool:
        """Whether nobody is left to work, though somebody may come."""
        return False

    def close(self, *, now: bool) -> None:
        """Let the workers go; at once, with whatever they do, or when they are done."""


class LocalSlots(Slots):
    """Spawned processes of this machine, one per slot: Mitsuba and forking do not mix."""

    own_process = True

    def __init__(self, workers: int, threads: int) -> None:
        self.threads = threads
        self.context = multiprocessing.get_context("spawn")
        self.executors = [self._new() for _ in range(workers)]

    def _new(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, mp_context=self.context, initializer=prepare, initargs=(self.threads,))

    def start(self) -> None:
        for _ in range(_STARTS):
            broken = []
            for slot, ready in enumerate([e.submit(os.getpid) for e in self.executors]):
                try:
                    ready.result()
                except BrokenExecutor:
                    broken.append(slot)
            if not broken:
                return
            for slot in broken:
                self.renew(slot)
        raise NailopticsError(
            "the worker processes die as they start; in a script, run batches under if __name__ == '__main__': only."
        )

    def renew(self, slot: int) -> None:
        self.executors[slot].shutdown(wait=False, cancel_futures=True)
        self.executors[slot] = self._new()

    def close(self, *, now: bool) -> None:
        if now:
            mine = {pid for e in self.executors for pid in (getattr(e, "_processes", None) or {})}
            for child in multiprocessing.active_children():
                if child.pid in mine:
                    child.terminate()
        for executor in self.executors:
            executor.shutdown(wait=True, cancel_futures=True)


class ClusterSlots(Slots):
    """The workers of a Dask scheduler."""

    own_process = False

    def __init__(self, address: str) -> None:
        let_dask_in()
        try:
            from distributed import Client
        except ImportError:
            raise InputError("--scheduler needs Dask: pip install 'nailoptics[cluster]'.") from None
        try:
            self.client = Client(address, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            why = str(error).splitlines()[0]
            raise InputError(f"--scheduler {address}: cannot be reached ({why}); start dask scheduler first.") from None
        found = self.client.nthreads()
        if not found:
            self.client.close()
            raise InputError(f"--scheduler {address}: has no workers; start dask worker {address} --nthreads 1.")
        executor = self.client.get_executor(pure=False)
        # One more than there are workers, so that none waits for the driver.
        self.executors = [executor] * (2 * sum(found.values()))
        self.sharers = max(Counter(address.rpartition(":")[0] for address in found).values())

    def deserted(self) -> bool:
        try:
            return not self.client.nthreads()
        except Exception:  # the scheduler went away, which its futures tell
            return False

    def close(self, *, now: bool) -> None:
        self.client.close(timeout=5)


@contextlib.contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Processes started meanwhile do linear algebra on one thread."""
    before = {name: os.environ[name] for name in _SINGLE if name in os.environ}
    os.environ.update(dict.fromkeys(_SINGLE, "1"))
    try:
        yield
    finally:
        for name in _SINGLE:
            del os.environ[name]
        os.environ.update(before)
