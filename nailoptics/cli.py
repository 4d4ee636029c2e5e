"""The command line: parse, call, print."""

import gc
import re
import sys
from contextlib import suppress
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from . import checks, terminal
from .errors import InputError, NotReachedError, RequirementError, WriteError, exit_message
from .io import block_dask_import, check_writable, to_json, write_text
from .options import FormatName, Illuminant, Over, TraceOptions
from .terminal import finish, say, shown, traced
from .version import __version__, commit

if TYPE_CHECKING:
    from .report.files import Report
    from .scene import Scene

app = App(
    name="nailoptics",
    version=lambda: f"{__version__} (commit {known[:12]})" if (known := commit()) else __version__,
    suppress_keyboard_interrupt=False,
    help="Simulate an optical sensor on a fingernail: touch, blood, traced light, photodiode volts.",
    help_epilogue="Terms and symbols: docs/glossary.md in the repository.",
)
app.register_install_completion_command(help="Install tab completion for bash, zsh, fish or PowerShell.")

ScenePath = Annotated[str, Parameter(help="A scene file (TOML), or the name of a shipped one such as prototype.")]
_Output = Parameter(name=["--output", "-o"])
Output = Annotated[Path, _Output]
File = Annotated[Path | None, _Output]
Flag = Annotated[bool, Parameter(negative="")]
Json = Annotated[bool, Parameter(name="--json", negative="", help="Print one JSON object on stdout, nothing else.")]


def _whole(_: object, tokens: Any) -> int:
    """A whole number, 1e6 as well."""
    number = float(tokens[0].value)
    if not number.is_integer():
        raise ValueError(f"{number:g} is not a whole number")
    return int(number)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Traced(TraceOptions):
    """Options of every command that traces light."""

    photons: Annotated[int | None, Parameter(converter=_whole)] = None
    """Photons per LED (or wavelength, where none shines), in place of a tolerance."""
    json: Json = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Study(Traced):
    """Options of every command that leaves its results in a folder."""

    output: File = None
    """Folder for the results; results/SCENE if not given."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class NoTolerance(Traced):
    """Options of a command whose results have no relative error."""

    relative_error: Annotated[float | None, Parameter(show=False)] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ByPhotons(NoTolerance):
    """Options of a command that takes photons alone."""

    max_seconds: Annotated[float | None, Parameter(show=False)] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ColourStudy(NoTolerance, Study):
    """Options of `colour`, whose tolerances are differences of colour."""


TRACED, STUDY, NO_TOLERANCE, BY_PHOTONS, OF_COLOUR = Traced(), Study(), NoTolerance(), ByPhotons(), ColourStudy()


def main() -> None:
    """Run the command line and end the process; `errors` lists the exit codes."""
    block_dask_import()
    for stream in (sys.stdout, sys.stderr):  # names may hold letters that the terminal's encoding lacks
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    code = run(sys.argv[1:])
    # Nor is it searched for garbage several times as the process ends: a seventh of a command that traces nothing.
    gc.freeze()
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code; errors are a line each on stderr."""
    with terminal.plain_messages(), terminal.counted() as interrupts:
        try:
            app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
            if sys.stdout:
                sys.stdout.flush()
            return 0
        except BrokenPipeError:
            terminal.silence_stdout()
            return 0
        except (KeyboardInterrupt, Exception) as error:
            if isinstance(error, CycloptsError):
                error = InputError(f"{error} (nailoptics --help lists commands and options)")
            elif isinstance(error, OSError):
                terminal.silence_stdout()
            lines, code = exit_message(error, interrupted=bool(interrupts))
        for line in lines:
            say(_with_options(line, arguments))
        return code


def _with_options(line: str, arguments: list[str]) -> str:
    """A message with the command's options for its function's arguments: --force[0] = -1.0 for forces_n[0] = -1.0."""
    command = app.parse_commands(arguments)[1][-1]
    for option in command.assemble_argument_collection() if command is not app else ():
        line = re.sub(rf"(^|below ){option.field_info.name.strip('_')}(?=(\[\d+\])? =)", rf"\g<1>{option.name}", line)
        if option.field_info.kind is not option.field_info.KEYWORD_ONLY:
            line = line.replace(f"parameter {option.name} requires an argument", f"needs {option.name[2:].upper()}")
    return line


@app.command
def simulate(scene: ScenePath, *, recording: Path | None = None, options: Study = STUDY) -> None:
    """Simulate a touch: force to volts over time, by traced light and by the paper's Taylor (9) and Beer-Lambert (8).

    Writes result.nc and report.html.

    Args:
        recording: Also write the simulated recording of a worn sensor, noise included, to this CSV file.
    """
    from .report.pages.simulate import SIMULATION
    from .studies.simulate import simulate as study

    folder = _results(options.output, scene, SIMULATION, recording)
    result, unmet = traced(study, _load(scene, options), picture=True, options=options)
    paths = SIMULATION.write(result, folder)
    if recording is not None:
        from .studies.force.reading_table import record

        record(result, seed=options.seed).save(recording)
        paths["recording"] = recording
    finish(paths, *shown(SIMULATION, result), options.json, unmet, folder)


@app.command
def trace(scene: ScenePath, *, output: File = None, options: Traced = TRACED) -> None:
    """Trace the light only: readings at the scene's rest state, and with -o the transfer for any other.

    Args:
        output: File for the transfer, which nailoptics.Transfer.load reads.
    """
    from .light import backend, read_rest
    from .light.detect import engine_for
    from .report.readings import rest_lines

    loaded = _load(scene, options)
    if output is not None and engine_for(loaded, backend.choose(options.backend)) == "volpath":
        raise InputError(f"{output}: volpath traces readings, not a transfer that could be saved; leave -o out.")
    _check_file(output)
    rest, unmet = traced(read_rest, loaded, options=options)
    if output is not None and rest.transfer is not None:
        rest.transfer.save(output)
    finish({"transfer": output} if output else {}, rest.as_dict(), rest_lines(rest), options.json, unmet, output)


@app.command
def colour(
    scene: ScenePath,
    *,
    forces_n: Annotated[tuple[float, ...] | None, Parameter(name="--force", negative="")] = None,
    illuminant: Illuminant | None = None,
    tolerance: float | None = None,
    photograph: bool | None = None,
    options: ColourStudy = OF_COLOUR,
) -> None:
    """Trace the colour of the bare nail and the skin around it under force, as in the paper's Fig. 2.

    Defaults are those of the scene's [colour]. Writes colour.nc, colour.html, the strip of nails, and photographs at
    rest and pressed.

    Args:
        forces_n: Held forces, the first to compare with. May be repeated. [N]
        illuminant: Daylight, an incandescent lamp, or a white LED.
        tolerance: Standard error of the colour at every position (CIEDE2000).
        photograph: Render the finger at rest and pressed (some seconds); by default unless --max-seconds is given.
    """
    from .report.pages.colour import COLOUR
    from .studies.colour.nail_colour import colour as study, photographs

    loaded = _load(scene, options)
    folder = _results(options.output, scene, COLOUR)
    result, unmet = traced(
        study, loaded, forces_n=forces_n, illuminant=illuminant, tolerance=tolerance, options=options
    )
    pictures: list[Any] = []
    try:
        ended = unmet and (not photograph or str(unmet).startswith("interrupted"))
        if not ended and (options.max_seconds is None if photograph is None else photograph):
            with terminal.interruptible() as check:
                # At rest and under the last force.
                for state in dict.fromkeys((0, -1 % result.sizes["state"])) if result.sizes["tile"] > 0 else ():
                    check()
                    pictures += photographs(loaded, result, states=[state], backend=options.backend)
                check()
    except KeyboardInterrupt:
        pictures, unmet = [], NotReachedError("interrupted; photographs are left out.")
    finish(COLOUR.write(result, folder, photographs=pictures), *shown(COLOUR, result), options.json, unmet, folder)


@app.command
def compare(
    scene: ScenePath,
    *,
    over: tuple[Over, ...] = ("force", "blood"),
    require: float | None = None,
    model: Literal["taylor", "beer_lambert"] = "taylor",
    options: Study = STUDY,
) -> None:
    """Compare traced light with the paper's Taylor (9) and Beer-Lambert (8): ranges of validity and causes of errors.

    Writes compare.nc and compare.html.

    Args:
        over: What is swept: force, blood fraction 0-10 %, saturation 1-0.5. May be repeated.
        require: Exit with 4 unless the fitted model stays within this fraction of every reading's swing.
        model: The model that --require tests: Taylor (9) or Beer-Lambert (8).
    """
    from .report.pages.compare import COMPARISON, lines, verdict_line
    from .studies.compare import compare as study, verdict

    require = None if require is None else checks.tolerance("--require", require)
    folder = _results(options.output, scene, COMPARISON)
    result, unmet = traced(study, _load(scene, options), over=over, options=options)
    paths = COMPARISON.write(result, folder)
    decision = verdict(result, tolerance := 0.05 if require is None else require, model=model)
    missed, line = require is not None and decision.outcome == "missed", verdict_line(decision)
    summary = COMPARISON.summary(result) | {"verdict": vars(decision)}
    with suppress(*([NotReachedError] if missed else [])):
        finish(paths, summary, lines(result, tolerance), options.json, unmet, folder)
    if missed:
        raise RequirementError(line)
    if require is not None and decision.outcome == "undecided":
        raise NotReachedError(line)


@app.command
def place(scene: ScenePath, *, verify_with_mitsuba: Flag = False, options: Study = STUDY) -> None:
    """Rank layouts of LEDs and photodiodes by their force resolution, and search for better ones.

    Writes place.nc, ranking.csv, place.html, and the best layout as best.toml, best.csv (KiCad), outline, best.glb
    and best.kicad_pcb: your own board, if the scene's layout came from one, with its parts moved.

    Args:
        verify_with_mitsuba: Also read the best layout by stock Mitsuba: minutes per LED, not counted in --max-seconds.
            Run again after an interrupt, it resumes from the store.
    """
    from .report.pages.placement import PLACEMENT
    from .studies.placement.place import place as study

    folder = _results(options.output, scene, PLACEMENT)
    result, unmet = traced(study, _load(scene, options), verify_with_mitsuba=verify_with_mitsuba, options=options)
    paths = PLACEMENT.write(result, folder, scene_folder=Path(scene).parent)
    paths |= {name: folder / name for name in PLACEMENT.files if folder / name not in paths.values()}
    finish(paths, *shown(PLACEMENT, result, folder=str(folder)), options.json, unmet, folder)


@app.command
def validate(*, data: Path | None = None, output: File = None, options: ByPhotons = BY_PHOTONS) -> None:
    """Compare the model with what was measured on people: nails, skin, pulse and slow waves.

    Writes validation.html. --photons is the number per LED, and the total of rays for colours.

    Args:
        data: Folder of your own tables, with the names and columns of those in assets/real.
        output: Folder for the page; results/validation if not given.
    """
    from .report.pages.validate import VALIDATION
    from .studies.validation.validate import validate as study

    folder = _results(output, "validation", VALIDATION)
    result, unmet = traced(study, data=data, options=options)
    finish(VALIDATION.write(result, folder), *shown(VALIDATION, result), options.json, unmet, folder)


@app.command
def explore(scene: ScenePath, *, output: Output = Path("explore.html"), options: NoTolerance = NO_TOLERANCE) -> None:
    """Make an interactive page: drag LEDs and photodiodes, readings update, from light traced once.

    One file, which any browser opens. --photons is for each of the scene's wavelengths, half of it for 660 and 940 nm.

    Args:
        output: Page to write.
    """
    from .report.pages.explore import EXPLORATION, page
    from .studies.exploration.explore import explore as study

    _check_file(output, ".html", "a page")
    result, unmet = traced(study, _load(scene, options), options=options)
    write_text(output, page(result))
    finish({"page": output}, *shown(EXPLORATION, result, bytes=output.stat().st_size), options.json, unmet, output)


@app.command
def batch(
    sweep: Path,
    *,
    output: File = None,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    dry_run: Flag = False,
    retry_failed: Flag = False,
    status: Flag = False,
    options: Traced = TRACED,
) -> None:
    """Run the remaining scenes of a sweep; a run that was killed is resumed where it was.

    Writes table.csv and report.html beside the results; nailoptics.open_results(DIR) opens them in Python.

    Args:
        sweep: A sweep file (TOML); with --status, the folder of a batch.
        output: Folder of the batch.
        workers: Processes on this machine; one per core if not given.
        scheduler: Dask scheduler to use instead, such as tcp://host:8786.
        shard: I/N: run only the I-th of N parts, for job arrays.
        dry_run: Show how many scenes the sweep has and how many traces they share, and exit.
        retry_failed: Retry the scenes that failed before.
        status: Show the batch's progress and exit.
    """
    from . import batch as batches
    from .hemodynamics.parameters import implausible_constants
    from .report.pages.sweep import write_sweep

    if status:
        now = batches.status(output or sweep)
        return finish({}, vars(now) | {"left": now.left}, [now], options.json)
    planned = batches.load_sweep(sweep)
    for line in implausible_constants(*planned.scenes):
        say(line)
    if dry_run:
        counts = batches.count(planned, **options.fields)
        return finish({}, counts, ["{scenes} scenes, {traces} traces for all".format(**counts)], options.json)
    if output is None:
        raise InputError("batch needs -o DIR, a folder for its results.")
    how: dict[str, Any] = {"workers": workers, "scheduler": scheduler, "shard": shard}
    how |= {"retry_failed": retry_failed, "shown": terminal.batch_progress}
    unmet = None
    try:
        outcome, unmet = traced(batches.run_batch, planned, output, options=options, **how)
        paths = write_sweep(batches.open_results(output), output, failures=outcome.failed)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; finished scenes are in {output}, run again to resume.") from None
    except InputError as error:  # a full disk ended the batch, too, which said so
        raise unmet or error from None
    line = f"{len(outcome.done)} scenes done, {len(outcome.kept)} already done; {outcome.traces} traces for all"
    finish(paths, vars(outcome) | {"results": str(output)}, [line], options.json, unmet)


@app.command
def explain(scene: ScenePath, *, output: File = None, tolerance: float | None = None, options: Traced = TRACED) -> None:
    """List the effects that a scene models or omits, and measure how much each changes the readings.

    Args:
        output: TOML file for the scene with only what it requires; a page beside it.
        tolerance: Relative change of a reading that matters; the scene's error if not given.
    """
    from .report.pages.explain import EXPLANATION
    from .studies.model_error.explain import explain as study

    _check_file(output, ".toml", "a scene file")
    result, unmet = traced(study, _load(scene, options), tolerance=tolerance, options=options)
    paths = EXPLANATION.write(result, output.parent, stem=output.stem) if output else {}
    finish(paths, *shown(EXPLANATION, result), options.json, unmet)


@app.command
def tradeoff(scene: ScenePath, *, tolerance: float = 0.02, options: Study = STUDY) -> None:
    """Measure error against processor time for every level of model; the fastest model within a tolerance.

    Writes tradeoff.json, tradeoff.nc and tradeoff.html, tradeoff.png for a README, and scene.toml: the scene at that
    level.

    Args:
        tolerance: Largest error of the worst photodiode.
    """
    from .report.pages.tradeoff import TRADEOFF
    from .studies.model_error.tradeoff import tradeoff as study

    folder = _results(options.output, scene, TRADEOFF)
    result, unmet = traced(study, _load(scene, options), tolerance=tolerance, options=options)
    finish(TRADEOFF.write(result, folder), *shown(TRADEOFF, result), options.json, unmet, folder)


@app.command
def check(scene: ScenePath, *, json_: Json = False) -> None:
    """Validate a scene and list its LEDs, photodiodes, separations, ignored fields and warnings.

    Readings and their noise are those of a short trace, stored as any other; without a backend that compiles kernels
    they are left out.
    """
    from .report.pages.scene import CHECK
    from .scene import load_scene
    from .studies.scene_check import check as study

    with terminal.collected_warnings() as warnings:
        loaded = load_scene(scene)
    try:
        checked = study(loaded)
        checked["warnings"] = warnings + checked["warnings"]
        summary = {"scene": scene} | CHECK.summary(checked)
    except InputError as error:
        raise InputError(f"{scene}: {error}") from None
    finish({}, summary, CHECK.lines(checked, summary), json_)


@app.command
def export(
    scene: ScenePath,
    *,
    output: Output,
    format_: Annotated[FormatName | None, Parameter(name="--format")] = None,
    voxel_mm: float | None = None,
    json_: Json = False,
) -> None:
    """Write the finger and the board for another program: a mesh (glb, ply), what it needs to trace the light, the
    board (kicad_pcb): your own, if the layout came from one, with its parts where the scene has them, or the circuit
    (spice) with the photocurrents of the touch.

    The README in a folder lists what the format cannot represent.

    Args:
        output: File, or folder where a format needs several.
        format_: What to write, if the file name's extension does not say it.
        voxel_mm: Side of mcx's voxels; 0.1 if not given. [mm]
    """
    from .exports.formats import export as write

    try:
        paths = write(scene, output, format=format_, voxel_mm=voxel_mm, folder=Path(scene).parent)
    except WriteError:
        raise
    except InputError as error:
        raise InputError(f"{scene}: {error}") from None
    finish(paths, {}, [], json_)


@app.command
def compare_with(file: Path, *, options: Traced = TRACED) -> None:
    """Compare another program's detected light of an exported scene with our trace of it, with chi^2.

    Readings, their change with the blood and mean paths, each with its standard error and the z score of the
    difference.

    Args:
        file: What the runner of an export wrote, such as detected.npz.
    """
    from .exports.other_program import compare_with as study

    result, unmet = traced(study, file, options=options)
    finish({}, result.as_dict(), result.lines(), options.json, unmet)


@app.command
def figures(
    *,
    output: Output,
    sets: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    colour: bool = True,
    people: Flag = False,
    json_: Json = False,
) -> None:
    """Draw the paper's Fig. 4, and Figs. 2, 10-12 and 15-18 from parameter sets, and check its claims.

    Args:
        output: Folder for the pictures.
        sets: Named parameter sets; all if not given.
        colour: Trace Fig. 2, the nail under force, some seconds a set.
        people: Draw Figs. 15-18 of the eight people of scenes/subjects, too, and check what the paper says of people;
            their light is traced, a minute of processor time.
    """
    from .report.pages.paper import PAPER, figures as study

    finish({}, *shown(PAPER, study(output, sets, colour=colour, people=people)), json_)


@app.command
def protocol(
    scene: ScenePath,
    force: Annotated[Literal["-"] | None, Parameter(allow_leading_hyphen=True)] = None,
    *,
    output: Output = Path("protocol.csv"),
    seed: int = 0,
    donnings: int = 1,
    json_: Json = False,
) -> None:
    """Write the touches to calibrate a sensor with, four minutes of varied touches on both sides, and a page to follow.

    The CSV has time_s, force_n and proximal_share at the scene's rate; as [touch] file it is that touch.

    Args:
        force: With - a local page shows the target beside the force measured on stdin, in lines of time_s and force_n.
        output: File to write, with its page beside it.
        seed: Seed of the touches; others for another person, or another day.
        donnings: How often the sensor is put on; with 2 it is taken off and put on again halfway.
    """
    from .report.pages.protocol import live_columns, page, serve
    from .scene import digest, load_scene, to_toml
    from .scene.importers.sensor_recordings import samples_by_line
    from .scene.protocol import protocol as draw

    drawn, loaded = draw(seed, donnings=donnings), load_scene(scene)
    made: dict[str, Any] = {"seed": seed, "digest": digest(loaded), "scene": to_toml(loaded)}
    _check_file(output, ".csv", "the file of a protocol")
    measured = samples_by_line(terminal.text_lines(sys.stdin), live_columns) if force else None
    drawn.save(output, sample_rate_hz=loaded.touch.sample_rate_hz)
    paths = {"protocol": output, "report": output.with_suffix(".html")}
    write_text(paths["report"], page(drawn, **made))
    line = f"{drawn.time_s[-1]:.0f} s of touches, first of the proximal side, then of the distal one"
    finish(paths, {"duration_s": float(drawn.time_s[-1])}, [line], json_)
    if measured is not None:
        with suppress(KeyboardInterrupt):
            serve(drawn, measured, say, **made)


@app.command
def calibrate(
    scene: ScenePath, recordings: list[Path], *, output: Output = Path("subject.toml"), options: Traced = TRACED
) -> None:
    """Calibrate a person's sensor with recordings of a known force: gains, offsets, vessels, with their errors.

    A recording has columns time_s, force_n, one of volts for each reading, and site (proximal, distal or even). Writes
    the subject file and a page beside it. --max-seconds bounds the trace; the fit to the recordings follows.

    Args:
        recordings: Recordings of a known force (CSV), one or more.
        output: Subject file to write.
    """
    from .report.pages.force import CALIBRATION
    from .studies.force.calibrate import calibrate as study

    _check_file(output, ".toml", "a subject file")
    result, unmet = traced(study, _load(scene, options), recordings, options=options)
    paths = CALIBRATION.write(result, output.parent, stem=output.stem)
    finish({"subject": output, "report": paths["report"]}, *shown(CALIBRATION, result), options.json, unmet, output)


@app.command
def predict(
    subject: Path,
    readings: Annotated[str, Parameter(allow_leading_hyphen=True)],
    *,
    output: File = None,
    press: float = 0.5,
    release: float = 0.3,
    json_: Json = False,
) -> None:
    """Estimate force over time, with its 95 % interval, from a calibrated person's readings.

    Writes predict.csv, predict.nc, predict.html and predict.png; with - each line is answered at once on stdout.

    Args:
        subject: Subject file that calibrate wrote.
        readings: Recording (CSV), or - to read lines from stdin as they arrive.
        output: Folder for the results; results/READINGS if not given.
        press: Force at which the virtual switch closes. [N]
        release: Force below which it opens. [N]
    """
    from .report.pages.force import PREDICTION
    from .studies.force.predict import live, predict as study
    from .studies.force.subject import load_subject

    if readings.startswith("-") and readings != "-":
        raise InputError(f"Unknown option: {readings} (nailoptics predict --help lists the options)")
    calibrated = load_subject(subject)
    if readings == "-":
        if json_ or output is not None:
            raise InputError("predict -: answers line by line on stdout; leave out --json and -o, or give a recording.")
        if calibrated.quality.fault:
            say(calibrated.quality.fault)
        with suppress(KeyboardInterrupt):
            for line in live(calibrated, terminal.text_lines(sys.stdin)):
                print(line, flush=True)
        return
    folder = _results(output, readings, PREDICTION)
    result = study(calibrated, readings, press_n=press, release_n=release)
    finish(PREDICTION.write(result, folder), *shown(PREDICTION, result), json_)


@app.command
def oximeter(
    scene: ScenePath, *, readings: Path | None = None, recording: Path | None = None, options: Study = STUDY
) -> None:
    """Simulate a pulse oximeter: R against saturation, SpO2 with its error and biases; or evaluate a recording.

    The relative error that is requested is that of R where it is least. Writes oximeter.nc, oximeter.html and
    oximeter.png, and of a recording oxygen.nc, oxygen.csv and oxygen.html. A recording has time_s and columns
    LED:PHOTODIODE in volts; or red, infrared and ambient counts.

    Args:
        readings: A recording (CSV): estimate its oxygen over time, by the scene's curve.
        recording: Also write a simulated recording, noise included, to this CSV file.
    """
    from .report.pages.oximeter import OXIMETER, OXYGEN
    from .scene.importers.sensor_recordings import oximeter_csv
    from .studies.oximetry.oxygen import oximeter as study
    from .studies.oximetry.recording import read_for, simulated, spo2_over_time

    loaded = _load(scene, options)
    given = None if readings is None else read_for(loaded, readings)
    folder = _results(options.output, scene, OXIMETER, recording)
    if given is not None:
        check_writable(folder, *OXYGEN.files)
    result, unmet = traced(study, loaded, options=options)
    paths = OXIMETER.write(result, folder)
    if recording is not None:
        red, infrared = map(str, result.led.values)
        write_text(recording, oximeter_csv(simulated(loaded, result, seed=options.seed), (red, infrared)))
        paths["recording_file"] = recording
    if given is None:
        return finish(paths, *shown(OXIMETER, result), options.json, unmet, folder)
    for line in result.attrs["warnings"]:
        say(line)
    oxygen = spo2_over_time(given, result, loaded)
    summary, over_time = OXIMETER.summary(result), OXYGEN.summary(oxygen)
    paths |= OXYGEN.write(oxygen, folder)
    finish(paths, summary | {"recording": over_time}, OXYGEN.lines(oxygen, over_time), options.json, unmet, folder)


@app.command
def schema(*, of: Literal["scene", "sweep"] = "scene") -> None:
    """Print the JSON Schema of scene files, or of sweep files, for editors.

    Args:
        of: Which file the schema is for.
    """
    from .scene import json_schema
    from .scene.sweep import sweep_json_schema

    # As scenes/scene.schema.json is, byte for byte.
    print(to_json(sweep_json_schema() if of == "sweep" else json_schema(), indent=1))


@app.command(name="store")
def show_store(*, clear: Flag = False, json_: Json = False) -> None:
    """Show the folder and size of the cache of traced light; NAILOPTICS_STORE names another folder, or off.

    Args:
        clear: Remove all of it.
    """
    from .light.tracing.store import VARIABLE, LightStore, remove, size_of

    store = LightStore.of_user()
    if store is None:
        raise InputError(f"{VARIABLE} = off: no light is stored; unset it, or set it to a folder.")
    try:
        stored = list(store.folders())
    except OSError as error:
        raise InputError(f"{store.root}: is not a light store ({error.strerror}); set {VARIABLE} to another.") from None
    size = sum(map(size_of, stored))
    for folder in stored if clear else ():
        remove(folder)
    summary: dict[str, Any] = {"folder": str(store.root), "traces": len(stored), "bytes": size}
    summary |= {"most_bytes": int(store.most_bytes), "cleared": clear}
    line = f"{store.root}: {len(stored)} cached traces, {size / 1e6:.1f} MB of at most {store.most_bytes / 1e6:.0f}"
    finish({}, summary, [f"{line}, removed" if clear else line], json_)


@app.command
def doctor(*, json_: Json = False) -> None:
    """Show the backends of this machine, the engines that each can run, and why each was or was not selected."""
    from .light import backend as backends

    chosen, stock = backends.choose("auto"), backends.choose("auto", volpath=True)
    rows, lines = [], []
    for f in backends.findings():
        rows.append({"backend": f.name, "library": f.library, "usable": f.usable, "engines": f.engines, "why": f.why})
        selected = "selected" if (f.name, f.library) == (chosen.name, chosen.library) else ""
        engines = ", ".join(f.engines) or "not usable"
        lines.append(f"  {f.name:<7} {engines:<17} {selected:<9}{f.library or ''} {f.why}".rstrip())
    summary: dict[str, Any] = {"backend": chosen.name, "library": chosen.library, "advice": chosen.advice}
    summary |= {"engines": {"photons": chosen.name if chosen.jit else None, "volpath": stock.name}, "findings": rows}
    photons = f"photons runs on {chosen.name}" if chosen.jit else "photons cannot run here"
    lines = [
        f"{photons}: the engine of every command",
        f"volpath runs on {stock.name}: stock Mitsuba, the reference of simulate and trace",
        "backends found on this machine, and the engines that each can run:",
        *lines,
        *dict.fromkeys(backend.advice for backend in (chosen, stock) if backend.advice),
    ]
    finish({}, summary, lines, json_)


def _load(name: str, options: TraceOptions) -> "Scene":
    """A scene; says if a slow engine will trace it, or if vessels are far off the list."""
    from .hemodynamics.parameters import implausible_constants
    from .light import backend as backends
    from .scene import load_scene

    scene = load_scene(name)
    for line in filter(None, (backends.choose(options.backend).advice, *implausible_constants(scene))):
        say(line)
    return scene


def _results(output: Path | None, scene: str, report: "Report", other: Path | None = None) -> Path:
    """The folder for the results of a scene; raises WriteError where they, or another file, cannot be written."""
    folder = output or Path("results") / Path(scene).stem
    check_writable(folder, *report.files)
    _check_file(other)
    return folder


def _check_file(path: Path | None, suffix: str = "", what: str = "") -> None:
    """Raise WriteError where a file, if there is to be one, or a page beside it cannot be written.

    suffix, what : what its name must end in, and what it is.
    """
    if path is None:
        return
    if suffix and path.suffix != suffix:
        raise InputError(f"{path}: {what} ends in {suffix}; rename it.")
    check_writable(path.parent, path.name, *([path.with_suffix(".html").name] if suffix else []))
