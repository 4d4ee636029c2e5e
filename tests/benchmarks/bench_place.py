"""What a placement costs. Run: python bench_place.py [max_seconds]

Prints, for the shipped scene (one LED and eight photodiodes over the whole nail of an index finger, two cases of it):
the time of the whole placement, its search and result, and whether it reached what the scene requires; and the time of
a further candidate on a board whose light is traced. The first must stay below 600 s on two cores, the other below
50 ms.
"""

import os
import statistics
import sys
import time

import xarray as xr

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.errors import NotReachedError
from nailoptics.studies.placement import boards, candidates, photon_maps, place, result
from nailoptics.studies.placement.objective import Objective, scores_of

CANDIDATES = 20


def main() -> None:
    """The whole placement, then a further candidate."""
    scene = nail.load_scene(data_dir("scenes") / "placement.toml")
    limit = float(sys.argv[1]) if len(sys.argv) > 1 else None
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    begin, cpu, unmet = time.perf_counter(), time.process_time(), "reached"
    try:
        computed = place.place(scene, max_seconds=limit)
    except NotReachedError as error:
        computed, unmet = error.result, str(error)
    wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
    print(f"whole placement        {wall:8.1f} s, {cpu:.0f} s of processor time; {unmet}")
    print(f"  {computed.sizes['led_site']} LED places tried, {computed.attrs['photons'] / 1e6:.0f} M photons")
    for row in result.rows(computed):
        error = row["force_resolution_n_stderr"]
        print(f"  {row['rank']:2d} {row['layout']:22s} {1e3 * row['force_resolution_n']:.3f} +- {1e3 * error:.3f} mN")
    for name, better in result.gains(computed).items():
        print(f"  {better[0]:.3f} +- {better[1]:.3f} times as fine as {name}")
    print(f"a further candidate    {1e3 * further(scene, computed):8.1f} ms")
    print(f"load {os.getloadavg()[0]:.1f}")


def further(scene: nail.Scene, computed: xr.Dataset) -> float:
    """Median time to judge one more layout on a board whose light is traced. [s]"""
    rules, base = boards.rules(scene), boards.base_board(scene)
    conditions = [place.finger_condition(base, case, rules) for case in boards.fingers(scene)]
    best = result.chosen(computed)
    board = boards.bare_board(boards.with_explicit_walls(best, "best"))
    cache = photon_maps.PhotonMapCache(conditions, seed=1, stream=1, backend="auto", blocks=place.BLOCKS)
    cache.extend(board, 1 << 18)
    places = [area.center_mm for area in best.layout.photodiode_areas]
    spent, objective = [], Objective(rules, [condition.point for condition in conditions])
    for i in range(CANDIDATES):
        begin = time.perf_counter()
        moved, leds = [(u, v + 0.01 * i) for u, v in places], [r.center_mm for r in best.layout.leds]
        layout = candidates.candidate_scene(base, nail.scene.Candidate(name="one", leds_mm=leds, photodiodes_mm=moved))
        scores_of([cache.read(layout, board)], objective)
        spent.append(time.perf_counter() - begin)
    return statistics.median(spent[1:])


if __name__ == "__main__":
    main()
