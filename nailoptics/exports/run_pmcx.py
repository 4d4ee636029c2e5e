"""Run pmcx on a session of this folder and keep what its photodiodes detected; needs NumPy, pmcx and a GPU.

    python run_pmcx.py 1_NAME.json --photons 10000000 --seed 1 -o detected.npz

With --opencl it runs pmcxcl, which is MCX for OpenCL: with PoCL that is any processor.
"""

import argparse
import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np

# A photodiode's voxels end photons so near its plane: half the diagonal of a voxel is 0.87 of its side. [voxels]
NEAR = 0.9


def volume(session: dict[str, Any], folder: Path, name: str, kind: Any) -> np.ndarray:
    """A volume of this folder, x first."""
    return np.fromfile(folder / name, kind).reshape(session["Domain"]["Dim"], order="F")


def config(session: dict[str, Any], folder: Path, *, photons: int, seed: int) -> dict[str, Any]:
    """Keyword arguments of `pmcx.run` for a session. Places are in voxels."""
    source, domain = session["Optode"]["Source"], session["Domain"]
    return {
        "nphoton": photons,
        "seed": seed,
        "vol": volume(session, folder, domain["VolumeFile"], np.uint8),
        "prop": [[m["mua"], m["mus"], m["g"], m["n"]] for m in domain["Media"]],
        "unitinmm": domain["LengthUnit"],
        "issrcfrom0": 1,
        "srctype": "planar",
        "srcpos": source["Pos"],
        # A focal length of minus infinity is a Lambertian emitter.
        "srcdir": [*source["Dir"][:3], -np.inf],
        "srcparam1": source["Param1"],
        "srcparam2": source["Param2"],
        "detpos": [[*one["Pos"], one["R"]] for one in session["Optode"]["Detector"]],
        "tstart": session["Forward"]["T0"],
        "tend": session["Forward"]["T1"],
        "tstep": session["Forward"]["Dt"],
        "isreflect": session["Session"]["DoMismatch"],
        "bc": session["Session"]["BCFlags"],
        "issavedet": 1,
        "savedetflag": session["Session"]["SaveDataMask"].lower(),
        "issave2pt": 0,
        "minenergy": 0.0,
        "maxdetphoton": min(photons, 20_000_000),
        "autopilot": 1,
        "gpuid": 1,
    }


def kept(session: dict[str, Any], rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Photodiode of each photon that went into one, (k,) int, and its path in each absorber, (k, absorbers). [mm]

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
    parser = argparse.ArgumentParser(description="Run pmcx on a session and keep what its photodiodes detected.")
    parser.add_argument("session", type=Path, help="session that nailoptics wrote, such as 1_NAME.json")
    parser.add_argument("--photons", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--opencl", action="store_true", help="run pmcxcl in place of pmcx")
    parser.add_argument("-o", "--output", type=Path, default=Path("detected.npz"))
    arguments = parser.parse_args()

    if arguments.opencl:
        program = importlib.import_module("pmcxcl")
    else:
        import pmcx

        program = pmcx
    session, folder = json.loads(arguments.session.read_text(encoding="utf-8")), arguments.session.parent
    found = program.run(**config(session, folder, photons=arguments.photons, seed=arguments.seed))
    which, paths = kept(session, np.asarray(found["detp"], float))
    same = {"photons": arguments.photons, "seed": arguments.seed, "program": program.__name__}
    own = session["nailoptics"]
    np.savez(arguments.output, photodiode=which, path_mm=paths, led=own["led"], scene=own["scene"], **same)
    print(f"{len(which)} of {arguments.photons} photons reached photodiodes: {arguments.output}")


if __name__ == "__main__":
    main()
