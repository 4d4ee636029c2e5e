"""The command line: parse, call, print; progress bars live here."""

import json
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from . import __version__
from .errors import InputError, NailopticsError, NotReachedError

if TYPE_CHECKING:
    from .light import Progress
    from .scene import Scene

app = App(
    name="nailoptics",
    version=__version__,
    help="Simulate an optical sensor on a fingernail: touch, blood, traced light, photodiode volts.",
)

BackendName = Literal["auto", "cuda", "llvm", "scalar"]
ScenePath = Annotated[str, Parameter(help="A scene file (TOML), or the name of a shipped one such as prototype.")]
Json = Annotated[bool, Parameter(name="--json", negative="", help="Print one JSON object on stdout, nothing else.")]
Seed = Annotated[int, Parameter(help="Same seed, same bits, on one backend.")]
Backend = Annotated[BackendName, Parameter(help="What runs the light: auto takes the fastest that works here.")]
RelativeError = Annotated[float | None, Parameter(help="Relative standard error that every reading must reach.")]
MaxSeconds = Annotated[float | None, Parameter(help="Wall time after which tracing stops. [s]")]
Photons = Annotated[int | None, Parameter(help="Photons per LED, in place of a tolerance.")]
Folder = Annotated[
    Path | None, Parameter(name=["--output", "-o"], help="Folder for the results; results/SCENE if not given.")
]
File = Annotated[Path | None, Parameter(name=["--output", "-o"], help="File to write.")]


def main() -> None:
    """Run the command line; ends the process with 0 done, 2 the user's input, 3 not reached, 1 our fault."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code; errors are one line on stderr."""
    logging.basicConfig(level=logging.WARNING, format="nailoptics: %(message)s", stream=sys.stderr)
    logging.captureWarnings(True)
    try:
        app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        return 0
    except CycloptsError as error:
        return _complain(" ".join(str(error).split()) + " (nailoptics --help shows what is known)", 2)
    except NailopticsError as error:
        return _complain(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _complain("interrupted; nothing was finished.", 130)
    except BrokenPipeError:
        return 0
    except Exception as error:  # the last resort of a command line
        if os.environ.get("NAILOPTICS_DEBUG"):
            raise
        kind = type(error).__name__
        return _complain(
            f"internal error, our fault: {kind}: {error} (NAILOPTICS_DEBUG=1 shows where; please report it)", 1
        )


def _complain(line: str, code: int) -> int:
    print(f"nailoptics: {line}", file=sys.stderr)
    return code


@app.command
def simulate(
    scene: ScenePath,
    *,
    output: Folder = None,
    json_: Json = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    relative_error: RelativeError = None,
    max_seconds: MaxSeconds = None,
    photons: Photons = None,
) -> None:
    """Simulate a touch: force to volts over time, traced light beside the paper's (8) and (9).

    Writes result.nc and report.html.
    """
    from .light.store import write_dataset
    from .report import write_report
    from .studies.simulate import simulate as study

    asked = _load(scene)
    folder = _writable(output or Path("results") / Path(scene).stem)
    unmet = None
    try:
        with _progress() as progress:
            result = study(
                asked,
                seed=seed,
                backend=_announced(backend, asked),
                photons=photons,
                relative_error=relative_error,
                max_seconds=max_seconds,
                progress=progress,
            )
    except NotReachedError as error:
        if error.result is None:
            raise
        result, unmet = error.result, error
    paths = {"result": folder / "result.nc", "report": folder / "report.html"}
    write_dataset(result, paths["result"])
    write_report(result, paths["report"])
    if json_:
        _print_json(_summary(result) | {name: str(path) for name, path in paths.items()})
    else:
        _print_readings(result)
        print(f"{paths['report']}\n{paths['result']}")
    if unmet:
        raise NotReachedError(f"{unmet} What was reached is in {folder}.")


@app.command
def trace(
    scene: ScenePath,
    *,
    output: File = None,
    json_: Json = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    relative_error: RelativeError = None,
    max_seconds: MaxSeconds = None,
    photons: Photons = None,
) -> None:
    """Trace the light only: readings at the scene's rest state, and with -o the transfer for any other."""
    from .light import read_rest

    asked = _load(scene)
    if output is not None:
        _writable(output.parent)
    unmet = None
    try:
        with _progress() as progress:
            rest = read_rest(
                asked,
                seed=seed,
                backend=_announced(backend, asked),
                photons=photons,
                relative_error=relative_error,
                max_seconds=max_seconds,
                progress=progress,
            )
    except NotReachedError as error:
        if error.result is None:
            raise
        rest, unmet = error.result, error
    if output is not None:
        if rest.transfer is None:
            raise InputError(f"{output}: volpath traces readings, not a transfer that could be saved; leave -o out.")
        rest.transfer.save(output)
    if json_:
        _print_json(rest.as_dict())
    else:
        for row in rest.readings:
            print(f"{row['led']:>10} {row['photodiode']:<16} {row['detected_fraction']:.4e} +- {row['stderr']:.1e}")
        for name, part in (rest.energy or {}).items():
            print(f"{name:>11} {part['value']:.5f} +- {part['stderr']:.5f}")
    if unmet:
        raise NotReachedError(str(unmet))


@app.command
def check(scene: ScenePath, *, json_: Json = False) -> None:
    """Check a scene file: fields, parts, layout, hemodynamic set and, for a finger, the geometry."""
    asked = _load(scene)
    report: dict[str, Any] = {"scene": scene, "valid": True}
    if asked.finger is not None:
        from . import hemodynamics
        from .geometry import build
        from .geometry import check as check_geometry

        hemodynamics.parameters(asked.blood.parameters)
        shape = build(asked)
        found = check_geometry(shape, crossings=100_000)
        report |= {
            "regions": list(shape.regions),
            "triangles": len(shape.triangles),
            "crossings": found.crossings,
            "disagreements": found.disagreements,
            "volume_error": found.volume_error,
            "valid": bool(found.passed),
        }
    if json_:
        _print_json(report)
    else:
        for name, value in report.items():
            print(f"{name}: {', '.join(value) if isinstance(value, list) else value}")
    if not report["valid"]:
        raise NailopticsError(f"{scene}: its geometry leaks; please report the scene.")


@app.command
def export(scene: ScenePath, *, output: Annotated[Path, Parameter(name=["--output", "-o"])]) -> None:
    """Write the finger and the board as a mesh: .glb with one named part per region, or .ply."""
    from .geometry import build
    from .geometry import export as write

    asked = _load(scene)
    if asked.finger is None:
        raise InputError(f"{scene}: a phantom has no mesh to export; give a [finger] scene.")
    _writable(output.parent)
    write(build(asked), output)
    print(output)


@app.command
def figures(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder for the pictures.")],
    sets: Annotated[tuple[str, ...], Parameter(name="--set", help="Named parameter sets; all if not given.")] = (),
    json_: Json = False,
) -> None:
    """Draw the paper's Figs. 10-12 and 15-18 from parameter sets, and judge its claims."""
    from .report.hemodynamic_figures import write_figures

    _writable(output)
    table = write_figures(output, sets or None)
    if json_:
        _print_json(table.as_dict())
    else:
        print(table)


@app.command
def schema() -> None:
    """Print the JSON Schema of scene files, for editors."""
    from .scene import json_schema

    _print_json(json_schema())


@app.command
def doctor(*, json_: Json = False) -> None:
    """Show the backends of this machine, and why each was taken or not."""
    from .light import backend as backends

    chosen, findings = backends.choose("auto"), backends.findings()
    if json_:
        rows = [{"backend": f.name, "library": f.library, "usable": f.usable, "why": f.why} for f in findings]
        _print_json({"backend": chosen.name, "library": chosen.library, "advice": chosen.advice, "findings": rows})
        return
    for finding in findings:
        taken = "taken" if (finding.name, finding.library) == (chosen.name, chosen.library) else ""
        state = "works" if finding.usable else "not usable"
        print(f"{finding.name:<7} {state:<11} {taken:<6} {finding.library or ''} {finding.why}".rstrip())
    if chosen.advice:
        print(chosen.advice)


def _load(name: str) -> "Scene":
    """The scene at a path, or the shipped one of that name."""
    from .assets import data_dir
    from .scene import load_scene

    path = Path(name)
    if not path.exists():
        shipped = data_dir("scenes") / (path.name if path.suffix else f"{path.name}.toml")
        if shipped.exists() and path.parent in (Path(), Path("scenes")):
            path = shipped
    return load_scene(path)


def _writable(folder: Path) -> Path:
    """The folder, made if need be; raises InputError before any work is done if nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".nailoptics-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}; choose another folder with -o.") from None
    return folder


def _announced(backend: str, scene: "Scene") -> str:
    """The backend that will be used; says in one line what would be faster if it is the slow one."""
    from .light import backend as backends

    chosen = backends.choose(backend)
    if chosen.name == "scalar" and chosen.advice and backend == "auto":
        print(f"nailoptics: {chosen.advice}", file=sys.stderr)
    return chosen.name


@contextmanager
def _progress() -> Iterator[Any]:
    """A progress callback: a bar with time left on a terminal, a line every ten seconds elsewhere."""
    if not sys.stderr.isatty():
        last = [0.0]

        def log_line(p: "Progress") -> None:
            if p.seconds - last[0] >= 10 or p.fraction_done >= 1:
                last[0] = 0.0 if p.fraction_done >= 1 else p.seconds
                print(f"nailoptics: {_told(p)}, {p.seconds_left:.0f} s left", file=sys.stderr, flush=True)

        yield log_line
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[told]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=Console(stderr=True)) as bar:
        tasks: dict[str, Any] = {}

        def show(p: "Progress") -> None:
            if p.led not in tasks:
                tasks[p.led] = bar.add_task(f"LED {p.led}", total=1.0, told="")
            bar.update(tasks[p.led], completed=p.fraction_done, told=_told(p).partition(", ")[2])

        yield show


def _told(p: "Progress") -> str:
    error = f"error {p.relative_error:.2%}" if p.relative_error < 1 else "error not known yet"
    return f"LED {p.led}, {error}" + (f" of {p.target:.2%} asked" if p.target else "")


def _summary(result: Any) -> dict[str, Any]:
    """What simulate prints as JSON: rest, largest change, noise, for each pair."""
    rows = []
    for led in result.led.values:
        for photodiode in result.photodiode.values:
            one = result.sel(led=led, photodiode=photodiode)
            peak = int(abs(one.volts_change).argmax())
            rows.append(
                {
                    "led": str(led),
                    "photodiode": str(photodiode),
                    "volts_start": float(one.volts[0]),
                    "volts_start_stderr": float(one.volts_stderr[0]),
                    "volts_change": float(one.volts_change[peak]),
                    "volts_change_stderr": float(one.volts_change_stderr[peak]),
                    "volts_noise_rms": float(one.volts_noise_rms[peak]),
                    "time_of_change_s": float(one.time[peak]),
                    "beer_lambert_residual_rms_v": float(one.beer_lambert_residual_rms_v),
                    "taylor_residual_rms_v": float(one.taylor_residual_rms_v),
                }
            )
    kept = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest", "accuracy_reached")
    return {"readings": rows} | {name: result.attrs[name] for name in kept}


def _print_readings(result: Any) -> None:
    print(f"{'LED':>10} {'photodiode':<14} {'start V':>9} {'+-':>8} {'change mV':>10} {'+-':>7} {'noise mV':>9}")
    for row in _summary(result)["readings"]:
        print(
            f"{row['led']:>10} {row['photodiode']:<14} {row['volts_start']:9.4f} {row['volts_start_stderr']:8.4f} "
            f"{1e3 * row['volts_change']:10.3f} {1e3 * row['volts_change_stderr']:7.3f} "
            f"{1e3 * row['volts_noise_rms']:9.4f}"
        )


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, allow_nan=False, default=float))
