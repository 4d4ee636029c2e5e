"""The command line: parse, call, print."""

import json
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from . import __version__
from .errors import InputError, NailopticsError, NotReachedError
from .io import turn, write_dataset, write_text
from .options import BackendName, TraceOptions
from .terminal import (
    as_far_as_reached,
    batch_progress,
    complain,
    finite,
    plain_messages,
    print_json,
    silence_stdout,
    writable,
    writable_file,
)

if TYPE_CHECKING:
    from .scene import Scene

app = App(
    name="nailoptics",
    version=__version__,
    suppress_keyboard_interrupt=False,
    help="Simulate an optical sensor on a fingernail: touch, blood, traced light, photodiode volts.",
)

ScenePath = Annotated[str, Parameter(help="A scene file (TOML), or the name of a shipped one such as prototype.")]
Json = Annotated[bool, Parameter(name="--json", negative="", help="Print one JSON object on stdout, nothing else.")]
Options = Annotated[TraceOptions, Parameter(name="*")]
USUAL = TraceOptions()
Folder = Annotated[
    Path | None, Parameter(name=["--output", "-o"], help="Folder for the results; results/SCENE if not given.")
]
File = Annotated[Path | None, Parameter(name=["--output", "-o"], help="File to write.")]


def main() -> None:
    """Run the command line; ends the process with 0 done, 2 the user's input, 3 not reached, 1 our fault."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code; errors are one line on stderr."""
    with plain_messages():
        try:
            app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
            if sys.stdout:
                sys.stdout.flush()
            return 0
        except CycloptsError as error:
            return complain(f"{error} (nailoptics --help shows what is known)", 2)
        except NailopticsError as error:
            return complain(str(error), error.exit_code)
        except KeyboardInterrupt:
            return complain("interrupted; nothing was finished.", 130)
        except BrokenPipeError:
            silence_stdout()
            return 0
        except OSError as error:
            silence_stdout()
            return complain(f"{error.filename or 'the output'}: {error.strerror or error}.", 1)
        except MemoryError:
            return complain("not enough memory; ask for fewer samples (touch.sample_rate_hz) or photons.", 1)
        except Exception as error:  # the last resort of a command line
            if os.environ.get("NAILOPTICS_DEBUG"):
                raise
            kind = type(error).__name__
            return complain(
                f"internal error, our fault: {kind}: {error} (NAILOPTICS_DEBUG=1 shows where; please report it)", 1
            )


@app.command
def simulate(
    scene: ScenePath,
    *,
    output: Folder = None,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Simulate a touch: force to volts over time, traced light beside the paper's (8) and (9).

    Writes result.nc and report.html.
    """
    from .report import write_report
    from .studies.simulate import simulate as study

    asked = _load(scene)
    if asked.finger is None:
        raise InputError(f"{scene}: simulate needs a [finger] scene; a [phantom] has no blood, use nailoptics trace.")
    _announce(options.backend, asked)
    with writable(output or Path("results") / Path(scene).stem, "result.nc", "report.html") as folder:
        result, unmet = as_far_as_reached(
            lambda told: study(
                asked,
                progress=told,
                **options.fields,
            )
        )
        paths = {"result": folder / "result.nc", "report": folder / "report.html"}
        with turn(folder):
            write_dataset(result, paths["result"])
            write_report(result, paths["report"])
    if json_:
        print_json(_summary(result) | {name: str(path) for name, path in paths.items()})
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
    options: Options = USUAL,
) -> None:
    """Trace the light only: readings at the scene's rest state, and with -o the transfer for any other."""
    from .light import read_rest

    asked = _load(scene)
    engine = _announce(options.backend, asked)
    if output is not None and engine == "volpath":
        raise InputError(f"{output}: volpath traces readings, not a transfer that could be saved; leave -o out.")
    with writable_file(output):
        rest, unmet = as_far_as_reached(
            lambda told: read_rest(
                asked,
                progress=told,
                **options.fields,
            )
        )
        if output is not None and rest.transfer is not None:
            rest.transfer.save(output)
    if json_:
        print_json(rest.as_dict())
    else:
        for row in rest.readings:
            error = _plus_minus(row["stderr"], ".1e")
            if "upper_limit_95" in row:
                error = f"below {row['upper_limit_95']:.1e} (95 %)"
            print(f"{row['led']:>10} {row['photodiode']:<16} {row['detected_fraction']:.4e} {error}")
        for part, share in (rest.energy or {}).items():
            print(f"{part:>11} {share['value']:.5f} {_plus_minus(share['stderr'], '.5f')}")
    if unmet:
        raise NotReachedError(f"{unmet} What was reached is in {output}." if output is not None else str(unmet))


def _plus_minus(stderr: float, form: str) -> str:
    return "+- unknown" if math.isnan(stderr) else f"+- {stderr:{form}}"


@app.command
def compare(
    scene: ScenePath,
    *,
    output: Folder = None,
    over: Annotated[
        tuple[Literal["force", "blood", "saturation"], ...],
        Parameter(help="What is swept: force, blood fraction 0-10 %, saturation 1-0.5. May be repeated."),
    ] = ("force", "blood"),
    wavelength_nm: Annotated[
        tuple[float, ...], Parameter(help="Trace every LED at this wavelength too. May be repeated. [nm]")
    ] = (),
    require: Annotated[
        float | None,
        Parameter(help="Exit with 1 unless the fitted model stays within this part of every reading's swing."),
    ] = None,
    model: Annotated[
        Literal["taylor", "beer_lambert"], Parameter(help="The model that --require judges: (9) or (8).")
    ] = "taylor",
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Compare traced light with the paper's Taylor (9) and Beer-Lambert (8): where they hold, and why not further.

    Writes compare.nc and compare.html.
    """
    from .report.compare_page import write_comparison
    from .studies.comparison.compare import compare as study
    from .studies.comparison.verdict import summary, verdict

    asked = _load(scene)
    _announce(options.backend, asked)
    if require is not None and not 0 < require < math.inf:
        raise InputError(f"--require {require:g} must be a part of the swing above 0, such as 0.05.")
    with writable(output or Path("results") / Path(scene).stem, "compare.nc", "compare.html") as folder:
        result, unmet = as_far_as_reached(
            lambda told: study(
                asked,
                over=over,
                wavelengths_nm=wavelength_nm,
                progress=told,
                **options.fields,
            )
        )
        paths = {"result": folder / "compare.nc", "report": folder / "compare.html"}
        with turn(folder):
            write_dataset(result, paths["result"])
            write_comparison(result, paths["report"])
    judged = verdict(result, 0.05 if require is None else require, model=model)
    if json_:
        files = {name: str(path) for name, path in paths.items()}
        print_json(summary(result) | {"verdict": vars(judged)} | files)
    else:
        for line in (judged, *paths.values()):
            print(line)
    if require is not None and judged.outcome == "missed":
        raise NailopticsError(f"{judged}")
    if unmet:
        raise NotReachedError(f"{unmet} What was reached is in {folder}.")
    if require is not None and judged.outcome == "undecided":
        raise NotReachedError(f"{judged}")


@app.command
def place(
    scene: ScenePath,
    *,
    output: Folder = None,
    negate_x_on_bottom: Annotated[
        bool, Parameter(negative="", help="Write the position file with X negated on the bottom side.")
    ] = False,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Rank layouts of LEDs and photodiodes by the force that they resolve; search better ones.

    Writes place.nc, ranking.csv, place.html, and the best layout as best.toml, best.csv (KiCad), outline and best.glb.
    """
    import csv
    from io import StringIO

    from . import geometry
    from .exports.mesh_files import export_mesh
    from .report.place_page import write_placement
    from .scene import to_toml
    from .scene.dxf import write_outline
    from .scene.positions import write_positions
    from .studies.placement.place import place as study
    from .studies.placement.result import chosen, gain, kicad_parts, outline, rows

    asked = _load(scene)
    _announce(options.backend, asked)
    files = ("place.nc", "ranking.csv", "place.html", "best.toml", "best.csv", "best.glb")
    with writable(output or Path("results") / Path(scene).stem, *files) as folder:
        result, unmet = as_far_as_reached(
            lambda told: study(
                asked,
                progress=told,
                **options.fields,
            )
        )
        ranking, best = rows(result), chosen(result)
        table = StringIO(newline="")
        lines = csv.DictWriter(table, list(ranking[0]))
        lines.writeheader()
        lines.writerows(ranking)
        asked_as = Path((asked.placement and asked.placement.outline) or "outline.csv").suffix.lower()
        with turn(folder):
            write_dataset(result, folder / "place.nc")
            write_text(folder / "ranking.csv", table.getvalue())
            write_text(folder / "best.toml", to_toml(best))
            write_positions(folder / "best.csv", kicad_parts(best, asked), negate_x_on_bottom=negate_x_on_bottom)
            write_outline(folder / f"outline{asked_as}", outline(result))
            export_mesh(geometry.build(best), folder / "best.glb")
            write_placement(result, folder / "place.html")
    better = gain(result)
    if json_:
        told = {"ranking": ranking, "checked_resolution_n": result.attrs["checked_resolution_n"]}
        told["gain_over_paper"] = {"value": better[0], "stderr": better[1]} if better else None
        kept = ("photons", "cpu_seconds", "wall_seconds", "digest", "rank_by")
        print_json(told | {key: result.attrs[key] for key in kept} | {"folder": str(folder)})
    else:
        for row in ranking:
            print(
                f"{row['rank']:>3} {row['layout']:<28} {1e3 * row['force_resolution_n']:9.3f} mN "
                f"+- {1e3 * row['force_resolution_n_stderr']:.3f}{'  tied' if row['tied'] else ''}"
            )
        if better:
            print(f"the best resolves force {better[0]:.2f} +- {better[1]:.2f} times as finely as the paper's layout")
        print(f"{folder / 'place.html'}\n{folder / 'best.toml'}")
    if unmet:
        raise NotReachedError(f"{unmet} What was reached is in {folder}.")


@app.command
def batch(
    sweep: Annotated[Path, Parameter(help="A sweep file (TOML); with --status, the folder of a batch.")],
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"], help="Folder of the batch.")] = None,
    workers: Annotated[int | None, Parameter(help="Processes on this machine; one per core if not given.")] = None,
    scheduler: Annotated[str | None, Parameter(help="Dask scheduler in their place, such as tcp://host:8786.")] = None,
    shard: Annotated[str | None, Parameter(help="I/N: do only the I-th of N parts, for job arrays.")] = None,
    dry_run: Annotated[bool, Parameter(negative="", help="Estimate processor time and disk, and end.")] = False,
    retry_failed: Annotated[bool, Parameter(negative="", help="Try again what failed before.")] = False,
    status: Annotated[bool, Parameter(negative="", help="Show how far a batch is, and end.")] = False,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Do all scenes of a sweep, or what is left of them; a run that was killed goes on where it was.

    Writes table.csv and report.html beside the results; nailoptics.open_results(DIR) opens them in Python.
    """
    import dataclasses

    from . import batch as batches

    if status:
        found = batches.status(output or sweep)
        print_json(dataclasses.asdict(found) | {"left": found.left}) if json_ else print(found)
        return
    planned = batches.load_sweep(sweep)
    if dry_run:
        cost = batches.estimate(planned, **options.fields)
        print_json(dataclasses.asdict(cost)) if json_ else print(cost)
        return
    if output is None:
        raise InputError("batch needs -o DIR, a folder for its results.")
    unmet = None
    try:
        with batch_progress() as told:
            outcome = batches.run_batch(
                planned,
                output,
                workers=workers,
                scheduler=scheduler,
                shard=shard,
                retry_failed=retry_failed,
                progress=told,
                **options.fields,
            )
    except NotReachedError as error:
        if not isinstance(error.result, batches.Outcome):
            raise
        outcome, unmet = error.result, error
    from .report.sweep_page import write_sweep_page

    results = batches.open_results(output)
    try:
        table = batches.write_table(results, output / "table.csv")
        write_sweep_page(results, output / "report.html", failures=outcome.failed)
    except InputError as error:  # a full disk has been told already
        raise unmet or error from None
    if json_:
        told = dataclasses.asdict(outcome) | {"results": str(output), "table": str(table)}
        print_json(told | {"report": str(output / "report.html")})
    else:
        print(
            f"{len(outcome.done)} scenes done, {len(outcome.kept)} were there before; {outcome.lights} traces for all"
        )
        print(f"{output / 'report.html'}\n{table}")
    if unmet:
        raise NotReachedError(str(unmet))


@app.command
def explain(
    scene: ScenePath,
    *,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="Write the scene with only what it requires to this TOML file."),
    ] = None,
    tolerance: Annotated[
        float | None, Parameter(help="Relative change of a reading that matters; the scene's error if not given.")
    ] = None,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Explain what a scene models and what it leaves out, and measure how far each of these moves the readings."""
    from .scene import to_toml
    from .studies.model_error.explain import explain as study

    asked = _load(scene)
    _announce(options.backend, asked)
    with writable_file(output):
        found, unmet = as_far_as_reached(
            lambda told: study(
                asked,
                tolerance=tolerance,
                progress=told,
                **options.fields,
            )
        )
        if output and not unmet:
            write_text(output, to_toml(found.required))
    written = str(output) if output and not unmet else None
    if json_:
        print_json(found.as_dict() | {"scene": written})
    else:
        print(found)
        if written:
            print(written)
    if unmet:
        raise NotReachedError(str(unmet))


@app.command
def tradeoff(
    scene: ScenePath,
    *,
    output: Folder = None,
    tolerance: Annotated[float, Parameter(help="Relative error that a reading may have.")] = 0.02,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Measure error against processor time for every level of model; the cheapest that meets a tolerance.

    Writes tradeoff.json and tradeoff.html, tradeoff.png for a README, and scene.toml: the scene at that level.
    """
    from .report.style import write_figure
    from .report.tradeoff_page import draw, write_tradeoff
    from .scene import to_toml
    from .studies.model_error.tradeoff import tradeoff as study

    asked = _load(scene)
    _announce(options.backend, asked)
    files = ("tradeoff.json", "tradeoff.html", "tradeoff.png", "scene.toml")
    with writable(output or Path("results") / Path(scene).stem, *files) as folder:
        found, unmet = as_far_as_reached(
            lambda told: study(
                asked,
                tolerance=tolerance,
                progress=told,
                **options.fields,
            )
        )
        table, page, picture, selected = (folder / name for name in files)
        with turn(folder):
            write_text(table, json.dumps(finite(found.as_dict()), indent=1) + "\n")
            write_tradeoff(found, page)
            write_figure(draw(found), picture, dpi=120, facecolor="white")
            write_text(selected, to_toml(found.scene))
    if json_:
        print_json(found.as_dict() | {"report": str(page), "scene": str(selected)})
    else:
        print(found)
        print(f"{page}\n{selected}")
    if unmet:
        raise NotReachedError(str(unmet))


@app.command
def check(scene: ScenePath, *, json_: Json = False) -> None:
    """Check a scene file: fields, parts, layout, hemodynamic set and, for a finger, the geometry."""
    asked = _load(scene)
    report: dict[str, Any] = {"scene": scene, "valid": True}
    if asked.finger is not None:
        from . import hemodynamics
        from .geometry import build, check_watertight

        hemodynamics.parameters(asked.blood.parameters)
        shape = build(asked)
        found = check_watertight(shape, crossings=100_000)
        report |= {
            "regions": list(shape.regions),
            "triangles": len(shape.triangles),
            "crossings": found.crossings,
            "disagreements": found.disagreements,
            "volume_error": found.volume_error,
            "valid": bool(found.passed),
        }
    if json_:
        print_json(report)
    else:
        for name, value in report.items():
            print(f"{name}: {', '.join(value) if isinstance(value, list) else value}")
    if not report["valid"]:
        raise NailopticsError(f"{scene}: its geometry leaks; please report the scene.")


@app.command
def export(scene: ScenePath, *, output: Annotated[Path, Parameter(name=["--output", "-o"])]) -> None:
    """Write the finger and the board as a mesh: .glb with one named part per region, or .ply."""
    from .exports.mesh_files import export_mesh
    from .geometry import build

    asked = _load(scene)
    if asked.finger is None:
        raise InputError(f"{scene}: a phantom has no mesh to export; give a [finger] scene.")
    with writable_file(output):
        export_mesh(build(asked), output)
    print(output)


@app.command
def figures(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder for the pictures.")],
    sets: Annotated[
        tuple[str, ...], Parameter(name="--set", negative="", help="Named parameter sets; all if not given.")
    ] = (),
    touch: Annotated[
        Path | None, Parameter(help="Recorded touch for Figs. 17-18, a CSV with time_s, force_n; else the subjects'.")
    ] = None,
    json_: Json = False,
) -> None:
    """Draw the paper's Figs. 10-12 and 15-18 from parameter sets, and judge its claims."""
    import numpy as np

    from . import hemodynamics
    from .paper.claims_table import as_rows, as_text, table
    from .report.blood_figures import draw
    from .scene.touch import read_recording

    recorded: dict[str, Any] = {}
    if touch is not None:
        recorded = dict(zip(("time_s", "force_n"), map(np.asarray, read_recording(touch)), strict=True))
    named = {name: hemodynamics.parameters(name) for name in sets or hemodynamics.NAMES}
    with writable(output):
        pictures = [path for name, values in named.items() for path in draw(output, values, name=name, **recorded)]
    judged = table(named)
    if json_:
        print_json({"claims": as_rows(judged), "pictures": [str(path) for path in pictures]})
    else:
        print(as_text(judged), *pictures, sep="\n")


@app.command
def schema(
    *, of: Annotated[Literal["scene", "sweep"], Parameter(help="Which file the schema is for.")] = "scene"
) -> None:
    """Print the JSON Schema of scene files, or of sweep files, for editors."""
    from . import scene
    from .scene.sweep import sweep_json_schema

    print_json(sweep_json_schema() if of == "sweep" else scene.json_schema())


@app.command
def doctor(*, json_: Json = False) -> None:
    """Show the backends of this machine, the engines that each can run, and why it was taken or not."""
    from .light import backend as backends

    chosen, stock, findings = backends.choose("auto"), backends.choose("auto", volpath=True), backends.findings()
    if json_:
        rows = [
            {"backend": f.name, "library": f.library, "usable": f.usable, "engines": f.engines, "why": f.why}
            for f in findings
        ]
        first = {"backend": chosen.name, "library": chosen.library, "advice": chosen.advice}
        serving = {"photons": chosen.name if chosen.jit else None, "volpath": stock.name}
        print_json(first | {"engines": serving, "findings": rows})
        return
    for finding in findings:
        taken = "taken" if (finding.name, finding.library) == (chosen.name, chosen.library) else ""
        engines = ", ".join(finding.engines) or "not usable"
        print(f"{finding.name:<7} {engines:<17} {taken:<6} {finding.library or ''} {finding.why}".rstrip())
    print("photons serves every command; volpath serves simulate, trace and batch")
    for advice in dict.fromkeys(one.advice for one in (chosen, stock) if one.advice):
        print(advice)


def _load(name: str) -> "Scene":
    """The scene at a path, or the shipped one of that name."""
    from .assets import data_dir
    from .scene import load_scene

    path = Path(name)
    if not _exists(path) and path.parent in (Path(), Path("scenes")):
        shipped = data_dir("scenes") / (path.name if path.suffix else f"{path.name}.toml")
        if _exists(shipped):
            path = shipped
        elif not path.suffix:
            known = ", ".join(sorted(p.stem for p in data_dir("scenes").glob("*.toml")))
            raise InputError(f"{name}: there is no such file and no shipped scene of that name; shipped: {known}.")
    return load_scene(path)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name too long for the file system, or a folder that may not be searched
        return False


def _announce(backend: BackendName, scene: "Scene") -> str:
    """The engine that will be used; says in one line what would be faster if it is the slow one."""
    from .light import backend as backends
    from .light.engines import engine_for

    chosen = backends.choose(backend)
    engine = engine_for(scene, chosen)
    if chosen.name == "scalar" and chosen.advice and backend == "auto":
        complain(chosen.advice, 0)
    return engine


def _summary(result: Any) -> dict[str, Any]:
    """What simulate prints as JSON: rest, largest change, noise, for each pair."""
    import numpy as np

    rows = []
    for led in result.led.values:
        for photodiode in result.photodiode.values:
            one = result.sel(led=led, photodiode=photodiode)
            peak = int(np.abs(one.volts_change.values).argmax())
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
