"""Run pmmc or pmcx on a session of this folder and save what its photodiodes detected; needs NumPy and that program.

    python run_pmmc.py 1_NAME.json --photons 1000000 --seed 1 -o detected.npz

pmmc looks for an OpenCL device even where it computes on the processor; PoCL is one that every machine can have. pmcx
needs a GPU; with --opencl pmcxcl takes its place, which is MCX for OpenCL: with PoCL that is any processor.
"""

import argparse
import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np

# Looked up so far behind the place where a photon left MMC's mesh, to see what it went into. [mm]
BEHIND_MM = 1e-3
POINTS_AT_ONCE = 4096
# A photodiode's voxels end photons so near its plane: half the diagonal of a voxel is 0.87 of its side. [voxels]
NEAR = 0.9


def config(session: dict[str, Any], *, photons: int, seed: int) -> dict[str, Any]:
    """Keyword arguments that `pmmc.run` and `pmcx.run` share."""
    return {
        "nphoton": photons,
        "seed": seed,
        "prop": np.array([[m["mua"], m["mus"], m["g"], m["n"]] for m in session["Domain"]["Media"]]),
        "detpos": np.array([[*one["Pos"], one["R"]] for one in session["Optode"]["Detector"]]),
        "tstart": session["Forward"]["T0"],
        "tend": session["Forward"]["T1"],
        "tstep": session["Forward"]["Dt"],
        "isreflect": session["Session"]["DoMismatch"],
        "issavedet": 1,
        "issave2pt": 0,
        # A photon that roulette lets live cannot be distinguished from others among those detected.
        "minenergy": 0.0,
    }


def mmc_config(session: dict[str, Any], *, source: int, photons: int, seed: int, threads: int = 0) -> dict[str, Any]:
    """Keyword arguments of `pmmc.run` for one of a session's cones of light, which make up the Lambertian die."""
    cone, elements = session["nailoptics"]["sources"][source], np.asarray(session["Mesh"]["MeshElem"])
    own = {
        "node": np.asarray(session["Mesh"]["MeshNode"]),
        "elem": elements[:, :4],
        "elemprop": elements[:, 4],
        "srctype": "cone",
        "srcpos": cone["position_mm"],
        "srcdir": session["Optode"]["Source"]["Dir"],
        "srcparam1": [cone["half_angle_rad"], 0.0, 0.0, 0.0],
        "issaveexit": 1,
        "compute": "sse",
        "method": "elem",
        "flog": 0,
    }
    return config(session, photons=photons, seed=seed) | own | ({"nthread": threads} if threads else {})


def photodiode_at(session: dict[str, Any], places_mm: np.ndarray) -> np.ndarray:
    """Which photodiode of MMC's mesh each place (n, 3) lies in, (n,) int; -1 where none."""
    mesh, photodiode = session["Mesh"], np.full(len(places_mm), -1)
    nodes, elements = np.asarray(mesh["MeshNode"]), np.asarray(mesh["MeshElem"])
    for number, own in enumerate(session["nailoptics"]["photodiode_elements"]):
        corners = nodes[elements[np.array(own) - 1, :4] - 1]
        inverse = np.linalg.inv((corners[:, 1:] - corners[:, :1]).swapaxes(1, 2))
        for start in range(0, len(places_mm), POINTS_AT_ONCE):
            offset = places_mm[start : start + POINTS_AT_ONCE, None] - corners[:, 0]
            share = np.einsum("tij,ptj->pti", inverse, offset)
            inside = (share > -1e-9).all(-1) & (share.sum(-1) < 1 + 1e-9)
            photodiode[start : start + POINTS_AT_ONCE][inside.any(1)] = number
    return photodiode


def run_mmc(session: dict[str, Any], *, photons: int, seed: int, threads: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Photodiode (k,) of each photon in pmmc that went into one, its path (k, absorbers) [mm], and photons sent."""
    import pmmc

    media, sources = len(session["nailoptics"]["absorbers"]), len(session["nailoptics"]["sources"])
    # Of all cones alike many, at least so many as were requested.
    per_cone = -(-photons // sources)
    which, paths = [np.empty(0, int)], [np.empty((0, media))]
    for source in range(sources):
        one = mmc_config(session, source=source, photons=per_cone, seed=seed * sources + source, threads=threads)
        # Rows: detector, scatterings and path in each medium, where and which way the photon left, its first weight.
        rows = np.asarray(pmmc.run(**one).get("detp", np.empty((8 + 2 * media, 0))), float)
        place, way = rows[1 + 2 * media : 4 + 2 * media].T, rows[4 + 2 * media : 7 + 2 * media].T
        photodiode = photodiode_at(session, place + BEHIND_MM * way)
        which.append(photodiode[photodiode >= 0])
        paths.append(rows[1 + media : 1 + 2 * media].T[photodiode >= 0])
    return np.concatenate(which), np.concatenate(paths), per_cone * sources


def volume(session: dict[str, Any], folder: Path) -> np.ndarray:
    """The labels of MCX's voxels, x first."""
    domain = session["Domain"]
    return np.fromfile(folder / domain["VolumeFile"], np.uint8).reshape(domain["Dim"], order="F")


def mcx_config(session: dict[str, Any], folder: Path, *, photons: int, seed: int) -> dict[str, Any]:
    """Keyword arguments of `pmcx.run` for a session. Places are in voxels."""
    source = session["Optode"]["Source"]
    return config(session, photons=photons, seed=seed) | {
        "vol": volume(session, folder),
        "unitinmm": session["Domain"]["LengthUnit"],
        "issrcfrom0": 1,
        "srctype": "planar",
        "srcpos": source["Pos"],
        # A focal length of minus infinity is a Lambertian emitter.
        "srcdir": [*source["Dir"][:3], -np.inf],
        "srcparam1": source["Param1"],
        "srcparam2": source["Param2"],
        "bc": session["Session"]["BCFlags"],
        "savedetflag": session["Session"]["SaveDataMask"].lower(),
        "maxdetphoton": min(photons, 20_000_000),
        "autopilot": 1,
        "gpuid": 1,
    }


def detected(session: dict[str, Any], rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Photodiode (k,) of each photon in MCX that went into one, and its path in each absorber, (k, absorbers). [mm]

    rows : (1 + media + 6, n) float. Detector, path in each medium [voxels], where and which way each photon left.
    """
    media, absorbers = len(session["Domain"]["Media"]) - 1, len(session["nailoptics"]["absorbers"])
    place, way = rows[1 + media : 4 + media].T, rows[4 + media : 7 + media].T
    photodiode = np.full(len(place), -1)
    for number, quads in enumerate(session["nailoptics"]["photodiode_quads"]):
        for quad in np.array(quads):
            sides, offset = (quad[1] - quad[0], quad[3] - quad[0]), place - quad[0]
            # Corners go counter-clockwise seen from the nail, so that this points to it.
            normal = np.cross(*sides)
            over = (np.abs(offset @ normal) < NEAR * np.linalg.norm(normal)) & (way @ normal < 0)
            for side in sides:
                share = offset @ side / (side @ side)
                over &= (share >= 0) & (share < 1)
            photodiode[over] = number
    paths = rows[1 : 1 + absorbers].T * session["Domain"]["LengthUnit"]
    return photodiode[photodiode >= 0], paths[photodiode >= 0]


def main() -> None:
    """Run a session and write FILE.npz, which `nailoptics compare-with` reads."""
    parser = argparse.ArgumentParser(description="Run a session and save what its photodiodes detected.")
    parser.add_argument("session", type=Path, help="session that nailoptics wrote, such as 1_NAME.json")
    parser.add_argument("--photons", type=int, help="those that the session names if not given")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=0, help="of the processor, for pmmc; all if not given")
    parser.add_argument("--opencl", action="store_true", help="run pmcxcl in place of pmcx")
    parser.add_argument("-o", "--output", type=Path, default=Path("detected.npz"))
    given = parser.parse_args()
    session = json.loads(given.session.read_text(encoding="utf-8"))
    photons = given.photons or session["Session"]["Photons"]
    if "Mesh" in session:
        program = "pmmc"
        # Once, not for every source.
        session["Mesh"] |= {name: np.array(session["Mesh"][name]) for name in ("MeshNode", "MeshElem")}
        which, paths, photons = run_mmc(session, photons=photons, seed=given.seed, threads=given.threads)
    else:
        program = "pmcxcl" if given.opencl else "pmcx"
        how = mcx_config(session, given.session.parent, photons=photons, seed=given.seed)
        which, paths = detected(session, np.asarray(importlib.import_module(program).run(**how)["detp"], float))
    own = {"photons": photons, "seed": given.seed, "program": program}
    own |= {name: session["nailoptics"][name] for name in ("led", "scene")}
    np.savez(given.output, photodiode=which, path_mm=paths, **own)
    print(f"{len(which)} of {photons} photons reached photodiodes: {given.output}")


if __name__ == "__main__":
    main()
