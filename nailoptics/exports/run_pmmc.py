"""Run pmmc on a session of this folder and keep what its photodiodes detected; needs NumPy and pmmc alone.

    python run_pmmc.py 1_NAME.json --photons 1000000 --seed 1 -o detected.npz

pmmc asks OpenCL for a device even where it computes on the processor; PoCL is one that every machine can have.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

# Looked at so far behind the place where a photon left, to see what it went into. [mm]
BEHIND_MM = 1e-3
POINTS_AT_ONCE = 4096


def config(session: dict[str, Any], *, source: int, photons: int, seed: int, threads: int = 0) -> dict[str, Any]:
    """Keyword arguments of `pmmc.run` for one of a session's cones of light, which make up the Lambertian die."""
    extra, mesh, optode = session["nailoptics"], session["Mesh"], session["Optode"]
    elements = np.array(mesh["MeshElem"])
    return {
        "nphoton": photons,
        "seed": seed,
        "node": np.array(mesh["MeshNode"]),
        "elem": elements[:, :4],
        "elemprop": elements[:, 4],
        "prop": np.array([[m["mua"], m["mus"], m["g"], m["n"]] for m in session["Domain"]["Media"]]),
        "srctype": "cone",
        "srcpos": extra["sources"][source]["position_mm"],
        "srcdir": optode["Source"]["Dir"],
        "srcparam1": [extra["sources"][source]["half_angle_rad"], 0.0, 0.0, 0.0],
        "detpos": np.array([[*one["Pos"], one["R"]] for one in optode["Detector"]]),
        "tstart": session["Forward"]["T0"],
        "tend": session["Forward"]["T1"],
        "tstep": session["Forward"]["Dt"],
        "isreflect": session["Session"]["DoMismatch"],
        "issavedet": 1,
        "issaveexit": 1,
        "issave2pt": 0,
        # A photon that roulette lets live cannot be distinguished from others among those detected.
        "minenergy": 0.0,
        "compute": "sse",
        "method": "elem",
        "flog": 0,
    } | ({"nthread": threads} if threads else {})


def photodiode_at(session: dict[str, Any], places_mm: np.ndarray) -> np.ndarray:
    """Which photodiode each place (n, 3) lies in, (n,) int; -1 where none."""
    mesh, found = session["Mesh"], np.full(len(places_mm), -1)
    nodes, elements = np.array(mesh["MeshNode"]), np.array(mesh["MeshElem"])
    for number, own in enumerate(session["nailoptics"]["photodiode_elements"]):
        corners = nodes[elements[np.array(own) - 1, :4] - 1]
        inverse = np.linalg.inv((corners[:, 1:] - corners[:, :1]).swapaxes(1, 2))
        for start in range(0, len(places_mm), POINTS_AT_ONCE):
            offset = places_mm[start : start + POINTS_AT_ONCE, None] - corners[:, 0]
            share = np.einsum("tij,ptj->pti", inverse, offset)
            inside = (share > -1e-9).all(-1) & (share.sum(-1) < 1 + 1e-9)
            found[start : start + POINTS_AT_ONCE][inside.any(1)] = number
    return found


def detected(session: dict[str, Any], *, photons: int, seed: int, threads: int = 0) -> dict[str, Any]:
    """What the photodiodes detect of a session's light: photodiode, path in each medium [mm], and photons sent."""
    import pmmc

    extra = session["nailoptics"]
    media, sources = len(extra["absorbers"]), len(extra["sources"])
    # Of all cones alike many, at least so many as were requested.
    each = -(-photons // sources)
    which, paths = [], []
    for source in range(sources):
        found = pmmc.run(**config(session, source=source, photons=each, seed=seed * sources + source, threads=threads))
        if "detp" not in found:
            continue
        # Rows: detector, scatterings and path in each medium, where and which way the photon left, its first weight.
        rows = np.asarray(found["detp"], float)
        place, way = rows[1 + 2 * media : 4 + 2 * media].T, rows[4 + 2 * media : 7 + 2 * media].T
        photodiode = photodiode_at(session, place + BEHIND_MM * way)
        which.append(photodiode[photodiode >= 0])
        paths.append(rows[1 + media : 1 + 2 * media].T[photodiode >= 0])
    return {
        "photodiode": np.concatenate([np.empty(0, int), *which]),
        "path_mm": np.concatenate([np.empty((0, media)), *paths]),
        "photons": each * sources,
        "led": extra["led"],
        "seed": seed,
        "program": "pmmc",
        "scene": extra["scene"],
    }


def main() -> None:
    """Run a session and write FILE.npz, which `nailoptics compare-with` reads."""
    parser = argparse.ArgumentParser(description="Run pmmc on a session and keep what its photodiodes detected.")
    parser.add_argument("session", type=Path, help="session that nailoptics wrote, such as 1_NAME.json")
    parser.add_argument("--photons", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=0, help="of the processor; all if not given")
    parser.add_argument("-o", "--output", type=Path, default=Path("detected.npz"))
    arguments = parser.parse_args()
    session = json.loads(arguments.session.read_text(encoding="utf-8"))
    found = detected(session, photons=arguments.photons, seed=arguments.seed, threads=arguments.threads)
    np.savez(arguments.output, **found)
    print(f"{len(found['photodiode'])} of {found['photons']} photons reached photodiodes: {arguments.output}")


if __name__ == "__main__":
    main()
