"""The files that a study leaves in its folder: those of two results never mix."""

import csv
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO, StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..io import make_folder, plain_cell, to_json, turn, write_bytes, write_dataset, write_text
from ..scene import to_toml
from ..scene.importers.sensor_recordings import OximeterRecording, Recording, oximeter_csv, recording_csv

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from numpy.typing import NDArray

    from ..studies.model_error.explain import Explanation
    from ..studies.model_error.tradeoff import Tradeoff

SIMULATION = ("result.nc", "report.html")
COMPARISON = ("compare.nc", "compare.html")
PLACEMENT = (
    "place.nc",
    "ranking.csv",
    "place.html",
    "best.toml",
    "best.csv",
    "best.glb",
    "outline.dxf",
    "best.kicad_pcb",
)
TRADEOFF = ("tradeoff.json", "tradeoff.nc", "tradeoff.html", "tradeoff.png", "scene.toml")

COLOUR = ("colour.nc", "colour.html", "strip.png", "rest.png", "pressed.png", "press.gif")
PREDICTION = ("predict.nc", "predict.csv", "predict.html", "predict.png")
OXIMETER = ("oximeter.nc", "oximeter.html", "oximeter.png")
OXYGEN = ("oxygen.nc", "oxygen.csv", "oxygen.html")

Paths = dict[str, Path]


def write_simulation(result: "xr.Dataset", folder: Path) -> Paths:
    """Write a simulated touch and its report; returns their paths. Raises WriteError, as all functions here."""
    from .pages.simulate.page import write_report

    return _write(result, folder, SIMULATION, write_report)


def write_comparison(result: "xr.Dataset", folder: Path) -> Paths:
    """Write a comparison and its report; returns their paths."""
    from .pages.compare import write_comparison as write_page

    return _write(result, folder, COMPARISON, write_page)


def _write(result: "xr.Dataset", folder: Path, names: tuple[str, str], write_page: Callable[..., None]) -> Paths:
    data, page = (folder / name for name in names)
    with turn(folder):
        write_dataset(result, data)
        write_page(result, page)
    return {"report": page, "result": data}


def write_placement(result: "xr.Dataset", folder: Path, *, negate_x_on_bottom: bool = False) -> Paths:
    """Write a placement, its ranking and report, and the best layout for the next program; returns report and scene.

    negate_x_on_bottom : whether X is negated in the position file for parts on the bottom side.
    """
    from ..exports.mesh_files import export_mesh
    from ..geometry import build
    from ..scene.importers.kicad import write_board
    from ..scene.importers.outlines import write_outline
    from ..scene.importers.positions import write_positions
    from ..studies.placement.result import chosen, kicad_parts, outline, rows
    from .pages.place.page import write_placement as write_page

    data, ranking, page, best_scene, positions, mesh, outline_file, board = (folder / name for name in PLACEMENT)
    best, table = chosen(result), StringIO(newline="")
    lines = csv.DictWriter(table, list(rows(result)[0]))
    lines.writeheader()
    lines.writerows({name: plain_cell(cell) for name, cell in row.items()} for row in rows(result))
    placed = kicad_parts(best)
    sizes = [*(led.size_mm for led in best.leds), *(e.photodiode.size_mm for e in best.layout.photodiodes)]
    with turn(folder):
        write_dataset(result, data)
        write_text(ranking, table.getvalue())
        write_text(best_scene, _cut_off(result.attrs) + to_toml(best))
        write_positions(positions, placed, negate_x_on_bottom=negate_x_on_bottom)
        write_outline(outline_file, outline(result))
        write_board(board, placed, sizes, outline(result))
        export_mesh(build(best), mesh)
        write_page(result, page)
    return {"report": page, "scene": best_scene}


def write_explanation(found: "Explanation", path: Path) -> Paths:
    """Write the scene with only what it requires, and the page of an explanation beside it; returns their paths."""
    from .pages.explain import write_explanation_page

    page = path.with_suffix(".html")
    with turn(path.parent):
        write_text(path, _cut_off(found.attributes) + to_toml(found.required))
        write_explanation_page(found, page)
    return {"report": page, "scene": path}


def write_tradeoff(found: "Tradeoff", folder: Path) -> Paths:
    """Write a tradeoff as JSON, Dataset, page and picture, and the chosen level's scene; returns report and scene."""
    from .model_errors import tradeoff_summary
    from .pages.tradeoff import draw
    from .pages.tradeoff import write_tradeoff as write_page
    from .style import write_figure

    data, dataset, page, picture, scene = (folder / name for name in TRADEOFF)
    with turn(folder):
        write_text(data, to_json(tradeoff_summary(found)) + "\n")
        write_dataset(found.dataset(), dataset)
        drawing = draw(found)
        write_page(found, drawing, page)
        # Once is enough to find room for the labels.
        drawing.set_layout_engine("none")
        write_figure(drawing, picture, dpi=120, facecolor="white")
        write_text(scene, _cut_off(found.attributes) + to_toml(found.scene))
    return {"report": page, "scene": scene}


def write_colour(
    result: "xr.Dataset", folder: Path, *, photographs: "Sequence[NDArray[np.uint8]]", width_mm: float
) -> Paths:
    """Write a nail's colours, their page, strip, photographs at rest and pressed, and the press; returns their paths.

    width_mm : of the nail.
    """
    from .pages.colour import animation, strip_figure, write_colour_page
    from .style import write_figure

    data, page, strip, rest, pressed, press = (folder / name for name in COLOUR)
    pictures = [png(one) for one in photographs]
    moving = animation(result, width_mm=width_mm) if "press_lab" in result else None
    with turn(folder):
        write_dataset(result, data)
        write_colour_page(result, pictures, moving, page)
        write_figure(strip_figure(result, width_mm=width_mm), strip, dpi=150, facecolor="white")
        for path, picture in zip((rest, pressed), pictures, strict=False):
            write_bytes(path, picture)
        if moving:
            write_bytes(press, moving)
    return {"report": page, "result": data}


def png(picture: "NDArray[np.uint8]") -> bytes:
    """A picture (height, width, 3) as a PNG file."""
    from PIL import Image

    data = BytesIO()
    Image.fromarray(picture).save(data, format="PNG")
    return data.getvalue()


def _cut_off(attributes: Mapping[Any, Any]) -> str:
    """The first line of a scene that comes from a study which ended too early to be sure of it."""
    return f"# Cut off: {attributes['cut_off']}\n" if attributes.get("cut_off") else ""


def write_sweep(results: "xr.Dataset", folder: Path, *, failures: Mapping[str, str]) -> Paths:
    """Write the table and the page of a sweep, of what `batch.open_results` returns; returns their paths."""
    from ..batch import write_table
    from .pages.sweep import write_sweep_page

    table, page = folder / "table.csv", folder / "report.html"
    write_table(results, table)
    write_sweep_page(results, page, failures=failures)
    if "photograph" not in results:
        return {"report": page, "table": table}
    from .pages.sweep import contact_sheet
    from .style import write_figure

    sheet = folder / "contact_sheet.png"
    write_figure(contact_sheet(results), sheet, dpi=200, facecolor="white")
    return {"report": page, "table": table, "contact_sheet": sheet}


def write_recording(recording: Recording, path: Path) -> Paths:
    """Write a recording as a CSV; returns its path."""
    make_folder(path.parent)
    write_text(path, recording_csv(recording))
    return {"recording": path}


def write_calibration(result: "xr.Dataset", subject: Path) -> Paths:
    """Write a subject file and, beside it, its page; returns their paths."""
    from .pages.force import write_calibration_page
    from .summaries import calibration_summary

    page = subject.with_suffix(".html")
    make_folder(subject.parent)
    write_text(subject, result.attrs["subject"])
    write_calibration_page(result, calibration_summary(result), page)
    return {"subject": subject, "report": page}


def write_prediction(result: "xr.Dataset", folder: Path) -> Paths:
    """Write a prediction as NetCDF, CSV, page and picture; returns the paths of the first three."""
    from ..studies.force.predict import csv_rows
    from .pages.force import force_figure, write_prediction_page
    from .style import write_figure
    from .summaries import prediction_summary

    data, rows, page, picture = (folder / name for name in PREDICTION)
    with turn(folder):
        write_dataset(result, data)
        write_text(rows, "".join(f"{row}\n" for row in csv_rows(result)))
        write_prediction_page(result, prediction_summary(result), page)
        write_figure(force_figure(result), picture, dpi=120, facecolor="white")
    return {"report": page, "result": data, "csv": rows}


def write_oximeter_result(result: "xr.Dataset", folder: Path) -> Paths:
    """Write an oximeter, its page and a picture; returns the paths of page and dataset."""
    from .pages.oximeter import overview_figure, write_oximeter
    from .style import write_figure

    data, page, picture = (folder / name for name in OXIMETER)
    with turn(folder):
        write_dataset(result, data)
        write_oximeter(result, page)
        write_figure(overview_figure(result), picture, dpi=110, facecolor="white")
    return {"report": page, "result": data}


def write_oximeter_recording(recording: OximeterRecording, leds: tuple[str, str], path: Path) -> Paths:
    """Write an oximeter's recording as a CSV; returns its path."""
    make_folder(path.parent)
    write_text(path, oximeter_csv(recording, leds))
    return {"recording_file": path}


def write_oxygen(result: "xr.Dataset", folder: Path) -> Paths:
    """Write SpO2 over time from an oximeter's recording as NetCDF, CSV and page; returns their paths."""
    from ..studies.oximetry.recording import spo2_rows
    from .pages.oximeter import write_oxygen_recording
    from .summaries import recording_summary

    data, rows, page = (folder / name for name in OXYGEN)
    with turn(folder):
        write_dataset(result, data)
        write_text(rows, "".join(f"{row}\n" for row in spo2_rows(result)))
        write_oxygen_recording(result, recording_summary(result), page)
    return {"report": page, "result": data, "csv": rows}
