"""Which of Mitsuba's backends work on this machine: tested in subprocesses, then cached.

A broken libLLVM does not fail, it aborts the process at its first kernel; so no library is loaded
into this process before another one has run a kernel with it and lived.
"""

import json
import logging
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from glob import glob
from importlib import metadata
from pathlib import Path
from typing import Any, get_args

from ..assets import data_dir, read_toml
from ..errors import InputError, WriteError
from ..io import cache_folder, write_bytes
from ..options import BackendName

log = logging.getLogger(__name__)

# Metal comes after libLLVM because nailoptics was never run on it.
NAMES: tuple[BackendName, ...] = get_args(BackendName)[1:]
ENGINES = ("photons", "volpath")
VARIANTS: dict[BackendName, str] = {name: f"{name}_ad_mono" for name in NAMES} | {"scalar": "scalar_rgb"}
ADVICE = read_toml("backends.toml")
# Where macOS has Metal.
METAL = "/System/Library/Frameworks/Metal.framework"
PROBE_TIMEOUT_S = 120.0
NOT_INSTALLED = 75  # exit code of a probe without Mitsuba
CACHE = "backends.json"
LLVM_FILE = re.compile(r"libLLVM(?:-.*)?\.so|libLLVM.*\.dylib$")
FOLDERS = ("/usr/lib", "/usr/lib64", "/lib", "/lib64", "/usr/local/lib", "/usr/local/lib64")

PROBE = (data_dir("assets") / "probe_backend.py").read_text(encoding="utf-8")

_answers: dict[str, tuple[tuple[str, ...], str]] = {}


@dataclass(frozen=True)
class Backend:
    """One of Mitsuba's backends with one library, the engines that it can run here, and why it is selected or not.

    advice : What would be faster, or is untried.
    """

    name: BackendName
    library: str | None
    engines: tuple[str, ...]
    why: str
    advice: str | None = None

    @property
    def usable(self) -> bool:
        """Whether it can run any engine."""
        return bool(self.engines)

    @property
    def jit(self) -> bool:
        """Whether it compiles kernels."""
        return self.name != "scalar"


def choose(requested: str = "auto", *, volpath: bool = False) -> Backend:
    """The backend to trace with: the one requested, or the first that works of cuda, llvm, metal, scalar.

    Does not import mitsuba. A library seen for the first time costs a subprocess of about a second.

    volpath : for that engine; the scalar backend stands in for a libLLVM that compiles only the photons engine.

    Raises: InputError, one line, where the requested backend is unknown or does not work here.
    """
    if requested != "auto" and requested not in NAMES:
        raise InputError(f'backend "{requested}" is unknown; choose from auto, {", ".join(NAMES)}.')
    failures: list[str] = []
    for name in (name for name in NAMES if requested in ("auto", name)):
        failed = []
        for candidate in _look(name):
            if candidate.usable:
                if volpath and "volpath" not in candidate.engines:
                    return replace(choose("scalar"), why=f"{name} {candidate.why}", advice=ADVICE["volpath"])
                why = "requested" if requested == name else "; ".join(failures) or "the fastest that there is"
                return replace(candidate, why=why, advice=ADVICE.get(name) if requested == "auto" else None)
            failed.append(f"{candidate.library}: {candidate.why}" if candidate.library else candidate.why)
        failures.append(f"{name} is not usable ({'; '.join(failed)})")
    raise InputError(f"backend {failures[0]}; use backend auto, or see nailoptics doctor.")


def findings() -> list[Backend]:
    """Every candidate of every backend, in the order they are tried, and why it is selected or not."""
    candidates: list[Backend] = []
    taken: Backend | None = None
    for candidate in (finding for name in NAMES for finding in _look(name)):
        if candidate.usable:
            what = f"not needed, {taken.name} ({taken.library}) comes first" if taken else "selected"
            if taken and candidate.name == "scalar" and "volpath" not in taken.engines:
                what = "selected for volpath"
            candidate = replace(candidate, why=f"{candidate.why}; {what}")
            taken = taken or candidate
        candidates.append(candidate)
    return candidates


def activate(backend: Backend, variants: Mapping[BackendName, str] = VARIANTS) -> Any:
    """Mitsuba with the backend's variant set; raises InputError where it cannot be imported."""
    if backend.name == "llvm" and backend.library:
        os.environ["DRJIT_LIBLLVM_PATH"] = backend.library
    try:
        # Dr.Jit complains of a missing or broken libLLVM even where none is needed.
        with nullcontext() if backend.jit else _quiet_stderr():
            import mitsuba as mi

            if mi.variant() != variants[backend.name]:
                mi.set_variant(variants[backend.name])
    except ImportError as error:
        why = _last_line(str(error))
        raise InputError(f"mitsuba cannot be used: {why}; reinstall it: pip install mitsuba.") from None
    return mi


def choose_jit(requested: str, what: str) -> Backend:
    """The backend requested; raises InputError where it compiles no kernels, which `what` needs."""
    chosen = choose(requested)
    if not chosen.jit:
        raise InputError(f"{what} needs a JIT backend, and scalar is none: {chosen.advice or 'choose auto'}")
    return chosen


def activate_jit(requested: str, what: str) -> Backend:
    """The backend requested, active from now on; raises InputError where it compiles no kernels, which `what` needs."""
    chosen = choose_jit(requested, what)
    activate(chosen)
    return chosen


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Nothing that compiled code says reaches stderr meanwhile."""
    try:
        stderr = os.dup(2)
    except OSError:  # there is no stderr
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


def _look(name: BackendName) -> Iterator[Backend]:
    """The candidates of one backend; each is probed when its turn comes, not before."""
    if name == "scalar":
        yield Backend("scalar", None, ("volpath",), "works everywhere")
        return
    search, missing = {
        "cuda": (_cuda_libraries, "NVIDIA driver and device"),
        "llvm": (_llvm_libraries, "libLLVM"),
        "metal": (_metal_libraries, "Apple GPU"),
    }[name]
    libraries = search()
    if not libraries:
        yield Backend(name, None, (), f"no {missing} found")
    for library in libraries:
        yield Backend(name, library, *_works(name, library))


def _cuda_libraries() -> list[str]:
    """The CUDA driver's library, if there is a device to drive."""
    if not (_devices() or Path("/dev/dxg").exists()):
        return []
    files = (Path(folder) / "libcuda.so.1" for folder in [*_system_folders(), "/usr/lib/wsl/lib"])
    return [str(file.resolve()) for file in files if file.is_file()][:1]


def _metal_libraries() -> list[str]:
    """The framework of Apple's GPUs, on Apple silicon."""
    return [METAL] if sys.platform == "darwin" and platform.machine() == "arm64" else []


def _system_folders() -> list[str]:
    machine = f"{platform.machine()}-linux-gnu"
    return [*FOLDERS, *(f"{root}/{machine}" for root in ("/usr/lib", "/lib", "/usr/local/lib"))]


def _devices() -> list[str]:
    return sorted(p.name for p in Path("/dev").glob("nvidia[0-9]*"))


def _llvm_libraries() -> list[str]:
    """Files that could be libLLVM, newest major version first; only the user's choice where there is one."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    return [chosen] if chosen else _llvm_in()


@cache
def _llvm_in(*folders: str | Path) -> list[str]:
    """Those in these folders, or in the system's; searched once, since every trace chooses the backend."""
    if not folders:
        folders = *_system_folders(), f"{sys.prefix}/lib"
        for root in ("/usr/lib", "/usr/lib64", "/usr/local/opt", "/opt/homebrew/opt"):
            folders += tuple(sorted(glob(f"{root}/llvm*/lib*")))
    files = (Path(name) for folder in folders for name in glob(f"{folder}/libLLVM*"))
    # Many names lead to one file.
    distinct = {str(file.resolve()) for file in files if LLVM_FILE.match(file.name) and file.is_file()}
    return sorted(sorted(distinct), key=_major_version, reverse=True)


def _major_version(path: str) -> int:
    match = re.search(r"libLLVM[-.](?:so\.)?(\d+)", Path(path).name) or re.search(r"llvm[-@]?(\d+)", path)
    return int(match.group(1)) if match else 0


def _works(name: BackendName, library: str) -> tuple[tuple[str, ...], str]:
    """The engines that work with a library, and why not all: from memory, from the user's cache, or from a probe."""
    # What the answer depends on: the library's file, the packages and the machine.
    file: list[Any] = []
    with suppress(OSError):
        file = [Path(library).stat().st_mtime_ns, Path(library).stat().st_size]
    versions = [*_packages(), platform.python_version(), platform.machine()]
    devices = [os.environ.get("CUDA_VISIBLE_DEVICES"), platform.node(), *_devices()] if name == "cuda" else []
    key = json.dumps([name, library, file, versions, devices, zlib.crc32(PROBE.encode())])
    if key not in _answers:
        try:
            remembered = _read_cache()[key]
            _answers[key] = tuple(e for e in ENGINES if e in remembered["engines"]), str(remembered["why"])
        except (KeyError, TypeError):
            engines, why, lasting = _probe(name, library)
            _answers[key] = engines, why
            log.info("backend %s with %s: %s", name, library, why)
            if lasting:
                # Without a cache the next process probes again.
                with suppress(RuntimeError, WriteError):
                    answers = _read_cache() | {key: {"engines": engines, "why": why}}
                    write_bytes(cache_folder() / CACHE, json.dumps(answers, indent=1).encode())
    return _answers[key]


@cache
def _packages() -> list[str]:
    """Versions of the packages that compile and run kernels; read once, since every trace chooses the backend."""
    return [distribution.version for name in ("drjit", "mitsuba") for distribution in metadata.distributions(name=name)]


def _probe(name: BackendName, library: str) -> tuple[tuple[str, ...], str, bool]:
    """The engines whose kernels and rays work in another process, why not all, and whether the answer lasts."""
    environment = dict(os.environ)
    if name == "llvm":
        environment["DRJIT_LIBLLVM_PATH"] = library
    command = [sys.executable, "-P", "-c", PROBE, VARIANTS[name], str(NOT_INSTALLED)]
    try:
        with tempfile.TemporaryDirectory(prefix="nailoptics-") as folder:
            # Kernels compiled earlier, perhaps by another library, must not answer for this one.
            environment["DRJIT_CACHE_DIR"] = folder
            # In a session of its own: a Ctrl-C for this process must not pass for a kernel that ended the other.
            run = subprocess.run(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=PROBE_TIMEOUT_S,
                start_new_session=True,
            )
    except subprocess.TimeoutExpired:
        return (), f"gave no answer in {PROBE_TIMEOUT_S:g} s", False
    except OSError as error:
        return (), f"could not be tried: {error}", False
    message = run.stderr.decode(errors="replace")
    answered = run.stdout.decode(errors="replace").split()
    engines = tuple(engine for engine in ENGINES if engine in answered)
    if run.returncode == 0 and engines == ENGINES:
        return engines, "works", True
    code = f"(code {run.returncode})"
    if run.returncode < 0:
        names = {Signal.value: Signal.name for Signal in signal.Signals}
        code = f"({names.get(-run.returncode, f'signal {-run.returncode}')})"
    if engines:
        return engines, f"works for photons; a kernel of volpath's ends the process {code}", True
    if run.returncode < 0:
        return (), f"kills the process at its first kernel {code}", True
    # Dr.Jit's own words come first; the exception that follows them only says that there is no backend.
    refusal = re.search(r"jit_(?:llvm|cuda)\w*\(\): (.+?)(?:, shutting down|[.\n]|$)", message)
    why = refusal.group(1) if refusal else _last_line(message)
    missing = run.returncode == NOT_INSTALLED or not message
    return (), f"refused: {why}" if why else f"ended with code {run.returncode}", not missing


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200].rstrip(".") if lines else ""


def _read_cache() -> dict[str, Any]:
    with suppress(OSError, ValueError, RuntimeError):
        answers = json.loads((cache_folder() / CACHE).read_text(encoding="utf-8"))
        return answers if isinstance(answers, dict) else {}
    return {}


def set_threads(count: int) -> None:
    """Let Dr.Jit use so many threads in this process."""
    import drjit as dr

    if dr.thread_count() != count:
        dr.set_thread_count(count)
