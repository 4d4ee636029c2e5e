"""The command line: parse, call, print."""

import gc
import math
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from . import __version__
from .commit import commit
from .errors import (
    InputError,
    NailopticsError,
    NotReachedError,
    RequirementError,
    WriteError,
    as_far_as_reached,
    exit_message,
)
from .interrupts import counted
from .io import check_writable, leave_dask_out, make_folder
from .options import TraceOptions
from .terminal import (
    batch_progress,
    collected_warnings,
    escaped,
    interruptible,
    plain_messages,
    print_json,
    say,
    silence_stdout,
    text_lines,
    trace_progress,
)

if TYPE_CHECKING:
    from .scene import Scene

# Of --max-seconds, the part that is left for starting and for writing the results; the rest bounds the tracing.
RESERVE = 0.1


def _version() -> str:
    known = commit()
    return f"{__version__} (commit {known[:12]})" if known else __version__


app = App(
    name="nailoptics",
    version=_version,
    suppress_keyboard_interrupt=False,
    help="Simulate an optical sensor on a fingernail: touch, blood, traced light, photodiode volts.",
    help_epilogue="Terms and symbols: docs/glossary.md in the repository.",
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
    """Run the command line and end the process; `errors` lists the exit codes."""
    leave_dask_out()
    for stream in (sys.stdout, sys.stderr):  # names may hold letters that the terminal's encoding lacks
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # Nearly all that a command makes lives as long as it does: to look for garbage among it is a tenth of its time.
    gc.set_threshold(100_000)
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code; errors are one line on stderr."""
    with plain_messages(), counted() as interrupts:
        try:
            app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
            if sys.stdout:
                sys.stdout.flush()
            return 0
        except BrokenPipeError:
            silence_stdout()
            return 0
        except (KeyboardInterrupt, Exception) as error:
            if isinstance(error, CycloptsError):
                error = InputError(f"{error} (nailoptics --help lists commands and options)")
            elif isinstance(error, OSError):
                silence_stdout()
            line, code = exit_message(error, interrupted=bool(interrupts))
        say(line)
        return code


@app.command
def simulate(
    scene: ScenePath,
    *,
    output: Folder = None,
    recording: Annotated[
        Path | None, Parameter(help="Write what a worn sensor would record, noise included, to this CSV file, too.")
    ] = None,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Simulate a touch: force to volts over time, traced light beside the paper's Taylor (9) and Beer-Lambert (8).

    Writes result.nc and report.html.
    """
    from .report.result_files import SIMULATION, write_recording, write_simulation
    from .report.summaries import simulation_summary
    from .report.terminal_text import simulation_lines
    from .studies.force.virtual_recording import record
    from .studies.simulate import simulate as study

    loaded, _ = _load(scene, options)
    folder = _results(output, scene, SIMULATION)
    _check_file(recording)
    result, unmet = _traced(study, loaded, picture=True, options=options)
    paths = write_simulation(result, folder)
    if recording is not None:
        paths |= write_recording(record(loaded, result, seed=options.seed), recording)
    summary = simulation_summary(result)
    _finish(summary, simulation_lines(summary), paths, json_, unmet, folder)


@app.command
def trace(scene: ScenePath, *, output: File = None, json_: Json = False, options: Options = USUAL) -> None:
    """Trace the light only: readings at the scene's rest state, and with -o the transfer for any other."""
    from .light import read_rest
    from .report.terminal_text import rest_lines

    loaded, engine = _load(scene, options)
    if output is not None and engine == "volpath":
        raise InputError(f"{output}: volpath traces readings, not a transfer that could be saved; leave -o out.")
    _check_file(output)
    rest, unmet = _traced(read_rest, loaded, options=options)
    if output is not None and rest.transfer is not None:
        rest.transfer.save(output)
    _finish(rest.as_dict(), rest_lines(rest), {}, json_, unmet, output)


@app.command
def colour(
    scene: ScenePath,
    *,
    output: Folder = None,
    force: Annotated[
        tuple[float, ...] | None,
        Parameter(negative="", help="Held forces, the first to compare with. May be repeated. [N]"),
    ] = None,
    illuminant: Annotated[
        Literal["D65", "A", "LED-B3"] | None, Parameter(help="Daylight, an incandescent lamp, or a white LED.")
    ] = None,
    observer: Annotated[
        Literal["2", "10"] | None, Parameter(help="Field of the standard observer, in degrees.")
    ] = None,
    light: Annotated[
        Literal["sky", "lamp"] | None, Parameter(help="From all sides, or at 45 degrees all round.")
    ] = None,
    gloss: Annotated[bool | None, Parameter(help="Include the light that the surface mirrors.")] = None,
    photograph: Annotated[
        bool | None,
        Parameter(
            help="Render the finger at rest and pressed (half a minute); by default unless --max-seconds is given."
        ),
    ] = None,
    tolerance: Annotated[float | None, Parameter(help="Standard error of every place's colour (CIEDE2000).")] = None,
    change_tolerance: Annotated[
        float | None, Parameter(help="Standard error of every change by force (CIEDE2000).")
    ] = None,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Trace the colour of the bare nail and the skin around it under force, as in the paper's Fig. 2.

    Defaults are those of the scene's [colour]. Writes colour.nc, colour.html, the strip of nails, photographs at rest
    and pressed, and a press as an animation.
    """
    from .report.result_files import COLOUR, write_colour
    from .report.summaries import colour_summary
    from .report.terminal_text import colour_lines
    from .studies.colour.nail_colour import colour as study

    loaded, _ = _load(scene, options)
    folder = _results(output, scene, COLOUR)
    view: dict[str, Any] = {"illuminant": illuminant, "observer": observer, "lit_by": light, "gloss": gloss}
    view |= {"forces_n": force, "tolerance": tolerance, "change_tolerance": change_tolerance}
    result, unmet = _traced(study, loaded, **view, options=options)
    pictures: list[Any] = []
    try:
        if options.max_seconds is None if photograph is None else photograph:
            pictures = [] if unmet else _photographs(loaded, result, options)
    except KeyboardInterrupt:
        unmet = NotReachedError("interrupted; photographs are left out.")
    assert loaded.finger is not None
    paths = write_colour(result, folder, photographs=pictures, width_mm=loaded.finger.nail_width_mm)
    summary = colour_summary(result)
    _finish(summary, colour_lines(summary), paths, json_, unmet, folder)


def _photographs(scene: "Scene", result: Any, options: TraceOptions) -> list[Any]:
    """Pictures of the finger at rest and under the last force; raises KeyboardInterrupt between them."""
    from .studies.colour.views import photographs

    pictures: list[Any] = []
    with interruptible() as check:
        for state in dict.fromkeys((0, -1 % result.sizes["state"])) if result.sizes["tile"] > 0 else ():
            check()
            pictures += photographs(scene, result, states=[state], backend=options.backend)
        check()
    return pictures


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
        Parameter(help="Exit with 4 unless the fitted model stays within this part of every reading's swing."),
    ] = None,
    model: Annotated[
        Literal["taylor", "beer_lambert"],
        Parameter(help="The model that --require judges: Taylor (9) or Beer-Lambert (8)."),
    ] = "taylor",
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Compare traced light with the paper's Taylor (9) and Beer-Lambert (8): where they hold, and why not further.

    Writes compare.nc and compare.html.
    """
    from .report.result_files import COMPARISON, write_comparison
    from .report.summaries import comparison_summary as summary
    from .report.terminal_text import verdict_line
    from .studies.comparison.compare import compare as study
    from .studies.comparison.compare import verdict

    loaded, _ = _load(scene, options)
    if require is not None and not 0 < require < math.inf:
        raise InputError(f"--require {require:g} must be a part of the swing above 0, such as 0.05.")
    folder = _results(output, scene, COMPARISON)
    result, unmet = _traced(study, loaded, over=over, wavelengths_nm=wavelength_nm, options=options)
    paths = write_comparison(result, folder)
    judged = verdict(result, 0.05 if require is None else require, model=model)
    missed = require is not None and judged.outcome == "missed"
    try:
        _finish(summary(result) | {"verdict": vars(judged)}, [verdict_line(judged)], paths, json_, unmet, folder)
    except NotReachedError:
        if not missed:
            raise
    if missed:
        raise RequirementError(verdict_line(judged))
    if require is not None and judged.outcome == "undecided":
        raise NotReachedError(verdict_line(judged))


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
    from .report.result_files import PLACEMENT, write_placement
    from .report.summaries import placement_summary
    from .report.terminal_text import placement_lines
    from .studies.placement.place import place as study

    loaded, _ = _load(scene, options)
    folder = _results(output, scene, PLACEMENT)
    result, unmet = _traced(study, loaded, options=options)
    paths = write_placement(result, folder, negate_x_on_bottom=negate_x_on_bottom)
    summary = placement_summary(result) | {"folder": str(folder)}
    _finish(summary, placement_lines(summary), paths, json_, unmet, folder)


@app.command
def explore(
    scene: ScenePath,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Page to write.")] = Path("explore.html"),
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Make a page on which LEDs and photodiodes are dragged and every reading follows, from light traced once.

    It is one file, which any browser opens from disk. Photons are those of each of the scene's wavelengths.
    """
    from .report.pages.explore.page import write_exploration
    from .studies.exploration.explore import explore as study

    if output.suffix != ".html":
        raise InputError(f"{output}: a page ends in .html; rename it.")
    loaded, _ = _load(scene, options)
    _check_file(output)
    found, unmet = _traced(study, loaded, options=options)
    make_folder(output.parent)
    write_exploration(found, output)
    summary = {name: found.attributes[name] for name in ("photons", "cpu_seconds", "wall_seconds")}
    summary["bytes"] = size = output.stat().st_size
    line = f"{summary['photons']} photons at {len(found.colours)} wavelengths, {size / 1e6:.1f} MB"
    _finish(summary, [line], {"page": output}, json_, unmet, output)


@app.command
def batch(
    sweep: Annotated[Path, Parameter(help="A sweep file (TOML); with --status, the folder of a batch.")],
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"], help="Folder of the batch.")] = None,
    workers: Annotated[int | None, Parameter(help="Processes on this machine; one per core if not given.")] = None,
    scheduler: Annotated[str | None, Parameter(help="Dask scheduler in their place, such as tcp://host:8786.")] = None,
    shard: Annotated[str | None, Parameter(help="I/N: run only the I-th of N parts, for job arrays.")] = None,
    dry_run: Annotated[bool, Parameter(negative="", help="Estimate processor time and disk, and exit.")] = False,
    retry_failed: Annotated[bool, Parameter(negative="", help="Retry the scenes that failed before.")] = False,
    status: Annotated[bool, Parameter(negative="", help="Show the batch's progress and exit.")] = False,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Run the remaining scenes of a sweep; a run that was killed is resumed where it was.

    Writes table.csv and report.html beside the results; nailoptics.open_results(DIR) opens them in Python.
    """
    from . import batch as batches
    from .report.result_files import write_sweep

    if status:
        found = batches.status(output or sweep)
        return _finish(vars(found) | {"left": found.left}, [found], {}, json_)
    planned = batches.load_sweep(sweep)
    if dry_run:
        cost = batches.estimate(planned, **options.fields)
        return _finish(vars(cost), [cost], {}, json_)
    if output is None:
        raise InputError("batch needs -o DIR, a folder for its results.")
    how: dict[str, Any] = {"workers": workers, "scheduler": scheduler, "shard": shard, "retry_failed": retry_failed}
    unmet = None
    try:
        with batch_progress() as progress:
            how |= {"progress": progress, **_limited(options).fields}
            outcome, unmet = as_far_as_reached(batches.run_batch, planned, output, **how)
        paths = write_sweep(batches.open_results(output), output, failures=outcome.failed)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; finished scenes are in {output}, run again to resume.") from None
    except InputError as error:  # a full disk ended the batch, too, which said so
        raise unmet or error from None
    line = f"{len(outcome.done)} scenes done, {len(outcome.kept)} were there before; {outcome.lights} traces for all"
    _finish(vars(outcome) | {"results": str(output)}, [line], paths, json_, unmet)


@app.command
def explain(
    scene: ScenePath,
    *,
    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"], help="TOML file for the scene with only what it requires; a page beside it."
        ),
    ] = None,
    tolerance: Annotated[
        float | None, Parameter(help="Relative change of a reading that matters; the scene's error if not given.")
    ] = None,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Explain what a scene models and what it leaves out, and measure how far each of these moves the readings."""
    from .report.model_errors import explanation_lines, explanation_summary
    from .report.result_files import write_explanation
    from .studies.model_error.explain import explain as study

    if output is not None and output.suffix != ".toml":
        raise InputError(f"{output}: a scene file ends in .toml; rename it.")
    loaded, _ = _load(scene, options)
    if output is not None:
        check_writable(output.parent, output.name, output.with_suffix(".html").name)
    found, unmet = _traced(study, loaded, tolerance=tolerance, options=options)
    paths = write_explanation(found, output) if output else {}
    _finish({"scene": None} | explanation_summary(found), explanation_lines(found), paths, json_, unmet)


@app.command
def tradeoff(
    scene: ScenePath,
    *,
    output: Folder = None,
    tolerance: Annotated[float, Parameter(help="Largest error of the worst photodiode.")] = 0.02,
    simultaneous: Annotated[
        bool,
        Parameter(negative="", help="Hold all readings and signals to it at once, with 95 % probability."),
    ] = False,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Measure error against processor time for every level of model; the fastest answer within a tolerance.

    Writes tradeoff.json, tradeoff.nc and tradeoff.html, tradeoff.png for a README, and scene.toml: the scene at that
    level.
    """
    from .report.model_errors import tradeoff_lines, tradeoff_summary
    from .report.result_files import TRADEOFF, write_tradeoff
    from .studies.model_error.tradeoff import tradeoff as study

    loaded, _ = _load(scene, options)
    folder = _results(output, scene, TRADEOFF)
    found, unmet = _traced(study, loaded, tolerance=tolerance, simultaneous=simultaneous, options=options)
    paths = write_tradeoff(found, folder)
    _finish(tradeoff_summary(found), tradeoff_lines(found), paths, json_, unmet, folder)


@app.command
def check(
    scene: ScenePath,
    *,
    verbose: Annotated[
        bool, Parameter(name=["--verbose", "-v"], negative="", help="Test the geometry with random rays, too.")
    ] = False,
    json_: Json = False,
) -> None:
    """Check a scene: what was read, what is lit, distances, what is ignored, and what any command would refuse."""
    from .report.scene_description import blood_words, body_words, touch_words
    from .report.terminal_text import check_lines
    from .studies.scene_check import check_scene

    with collected_warnings() as warnings:
        loaded = _scene(scene)
    try:
        report: dict[str, Any] = {"scene": scene, "valid": True, **check_scene(loaded)}
        report["warnings"] = warnings + report["warnings"]
        if loaded.finger is not None:
            from .geometry import build, check_watertight

            mesh = build(loaded)
            report |= {"touch": touch_words(loaded), "blood": blood_words(loaded), "body": body_words(loaded)}
            report |= {"vessels": loaded.blood.parameters, "regions": list(mesh.regions)}
            report["triangles"] = len(mesh.triangles)
            if verbose:
                found = check_watertight(mesh, crossings=100_000)
                report |= {**vars(found), "valid": bool(found.passed)}
    except InputError as error:
        raise InputError(f"{scene}: {error}") from None
    _finish(report, check_lines(report), {}, json_)
    if not report["valid"]:
        raise NailopticsError(f"{scene}: its geometry leaks; please report the scene.")


@app.command
def export(
    scene: ScenePath,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="File, or folder where a format needs several.")],
    format_: Annotated[
        Literal["glb", "ply", "mmc", "mcx", "mitsuba"] | None,
        Parameter(name="--format", help="What to write, unless the ending of the file's name says it."),
    ] = None,
    voxel_mm: Annotated[float | None, Parameter(help="Side of mcx's voxels; 0.1 if not given. [mm]")] = None,
    json_: Json = False,
) -> None:
    """Write the finger and the board for another program: a mesh (glb, ply), or what it needs to trace the light.

    A folder holds a README with what of the scene does not carry over.
    """
    from .exports.formats import export as write

    try:
        paths = write(_scene(scene), output, format=format_, voxel_mm=voxel_mm)
    except WriteError:
        raise
    except InputError as error:
        raise InputError(f"{scene}: {error}") from None
    _finish({}, [], paths, json_)


@app.command
def compare_with(
    file: Annotated[Path, Parameter(help="What the runner of an export wrote, such as detected.npz.")],
    *,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Compare what another program detected of an exported scene with our own trace of it, with chi^2.

    Readings, their change with the blood and mean paths, each with its standard error and the z score of the
    difference.
    """
    from .exports.other_program import compare_with as study

    found, unmet = _traced(study, file, options=options)
    _finish(found.as_dict(), found.lines(), {}, json_, unmet)


@app.command
def figures(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder for the pictures.")],
    sets: Annotated[
        tuple[str, ...], Parameter(name="--set", negative="", help="Named parameter sets; all if not given.")
    ] = (),
    touch: Annotated[
        Path | None, Parameter(help="Recorded touch for Figs. 16, 18, a CSV with time_s, force_n; else the subjects'.")
    ] = None,
    colour: Annotated[bool, Parameter(help="Trace Fig. 2, the nail under force, some seconds a set.")] = True,
    json_: Json = False,
) -> None:
    """Draw the paper's Fig. 4, and Figs. 2, 10-12 and 15-18 from parameter sets, and judge its claims."""
    import numpy as np

    from . import hemodynamics
    from .paper.claims import as_rows, as_text, judge
    from .paper.responses import pressed, simulate_responses
    from .report.pages.colour import draw_fig2
    from .report.pages.paper import draw, draw_haemoglobins
    from .scene.touch import read_recording

    course = None if touch is None else [np.asarray(column) for column in read_recording(touch)]
    judged, pictures = {}, []
    named = {name: hemodynamics.parameters(name) for name in sets or hemodynamics.NAMES}
    make_folder(output)
    for name, parameters in named.items():
        responses = simulate_responses(parameters)
        recorded = None if course is None else (course[0], course[1], pressed(parameters, *course))
        pictures += draw(output, responses, name=name, recorded=recorded)
        judged[name] = judge(responses)
    pictures.append(draw_haemoglobins(output))
    if colour:
        from .light import backend as backends

        if backends.choose("auto").jit:
            pictures += [draw_fig2(_scene("nail_colour"), output, name=name) for name in named]
        else:
            say("Fig. 2 is left out: it needs a backend that compiles kernels (nailoptics doctor).")
    claims = {"claims": as_rows(judged), "pictures": list(map(str, pictures))}
    _finish(claims, [*as_text(judged).splitlines(), *pictures], {}, json_)


@app.command
def calibrate(
    scene: ScenePath,
    recordings: Annotated[list[Path], Parameter(help="Recordings of a known force (CSV), one or more.")],
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Subject file to write.")] = Path("subject.toml"),
    model: Annotated[
        Literal["network", "paper"],
        Parameter(
            help="network: the person's vessels on traced light; paper: offset and scale of (9), time constants."
        ),
    ] = "network",
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Calibrate a person's sensor with recordings of a known force: gains, offsets, vessels, with their errors.

    A recording has columns time_s, force_n, one of volts for each reading, and site (proximal, distal or even). Writes
    the subject file and a page beside it. --max-seconds bounds the trace; the fit to the recordings follows.
    """
    from .report.result_files import write_calibration
    from .report.summaries import calibration_summary
    from .studies.force.calibrate import calibrate as study

    if output.suffix != ".toml":
        raise InputError(f"{output}: a subject file ends in .toml; rename it.")
    loaded, _ = _load(scene, options)
    check_writable(output.parent, output.name, output.with_suffix(".html").name)
    result, unmet = _traced(study, loaded, recordings, model=model, options=options)
    summary = calibration_summary(result)
    for line in summary["warnings"]:
        say(line)
    text = [
        f"rms error on the calibration recordings {1e3 * summary['rms_n']:.0f} mN; "
        f"95 % interval of a touch {_half_width(summary['half_width_n'])}"
    ]
    _finish(summary, text, write_calibration(result, output), json_, unmet, output)


def _half_width(half_width_n: float) -> str:
    """Half the width of most intervals in words."""
    return f"+- {1e3 * half_width_n:.0f} mN (median)" if math.isfinite(half_width_n) else "mostly without upper bound"


@app.command
def predict(
    subject: Annotated[Path, Parameter(help="Subject file that calibrate wrote.")],
    readings: Annotated[
        str,
        Parameter(help="Recording (CSV), or - for lines that come one by one on stdin.", allow_leading_hyphen=True),
    ],
    *,
    output: Annotated[
        Path | None, Parameter(name=["--output", "-o"], help="Folder for the results; results/READINGS if not given.")
    ] = None,
    press: Annotated[float, Parameter(help="Force at which the virtual switch closes. [N]")] = 0.5,
    release: Annotated[float, Parameter(help="Force below which it opens. [N]")] = 0.3,
    smooth: Annotated[bool, Parameter(help="Use the samples after each as well, not only those before it.")] = False,
    json_: Json = False,
) -> None:
    """Estimate force over time, with its 95 % interval, from a calibrated person's readings.

    Writes predict.csv, predict.nc, predict.html and predict.png; with - each line is answered at once on stdout.
    """
    from .report.result_files import PREDICTION, write_prediction
    from .report.summaries import prediction_summary
    from .studies.force.live import live
    from .studies.force.predict import TOUCH_N
    from .studies.force.predict import predict as study
    from .studies.force.subject import read_subject

    if readings.startswith("-") and readings != "-":
        raise InputError(f"Unknown option: {readings} (nailoptics predict --help lists the options)")
    calibrated = read_subject(subject)
    if readings == "-":
        if json_ or smooth or output is not None:
            raise InputError(
                "predict -: answers line by line on stdout; leave out --json and -o, and --smooth, or give a recording."
            )
        with suppress(KeyboardInterrupt):
            for line in live(calibrated, text_lines(sys.stdin)):
                print(line, flush=True)
        return
    folder = _results(output, readings, PREDICTION)
    result = study(calibrated, readings, press_n=press, release_n=release, smooth=smooth)
    summary, paths = prediction_summary(result), write_prediction(result, folder)
    upper = f"no upper bound above {summary['open_above_n']:.2f} N (vessels closed)"
    lines = [f"{result.sizes['time']} samples; {upper}"]
    if math.isfinite(summary["rms_n"]):
        lines.append(f"rms {1e3 * summary['rms_n']:.0f} mN, {summary['coverage_95']:.0%} inside their 95 % interval")
    if math.isfinite(summary["touch_rms_n"]):
        lines.append(
            f"touches of {TOUCH_N:g} N or more: rms {1e3 * summary['touch_rms_n']:.0f} mN, "
            f"{summary['touch_coverage_95']:.0%} inside; interval {_half_width(summary['half_width_n'])}"
        )
    for line in summary["warnings"]:
        say(line)
    if not summary["consistent"]:
        say(f"the readings are inconsistent with this subject: {summary['misfit']}.")
    _finish(summary, lines, paths, json_)


@app.command
def oximeter(
    scene: ScenePath,
    *,
    output: Folder = None,
    readings: Annotated[
        Path | None, Parameter(help="A recording (CSV): estimate its oxygen over time, by the scene's curve.")
    ] = None,
    recording: Annotated[
        Path | None, Parameter(help="Write what the oximeter would record, noise included, to this CSV file, too.")
    ] = None,
    json_: Json = False,
    options: Options = USUAL,
) -> None:
    """Simulate a pulse oximeter: R against saturation, SpO2 with its error, what disturbs it; or read a recording.

    The relative error that is requested is that of R on the best photodiode. Writes oximeter.nc, oximeter.html and
    oximeter.png, and of a recording oxygen.nc, oxygen.csv and oxygen.html. A recording has time_s and columns
    LED:PHOTODIODE, or time_s, slot and a column for each photodiode, in volts.
    """
    from .report.result_files import (
        OXIMETER,
        OXYGEN,
        write_oximeter_recording,
        write_oximeter_result,
        write_oxygen,
    )
    from .report.summaries import oximeter_summary, recording_summary
    from .report.terminal_text import oximeter_lines, oxygen_lines
    from .studies.oximetry.oxygen import oximeter as study
    from .studies.oximetry.recording import read_for, simulated, spo2_over_time

    loaded, _ = _load(scene, options)
    given = None if readings is None else read_for(loaded, readings)
    folder = _results(output, scene, OXIMETER if given is None else (*OXIMETER, *OXYGEN))
    _check_file(recording)
    result, unmet = _traced(study, loaded, options=options)
    for line in result.attrs["warnings"]:
        say(line)
    summary, paths = oximeter_summary(result), write_oximeter_result(result, folder)
    lines = oximeter_lines(summary)
    if recording is not None:
        made = simulated(loaded, result, seed=options.seed)
        paths |= write_oximeter_recording(made, (str(result.led.values[0]), str(result.led.values[1])), recording)
    if given is not None:
        oxygen = spo2_over_time(given, result, loaded)
        summary |= {"recording": recording_summary(oxygen)}
        lines, paths = oxygen_lines(summary["recording"]), paths | write_oxygen(oxygen, folder)
    _finish(summary, lines, paths, json_, unmet, folder)


@app.command
def schema(
    *, of: Annotated[Literal["scene", "sweep"], Parameter(help="Which file the schema is for.")] = "scene"
) -> None:
    """Print the JSON Schema of scene files, or of sweep files, for editors."""
    from . import scene
    from .scene.sweep import sweep_json_schema

    # As scenes/scene.schema.json is, byte for byte.
    print_json(sweep_json_schema() if of == "sweep" else scene.json_schema(), indent=1)


@app.command(name="store")
def show_store(
    *,
    list_: Annotated[
        bool, Parameter(name="--list", negative="", help="List what is stored, longest unused first.")
    ] = False,
    clear: Annotated[bool, Parameter(negative="", help="Remove all of it.")] = False,
    json_: Json = False,
) -> None:
    """Show the folder and size of the cache of traced light; NAILOPTICS_STORE names another folder, or off."""
    from .light.tracing.store import VARIABLE, LightStore, entries, remove

    store = LightStore.of_user()
    if store is None:
        raise InputError(f"{VARIABLE} = off: no light is stored; unset it, or set it to a folder.")
    found = entries(store)
    if clear:
        for folder in store.folders():
            remove(folder)
    size = sum(entry.bytes for entry in found)
    summary = {"folder": str(store.root), "lights": len(found), "bytes": size, "most_bytes": int(store.most_bytes)}
    shown = [vars(entry) for entry in found] if list_ else []
    line = f"{store.root}: {len(found)} lights, {size / 1e6:.1f} MB of at most {store.most_bytes / 1e6:.0f}"
    lines = [*(found if list_ else []), line + (", removed" if clear else "")]
    _finish(summary | ({"entries": shown} if list_ else {}) | {"cleared": clear}, lines, {}, json_)


@app.command
def doctor(*, json_: Json = False) -> None:
    """Show the backends of this machine, the engines that each can run, and why each was or was not selected."""
    from .light import backend as backends

    chosen, stock, findings = backends.choose("auto"), backends.choose("auto", volpath=True), backends.findings()
    summary: dict[str, Any] = {"backend": chosen.name, "library": chosen.library, "advice": chosen.advice}
    summary["engines"] = {"photons": chosen.name if chosen.jit else None, "volpath": stock.name}
    summary["findings"], lines = [], []
    for f in findings:
        row = {name: getattr(f, name) for name in ("library", "usable", "engines", "why")}
        summary["findings"].append({"backend": f.name} | row)
        selected = "selected" if (f.name, f.library) == (chosen.name, chosen.library) else ""
        engines = ", ".join(f.engines) or "not usable"
        lines.append(f"  {f.name:<7} {engines:<17} {selected:<9}{f.library or ''} {f.why}".rstrip())
    photons = f"photons runs on {chosen.name}" if chosen.jit else "photons cannot run here"
    lines = [
        f"{photons}: the engine of every command",
        f"volpath runs on {stock.name}: stock Mitsuba, the reference of simulate, trace and batch",
        "backends found on this machine, and the engines that each can run:",
        *lines,
    ]
    lines += dict.fromkeys(one.advice for one in (chosen, stock) if one.advice)
    _finish(summary, lines, {}, json_)


def _load(name: str, options: TraceOptions) -> "tuple[Scene, str]":
    """A scene and the engine that will trace it; says in one line what would be faster if it is the slow one."""
    from .light import backend as backends
    from .light.detect import engine_for

    scene, chosen = _scene(name), backends.choose(options.backend)
    if chosen.name == "scalar" and chosen.advice and options.backend == "auto":
        say(chosen.advice)
    return scene, engine_for(scene, chosen)


def _scene(name: str) -> "Scene":
    """The scene at a path, or the shipped one of that name."""
    from .scene import load_scene

    return load_scene(name)


def _results(output: Path | None, scene: str, files: tuple[str, ...]) -> Path:
    """The folder for the results of a scene; raises WriteError where these files cannot be written in it."""
    folder = output or Path("results") / Path(scene).stem
    check_writable(folder, *files)
    return folder


def _check_file(path: Path | None) -> None:
    """Raise WriteError where a file, if there is to be one, cannot be written."""
    if path is not None:
        check_writable(path.parent, path.name)


def _traced(
    study: Callable[..., Any], *arguments: Any, options: TraceOptions, **parameters: Any
) -> tuple[Any, NotReachedError | None]:
    """The result of a study as far as it was reached, and why not all of it, with its progress on the terminal."""
    with trace_progress() as progress:
        return as_far_as_reached(study, *arguments, progress=progress, **parameters, **_limited(options).fields)


def _limited(options: TraceOptions) -> TraceOptions:
    """The options with the part of max_seconds that bounds the tracing."""
    limit_s = options.max_seconds
    return options if limit_s is None else replace(options, max_seconds=(1 - RESERVE) * limit_s)


def _finish(
    summary: Mapping[str, Any],
    text: Iterable[object],
    paths: Mapping[str, Path],
    as_json: bool,
    unmet: NotReachedError | None = None,
    where: Path | None = None,
) -> None:
    """Print a result and where it lies, as one JSON object or lines of text, and raise what was not reached.

    where : what the error calls the place of the results.
    """
    cut_off = {"cut_off": str(unmet)} if unmet else {}
    if as_json:
        print_json({**summary, **cut_off, **{name: str(path) for name, path in paths.items()}})
    else:
        # A study's own table has several lines; a text or a path, and what is called so, one.
        shown = [escaped(str(one), lines=not isinstance(one, str | Path)) for one in (*text, *paths.values())]
        if unmet and not shown[0].startswith("Cut off: "):
            shown.insert(0, escaped(f"Cut off: {unmet}"))
        print(*shown, sep="\n")
    if unmet:
        raise NotReachedError(
            f"{unmet} What was reached is in {where}." if where else str(unmet), full=unmet.exit_code == 1
        )
