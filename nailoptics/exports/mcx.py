"""A finger for MCX, the voxel Monte Carlo: label volume, sessions with media, source and detectors, and a runner."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry import Geometry, build
from ..io import make_folder, write_bytes, write_text
from ..light import optics
from ..scene import Scene, to_toml
from ..scene.rectangles import turned
from .carried import (
    Lost,
    absorber_of,
    as_seen,
    checked_finger,
    epoxy_index,
    lost_everywhere,
    lost_reflection,
    lost_refraction,
    media_table,
    page,
)
from .voxels import DIE_BACK, Voxels, voxels

USUAL_VOXEL_MM = 0.1
PHOTONS = 10_000_000
LABELS = "labels.bin"
# Light that has wandered for so long has been absorbed. [s]
LONGEST_S = 1e-8
# What ends photons has the index of the epoxy and this share of it more, which reflects some 1e-11 of light that comes
# straight. Where both are alike, MCX for OpenCL lets photons go on through label 0, and crashes if it keeps paths.
INDEX_STEP = 1e-5
# Detectors reach so much beyond the corners of their photodiode. [voxels]
AROUND = 3.0


def write_mcx(scene: Scene, folder: Path, *, voxel_mm: float = USUAL_VOXEL_MM) -> dict[str, Path]:
    """Write labels, a session for each LED, a runner and a README to a folder; returns their paths by what they are."""
    seen = as_seen(checked_finger(scene), reflecting=False)
    geometry = build(seen)
    made = voxels(geometry, voxel_mm)
    make_folder(folder)
    paths = {"readme": folder / "README.md", "run": folder / "run_pmcx.py", "scene": folder / "scene.toml"}
    paths["labels"] = folder / LABELS
    write_bytes(paths["labels"], labels(seen, geometry, made).tobytes(order="F"))
    for i, led in enumerate(seen.leds):
        paths[f"led_{i + 1}"] = folder / f"{i + 1}_{led.name}.json"
        write_text(paths[f"led_{i + 1}"], json.dumps(mcx_session(seen, geometry, made, i), indent=1))
    write_text(paths["run"], Path(__file__).with_name("run_pmcx.py").read_text(encoding="utf-8"))
    write_text(paths["scene"], to_toml(seen))
    sessions = [path.name for name, path in paths.items() if name.startswith("led_")]
    write_text(paths["readme"], _readme(scene, geometry, made, sessions))
    return paths


def labels(scene: Scene, geometry: Geometry, made: Voxels) -> np.ndarray:
    """Medium of each voxel, (nx, ny, nz) uint8: 0 ends photons, then the absorbers, and air last."""
    names = optics.absorbers(scene)
    # Only the bed's media change along the nail, and with nothing else.
    middles = made.origin_mm[1] + made.side_mm * (np.arange(made.region.shape[1]) + 0.5)
    places = np.column_stack([np.zeros_like(middles), middles, np.zeros_like(middles)])
    found = np.empty(made.region.shape, np.uint8)
    for region in range(len(geometry.regions)):
        row = absorber_of(scene, geometry, places, np.full(len(places), region))
        row = np.full(len(places), len(names) + 1) if geometry.regions[region] == "air" else row
        np.copyto(found, row.astype(np.uint8)[None, :, None], where=made.region == region)
    return found


def mcx_session(scene: Scene, geometry: Geometry, made: Voxels, led: int) -> dict[str, Any]:
    """A session of MCX for one LED, as JSON; places are in voxels from the lowest corner."""
    die, own, wavelength = geometry.leds[led], scene.leds[led], scene.leds[led].wavelength_nm
    quad, normal = die.quads[0], die.normal[0]
    along, across = (side / np.linalg.norm(side) for side in (quad[1] - quad[0], quad[3] - quad[0]))
    # Turned on the board, the die is one rectangle here, not strips.
    axes = [c * across + s * along for c, s in (turned(unit, own.rotation_deg) for unit in ((1.0, 0.0), (0.0, 1.0)))]
    sides = [axis * size / made.side_mm for axis, size in zip(axes, own.size_mm, strict=True)]
    corner = made.place(die.center_mm) - (sides[0] + sides[1]) / 2
    opaque_index = (1 + INDEX_STEP) * epoxy_index(scene, geometry, wavelength)
    # Air is a medium of its own.
    rows = [[0.0, 0.0, 1.0, opaque_index], *media_table(scene, geometry, led).tolist()]
    rows.append([0.0, 0.0, 1.0, 1.0])
    return {
        "Session": {"ID": f"{led + 1}_{own.name}", "Photons": PHOTONS, "RNGSeed": 1, "DoMismatch": 1}
        # Photons leave the box of voxels without reflection.
        | {"BCFlags": "aaaaaa", "DoPartialPath": 1, "SaveDataMask": "DPXV", "DoSaveVolume": 0},
        "Forward": {"T0": 0.0, "T1": LONGEST_S, "Dt": LONGEST_S},
        "Optode": {
            "Source": {"Type": "planar", "Pos": corner.tolist(), "Dir": [*normal.tolist(), "-_Inf_"]}
            | {f"Param{k + 1}": [*side.tolist(), 0.0] for k, side in enumerate(sides)},
            "Detector": [
                {
                    "Pos": made.place(face.center_mm).tolist(),
                    "R": float(np.linalg.norm(face.quads - face.center_mm, axis=-1).max() / made.side_mm + AROUND),
                }
                for face in geometry.photodiodes
            ],
        },
        "Domain": {
            "VolumeFile": LABELS,
            "Dim": list(made.region.shape),
            "OriginType": 1,
            "LengthUnit": made.side_mm,
            "MediaFormat": "byte",
            "Media": [dict(zip(("mua", "mus", "g", "n"), row, strict=True)) for row in rows],
        },
        "nailoptics": {
            "led": led,
            "wavelength_nm": wavelength,
            "origin_mm": made.origin_mm.tolist(),
            "absorbers": list(optics.absorbers(scene)),
            "photodiodes": [face.name for face in geometry.photodiodes],
            "photodiode_quads": [made.place(face.quads).tolist() for face in geometry.photodiodes],
            "scene": to_toml(scene),
        },
    }


def staircase(geometry: Geometry, made: Voxels) -> list[str]:
    """How far voxels are from the geometry, as lines of a table: volumes of regions and areas of interfaces."""
    volume = np.bincount(made.region.ravel(), minlength=len(geometry.regions)) * made.side_mm**3
    lines = ["| region or interface | exact | voxels | error |", "|---|---|---|---|"]
    rows = [
        (name, exact, volume[i], "mm^3")
        for i, (name, exact) in enumerate(geometry.volumes_mm3().items(), start=1)
        if exact > 0 and name in (*optics.TISSUES, "barrier")
    ]
    clear = [geometry.regions.index(name) for name in ("air", *optics.TISSUES)]
    for (one, other), triangles in geometry.interfaces().items():
        if one in clear and other in clear:
            a, b, c = geometry.vertices[triangles].swapaxes(0, 1)
            exact = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
            name = f"{geometry.regions[one]}, {geometry.regions[other]}"
            rows.append((name, exact, made.area_mm2(one, other), "mm^2"))
    return lines + [f"| {name} | {a:.4g} {unit} | {b:.4g} {unit} | {b / a - 1:+.1%} |" for name, a, b, unit in rows]


def _lost(scene: Scene, geometry: Geometry, made: Voxels) -> list[Lost]:
    there = f"cubes of {made.side_mm:g} mm: faces lie along the axes, with more area and other normals (table above)"
    behind = DIE_BACK * made.side_mm
    return [
        Lost("shape", "tetrahedra that conform to the interfaces", there),
        Lost("emission of the LEDs", "Lambertian, from the whole die", "the same: planar, focal length -inf"),
        Lost("faces of dies", "where they are", f"shine from there; swallow light {behind:.3f} mm or more behind"),
        Lost("faces of photodiodes", "where they are", "in whole voxels as all faces; their edges are exact"),
        *lost_everywhere(scene),
        *lost_reflection(scene),
        *lost_refraction(scene, geometry),
    ]


def _readme(scene: Scene, geometry: Geometry, made: Voxels, sessions: list[str]) -> str:
    names = ", ".join(f"{i} {name}" for i, name in enumerate(("opaque", *optics.absorbers(scene), "air")))
    shape = " x ".join(map(str, made.region.shape))
    text = [
        f"A fingertip with its sensor for MCX and pmcx (mcx.space): {shape} voxels of {made.side_mm:g} mm, x across "
        "the nail, y to the tip, z out of the nail. No export of this kind has been run in MCX, which needs a "
        "GPU. In pmcxcl, its sister for OpenCL, the eight readings of the prototype came to 9 % above ours in cubes of "
        "0.1 mm, and to 2 % in cubes of 0.05 mm.",
        "",
        *(f"- `{name}`: a session of one LED; coefficients in 1/mm, places in voxels" for name in sessions),
        f"- `{LABELS}`: a medium for each voxel, uint8, x fastest: {names}",
        "- `run_pmcx.py`: runs a session in pmcx, and its function `config` gives the keyword arguments of `pmcx.run`. "
        "A photodiode ends photons as all that is opaque does; by where a photon left, and the way it went, the runner "
        "tells which one it reached. With `--opencl` it runs pmcxcl, MCX for OpenCL, which can do without a GPU",
        "- `scene.toml`: the scene as MCX gets it but for the staircase, for nailoptics",
        "",
        "```",
        f"python run_pmcx.py {sessions[0]} --photons {PHOTONS} --seed 1 -o detected.npz    # --opencl: without a GPU",
        "nailoptics compare-with detected.npz        # its readings beside ours, with chi^2",
        f"mcx -f {sessions[0]}",
        "```",
        "",
        "## The error of the staircase",
        "",
        *staircase(geometry, made),
    ]
    return page("For MCX", text, _lost(scene, geometry, made))
