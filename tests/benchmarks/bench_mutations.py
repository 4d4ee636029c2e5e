"""Which plausible mistakes the tests notice: each of a list of mutations of the code, one by one.

    python tests/benchmarks/bench_mutations.py [--only TEXT] [--tests PATH ...]

A mutation is a file of nailoptics, a text that stands in it once, and what a mistake would have made of it. Each is
applied to a copy of the repository of its own, in which the tests named beside it run up to the first that fails, long
ones included; without any mutation they must pass, which is tried first. Printed: killed, where one failed, or
survived, and the part of killed ones.

--only : mutations whose file or mistake has this text. --tests : these in place of the tests that are named.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
COPIED = ("nailoptics", "assets", "scenes", "tests", "docs", "pyproject.toml", "README.md")


class Mutation(NamedTuple):
    """A mistake in a file of nailoptics; tests : by blanks, in tests/."""

    mistake: str
    file: str
    old: str
    new: str
    tests: str


FORCE = "studies/force/test_side_probability.py studies/force/test_ensemble.py"
MUTATIONS = (
    Mutation(
        "a photon that arrives twice on a photodiode counts twice",
        "light/board_map.py",
        "        inside = inside[np.unique(arrivals.photon[inside], return_index=True)[1]]\n",
        "",
        "light/test_board_map.py",
    ),
    Mutation(
        "the key of detected light misses the blood",
        "light/board_map.py",
        'f"detected{seed}-{photons}", trace, blood=blood)',
        'f"detected{seed}-{photons}", trace)',
        "light/test_board_map.py",
    ),
    Mutation(
        "photons of several batches have the same numbers",
        "light/board_map.py",
        "[batch.photon + n for batch, n in",
        "[batch.photon for batch, n in",
        "light/test_board_map.py",
    ),
    Mutation(
        "light from outside goes with the index, not with its square",
        "light/board_map.py",
        "return n**2 * area_mm2",
        "return n * area_mm2",
        "sensor/test_ambient.py",
    ),
    Mutation(
        "where oxygen is balanced, blood dims all LEDs as the first",
        "light/detect.py",
        "optics.equivalent_blood(scene, led, blood",
        "optics.equivalent_blood(scene, scene.leds[0], blood",
        "hemodynamics/test_oxygen_balance.py",
    ),
    Mutation(
        "an LED's line is narrower by the root of 2",
        "light/optics.py",
        "(2 * np.sqrt(np.log(2)))",
        "(2 * np.sqrt(2 * np.log(2)))",
        "light/test_optics.py",
    ),
    Mutation(
        "the plate's absorption falls with the power by which it rises",
        "light/optics.py",
        "(wavelength / 500) ** scene.fingertip",
        "(wavelength / 500) ** -scene.fingertip",
        "light/test_optics.py",
    ),
    Mutation(
        "light that is read does not count as used, and is trimmed as the oldest",
        "light/tracing/store.py",
        "                os.utime(self.folder)\n",
        "                pass\n",
        "light/test_store.py",
    ),
    Mutation(
        "the store fills the disk",
        "light/tracing/store.py",
        "most_bytes = min(MOST_BYTES, MOST_OF_FREE",
        "most_bytes = max(MOST_BYTES, MOST_OF_FREE",
        "light/test_store.py",
    ),
    Mutation(
        "the key of stored light misses with_faces and escaping",
        "light/tracing/trace_scene.py",
        " | engine.more if stores else {}",
        " if stores else {}",
        "light/test_store.py",
    ),
    Mutation(
        "sampling ends where the photodiode that is known best is within the tolerance",
        "light/tracing/stopping.py",
        "self.error = float(error.max(initial=0.0))",
        "self.error = float(error.min(initial=math.inf))",
        "light/test_stopping.py",
    ),
    Mutation(
        "traces that are merged have the energy of the first",
        "light/transfer/records.py",
        "tuple(map(sum, zip(*both, strict=True)))",
        "both[0]",
        "light/test_transfer.py",
    ),
    Mutation(
        "the picture of the light lies half a cell off",
        "light/walk/tallies.py",
        "self.spacing_mm) - self.spacing_mm / 2 for axis",
        "self.spacing_mm) for axis",
        "light/test_finger_walk.py",
    ),
    Mutation(
        "the spread of a mean path misses half of what its weight shares with it",
        "light/transfer/records.py",
        "self.path_square - 2 * mean",
        "self.path_square - mean",
        "light/test_transfer.py",
    ),
    Mutation(
        "mean paths in the blood are not weighted by its absorption over the line",
        "light/transfer/series.py",
        "slope += part_weight[0] * relative[at, q]",
        "slope += part_weight[0]",
        "light/test_line_width.py",
    ),
    Mutation(
        "a line is weighed as by a constant quantum efficiency",
        "light/optics.py",
        "    if photodiode.responsivity is None or led.fwhm_nm == 0:",
        "    if True:",
        "light/test_line_width.py",
    ),
    Mutation(
        "blood that has pooled has the saturation at rest in slopes",
        "hemodynamics/blood.py",
        "blood.rest_blood_fraction, blood.so2, blood.rest_so2)",
        "blood.rest_blood_fraction, blood.rest_so2, blood.rest_so2)",
        "light/test_board_map.py",
    ),
    Mutation(
        "pooled blood is interpolated across the state of rest",
        "light/transfer/series.py",
        "states > pooling, axis=0",
        "states > 2.0, axis=0",
        "light/test_course.py",
    ),
    Mutation(
        "weights with a heavy tail warn of nothing",
        "light/transfer/transfer.py",
        "if (thin | heavy).any():",
        "if thin.any():",
        "light/test_transfer.py",
    ),
    Mutation(
        "errors of several LEDs' light add up",
        "light/transfer/transfer.py",
        "np.linalg.norm(errors) / len(errors)",
        "np.sum(errors) / len(errors)",
        "light/test_transfer.py",
    ),
    Mutation(
        "copies forget the absorption before they were split",
        "light/walk/splitting.py",
        "photon.absorption_optical_depth = photon.tau + absorption_depth",
        "photon.absorption_optical_depth = absorption_depth",
        "light/test_splitting.py",
    ),
    Mutation(
        "light that the board sends back overwrites where it arrived before",
        "light/walk/finger.py",
        "                photon.arrivals += dr.select(arrives, mi.UInt32(1), mi.UInt32(0))\n",
        "",
        "light/test_board_map.py",
    ),
    Mutation(
        "blood zones pass into each other half a width too far towards the tip",
        "light/walk/interfaces.py",
        "clip((y - edge) / self.width + 0.5, 0, 1)",
        "clip((y - edge) / self.width, 0, 1)",
        "light/test_finger_walk.py",
    ),
    Mutation(
        "a die's light enters a phantom without bending",
        "light/walk/layered.py",
        "sin = eta * safe_sqrt(1 - cos * cos)",
        "sin = safe_sqrt(1 - cos * cos)",
        "light/test_layered_walk.py",
    ),
    Mutation(
        "roulette ends half of the photons, and the others count once",
        "light/walk/sampling.py",
        "photon.weight = dr.select(ended, photon.weight, 2 * photon.weight)",
        "photon.weight = dr.select(ended, photon.weight, photon.weight)",
        "light/test_layered_walk.py",
    ),
    Mutation(
        "arrivals for which a batch has no room are left out",
        "light/walk/splitting.py",
        "return bool(self.count[0] <= self.room[0])",
        "return True",
        "light/test_splitting.py",
    ),
    Mutation(
        "both halves of a photon that has made a stride have its whole weight",
        "light/walk/splitting.py",
        "photon.weight *= dr.select(near, 1 / COPIES, 0.5)",
        "photon.weight *= dr.select(near, 1 / COPIES, 1.0)",
        "light/test_splitting.py",
    ),
    Mutation(
        "a photon that ends within reach of a photodiode takes its copies of earlier strides with it",
        "light/walk/splitting.py",
        "left = dr.select(back & ~ended, photon.pending >> latest, photon.pending)",
        "left = photon.pending >> latest",
        "light/test_splitting.py",
    ),
    Mutation(
        "the copy that stands for a photon is drawn one weight too far on",
        "light/walk/splitting.py",
        "lot = up_to[first] - weight[first] + part * total",
        "lot = up_to[first] + part * total",
        "light/test_splitting.py",
    ),
    Mutation(
        "cells of the fluence do not narrow with the depth",
        "light/walk/tallies.py",
        "(depth[1] - depth[0]) * radius_mm / board_mm",
        "(depth[1] - depth[0]) * np.ones_like(radius_mm)",
        "light/test_tallies.py",
    ),
    Mutation(
        "peaks between samples lie twice as far from the sample",
        "hemodynamics/beat_detection.py",
        "np.divide(0.5 * (before - after), bend",
        "np.divide(before - after, bend",
        "hemodynamics/test_beat_detection.py",
    ),
    Mutation(
        "half of the flow brings oxygen",
        "hemodynamics/blood.py",
        "exchanged = (rest_flow * (through[:, 1:] + through[:, :-1])",
        "exchanged = (0.5 * rest_flow * (through[:, 1:] + through[:, :-1])",
        "hemodynamics/test_oxygen_balance.py",
    ),
    Mutation(
        "the white band ends a part of a step too far from the tip",
        "hemodynamics/blood.py",
        "ends_mm[1] - v_mm[k] - step",
        "ends_mm[1] - v_mm[k] + step",
        "studies/colour/test_nail_colour.py",
    ),
    Mutation(
        "before a jump a pressure is what it is after it",
        "hemodynamics/drive.py",
        "if before_jump:",
        "if False:",
        "hemodynamics/test_drive.py",
    ),
    Mutation(
        "of three balances close together the narrowest is found",
        "hemodynamics/steady.py",
        'start=lower if branch == "narrow" else upper',
        "start=lower",
        "hemodynamics/test_steady.py",
    ),
    Mutation(
        "a wall that could balance twice is shut",
        "hemodynamics/steady.py",
        'start, at_low = bottom if branch == "narrow" else top,',
        "start, at_low = bottom,",
        "hemodynamics/test_steady.py",
    ),
    Mutation(
        "waves that lag behind the pressure move less blood",
        "hemodynamics/for_scene.py",
        "variance_pa2[slow], gain.conj())",
        "variance_pa2[slow], gain)",
        "hemodynamics/test_for_scene.py",
    ),
    Mutation(
        "a beat is from the most blood to the least",
        "hemodynamics/for_scene.py",
        "[int(total.argmin()), int(total.argmax())]",
        "[int(total.argmax()), int(total.argmin())]",
        "hemodynamics/test_for_scene.py",
    ),
    Mutation(
        "a hold ends with its first sample",
        "hemodynamics/for_scene.py",
        "departure >= 0.995 * departure.max())[-1]",
        "departure >= 0.995 * departure.max())[0]",
        "hemodynamics/test_for_scene.py",
    ),
    Mutation(
        "what flows in goes with the square of the diameter",
        "hemodynamics/for_scene.py",
        "within_pa) * diameter_m**4",
        "within_pa) * diameter_m**2",
        "hemodynamics/test_oxygen_balance.py",
    ),
    Mutation(
        "arterioles pulse with slow waves alone",
        "hemodynamics/for_scene.py",
        "np.where(beats, small.pulse_ratio, 1.0)",
        "np.where(beats, 1.0, small.pulse_ratio)",
        "hemodynamics/test_arterioles.py",
    ),
    Mutation(
        "an untouched finger has no arterial pressure",
        "hemodynamics/respond.py",
        "first[2:] = 0.0",
        "first[:2] = 0.0",
        "hemodynamics/test_respond.py",
    ),
    Mutation(
        "the force on a contact that grows goes with its pressure, not with its cube",
        "hemodynamics/touch.py",
        "areas_m2 / change if change > 0.0 else areas_m2",
        "areas_m2",
        "hemodynamics/test_for_scene.py",
    ),
    Mutation(
        "a pulp that creeps does so at once",
        "hemodynamics/touch.py",
        "lost[..., None] * delayed, 0.0)",
        "lost[..., None] * touch, 0.0)",
        "hemodynamics/test_blood_touch_pulse.py",
    ),
    Mutation(
        "the variance of a beat's phase goes with the spread of intervals, not with its square",
        "hemodynamics/waves.py",
        "(2 * np.pi * INTERVAL_SPREAD) ** 2 * self.rate_hz",
        "(2 * np.pi * INTERVAL_SPREAD) * self.rate_hz",
        "hemodynamics/test_waves.py",
    ),
    Mutation(
        "slow waves forget half as much as they should",
        "hemodynamics/waves.py",
        "float((1 - decay**2) * self.rms_pa**2)",
        "float((1 - decay) * self.rms_pa**2)",
        "hemodynamics/test_waves.py",
    ),
    Mutation(
        "a distal pressure that reaches everywhere adds to that at the tip",
        "hemodynamics/zones.py",
        "everywhere + (1.0 - everywhere) * distal",
        "everywhere + distal",
        "scene/test_vessels.py",
    ),
    Mutation(
        "film absorbs half",
        "tissue.py",
        '4 * np.pi * tabulated("kapton", "k"',
        '2 * np.pi * tabulated("kapton", "k"',
        "tissue/test_properties.py",
    ),
    Mutation(
        "a chord between two heights dips no lower than its ends",
        "light/walk/interfaces.py",
        "low = dr.fma(self.sagitta, step * step, low)",
        "low = dr.fma(0, step * step, low)",
        "geometry/test_distance.py",
    ),
    Mutation(
        "steps between two shells meet no other interface",
        "light/walk/interfaces.py",
        "return inside & (step < clear)",
        "return inside",
        "geometry/test_distance.py",
    ),
    Mutation(
        "light that leaves a shell inwards may end among its faces",
        "light/walk/interfaces.py",
        "over = dr.select(on, side > 0, bottom < height)",
        "over = on | (bottom < height)",
        "geometry/test_distance.py",
    ),
    Mutation(
        "what reaches above the plate's outer face alone is forgotten above it",
        "light/walk/interfaces.py",
        "here.below + there.below, here.above + there.above)",
        "here.below + there.below, here.below + there.below)",
        "geometry/test_distance.py",
    ),
    Mutation(
        "bounds on distances miss the radius within which samples cover an interface",
        "geometry/distance.py",
        "(1 + SLACK)) ** 2 - radius**2, 0))",
        "(1 + SLACK)) ** 2, 0))",
        "geometry/test_distance.py",
    ),
    Mutation(
        "places on the board are arcs on the nail",
        "geometry/model.py",
        "self.board_radius_mm * np.arctan2(",
        "self.nail_radius_mm * np.arctan2(",
        "geometry/test_build.py",
    ),
    Mutation(
        "light from outside that none of the photons showed has no error",
        "sensor/ambient.py",
        "np.maximum(square - total**2 / photons, largest_a**2)",
        "np.maximum(square - total**2 / photons, 0.0)",
        "sensor/test_ambient.py",
    ),
    Mutation(
        "a lock-in has the noise of a dark slot",
        "sensor/electronics.py",
        'factor = 1 if amplifier.ambient_rejection == "dark_slot" else 2',
        "factor = 1",
        "sensor/test_electronics.py",
    ),
    Mutation(
        "a dark slot is a whole period later",
        "sensor/electronics.py",
        "np.sin(np.pi * flicker_hz / (2 * switching_hz))",
        "np.sin(np.pi * flicker_hz / switching_hz)",
        "sensor/test_electronics.py",
    ),
    Mutation(
        "a fitted resistor has no headroom",
        "sensor/electronics.py",
        "most_v = limit_v(amplifier) / amplifier.headroom",
        "most_v = limit_v(amplifier)",
        "sensor/test_resistors.py",
    ),
    Mutation(
        "skin is averaged over a circle whose radius is the limit's diameter",
        "sensor/exposure.py",
        "(SKIN_M**2 / 4 + height_m**2)",
        "(SKIN_M**2 + height_m**2)",
        "sensor/test_exposure.py",
    ),
    Mutation(
        "the noise of a held sample is not averaged",
        "sensor/front_end.py",
        "averaged + held / samples",
        "averaged + held",
        "sensor/test_front_end.py",
    ),
    Mutation(
        "samples are held on 10 pF in every scene",
        "sensor/front_end.py",
        "(1e-12 * self.oximeter.hold_pf)",
        "(1e-12 * 10.0)",
        "sensor/test_front_end.py",
    ),
    Mutation(
        "the noise of infrared goes with the ratio, not with its square",
        "sensor/front_end.py",
        "ratio**2 * relative[..., 1]",
        "ratio * relative[..., 1]",
        "sensor/test_front_end.py",
    ),
    Mutation(
        "errors of both pressures add up in the share of the force",
        "sensor/information.py",
        "np.array([q, -p])",
        "np.array([q, p])",
        "studies/placement/test_search.py",
    ),
    Mutation(
        "motion of the sensor is larger than its rms",
        "sensor/volts.py",
        "            drawn[1:] *= np.sqrt(1.0 - memory**2)\n",
        "",
        "sensor/test_volts.py",
    ),
    Mutation(
        "a lift brings the board nearer to the nail",
        "sensor/volts.py",
        "board.adhesive_um + LIFT_UM",
        "board.adhesive_um - LIFT_UM",
        "sensor/test_volts.py",
    ),
    Mutation(
        "drift makes changes of readings that have no error",
        "sensor/volts.py",
        "np.hypot(change_stderr[i, j], scaled[i, j] * stderr[i, j])",
        "change_stderr[i, j]",
        "sensor/test_volts.py",
    ),
    Mutation(
        "a board that is slid towards the root moves readings the other way",
        "sensor/volts.py",
        "in_place.fraction) / distance_um\n            stderr",
        "in_place.fraction) / abs(distance_um)\n            stderr",
        "sensor/test_volts.py",
    ),
    Mutation(
        "an estimate begins as if the sensor were on since the calibration",
        "studies/force/kalman.py",
        "jacobian.T + subject.drift_covariance + put_on",
        "jacobian.T + subject.drift_covariance",
        "studies/force/test_donning.py",
    ),
    Mutation(
        "a sensor is put on anew when it is taken off",
        "sensor/volts.py",
        "prepend=False)) // 2",
        "prepend=False))",
        "studies/force/test_donning.py",
    ),
    Mutation(
        "reflectance in a lamp's light is over the cosines, not their squares",
        "studies/colour/reflectance.py",
        " / np.float32(high**2 - low**2)",
        " / np.float32(high - low)",
        "studies/colour/test_colorimetry.py",
    ),
    Mutation(
        "a verdict on many readings has no correction for their number",
        "studies/compare.py",
        "1 - float(error.size * below.min())",
        "1 - float(below.min())",
        "studies/test_compare.py",
    ),
    Mutation(
        "a limit in a traced measure has the error of its setting alone",
        "studies/compare.py",
        "both.min(0) - spread, both.max(0) + spread",
        "both.min(0), both.max(0)",
        "studies/test_compare.py",
    ),
    Mutation(
        "the filter's covariance leaves out how far its modes are apart",
        "studies/force/kalman.py",
        'np.einsum("m,mij->ij", probability, covariance) + (probability * from_mean.T) @ from_mean',
        'np.einsum("m,mij->ij", probability, covariance)',
        "studies/force/test_mixture_of_modes.py",
    ),
    Mutation(
        "the filter's pulp relaxes away from the touch",
        "studies/force/kalman.py",
        "pressure_n_per_cm2 + (relaxed_n_per_cm2 - pressure_n_per_cm2) * remaining",
        "relaxed_n_per_cm2 + (pressure_n_per_cm2 - relaxed_n_per_cm2) * remaining",
        "studies/force/test_pulp.py",
    ),
    Mutation(
        "lines of warmer LEDs are shorter in their waves",
        "studies/oximetry/oxygen.py",
        'lines("shift_nm", drift * WARMER_K)',
        'lines("shift_nm", -drift * WARMER_K)',
        "studies/oximetry/test_oxygen.py",
    ),
    Mutation(
        "the error of a slope leaves out that of what it is over",
        "studies/oximetry/recording.py",
        "(left * pulsating + balance * residual**2)",
        "(left * pulsating)",
        "studies/oximetry/test_spo2_over_time.py",
    ),
    Mutation(
        "the distance from the bound leaves out the bound's error",
        "studies/placement/certificate.py",
        "ratio * np.hypot(error, bound[1] / bound[0])",
        "ratio * error",
        "studies/placement/test_certificate.py",
    ),
    Mutation(
        "the simplest of all layouts that tie is proposed, however far behind",
        "studies/placement/objective.py",
        "    close = [i for i in tied if scores[i].ranked[0] <= (1 + 2 * ALIKE)",
        "    close = [i for i in tied if scores[i].ranked[0] <= (1 + 20 * ALIKE)",
        "studies/placement/test_simplest.py",
    ),
    Mutation(
        "what the electronics alone resolve is what is resolved through the body's noise",
        "studies/placement/result.py",
        "[score.electronics for score in scores]",
        "[score.force for score in scores]",
        "studies/placement/test_place.py",
    ),
    Mutation(
        "the error of a resolution is that without the body's own",
        "studies/placement/objective.py",
        "above[0] ** 2 / resolution_n[0] * jackknife",
        "above[0] * jackknife",
        "studies/placement/test_simplest.py",
    ),
    Mutation(
        "a pulse is read past the converter's limit",
        "studies/placement/objective.py",
        "self.leds.index(led)]) ** 2 * read.unsaturated",
        "self.leds.index(led)]) ** 2",
        "studies/placement/test_spo2_objective.py",
    ),
    Mutation(
        "noise of the nodes stays in a spread over the priors",
        "studies/prior_uncertainty.py",
        "unbiased = groups * variance[0] - (groups - 1) * variance[1:].mean(0)",
        "unbiased = variance[0]",
        "studies/test_prior_uncertainty.py",
    ),
    Mutation(
        "blood goes inversely with the blood at rest over the priors",
        "studies/simulate.py",
        "part = rest / usual if same and usual else 1.0",
        "part = usual / rest if same and usual else 1.0",
        "studies/test_prior_uncertainty.py studies/test_simulate.py",
    ),
    Mutation(
        "the error of ambient light is left out of that of volts",
        "studies/simulate.py",
        "        np.hypot(volts_stderr, of_ambient, out=volts_stderr)\n",
        "",
        "studies/test_simulate.py",
    ),
    Mutation(
        "pads are turned twice with their footprint",
        "scene/importers/kicad.py",
        "math.radians(pad_deg - angle_deg)",
        "math.radians(pad_deg)",
        "scene/test_kicad.py",
    ),
    Mutation(
        "all slots of an oximeter's recording are read as at one time",
        "scene/importers/sensor_recordings.py",
        "np.interp(time_s, start_s + delays_s.get(light, 0.0), columns[title])",
        "np.interp(time_s, start_s, columns[title])",
        "studies/oximetry/test_spo2_over_time.py",
    ),
    Mutation(
        "the mean of a turned rectangle's strips lies twice as far aside",
        "scene/rectangles.py",
        "for (a, b), (c, d) in sides_of(piece)) / (6 * area)",
        "for (a, b), (c, d) in sides_of(piece)) / (3 * area)",
        "scene/test_rectangles.py",
    ),
    Mutation(
        "samples of a hypercube reach beyond its ranges",
        "scene/sweep.py",
        "(low + (high - low) * quantiles)",
        "(low + high * quantiles)",
        "scene/test_sweep.py",
    ),
    Mutation(
        "the last of a list of steps is not held",
        "scene/touch.py",
        "last.start_s) + LAST_STEP_S",
        "last.start_s)",
        "scene/test_touch.py",
    ),
    Mutation(
        "cones are spread evenly over the half sphere",
        "exports/monte_carlo.py",
        "np.arccos(1 - np.sqrt((step + 0.5) / count))",
        "np.arccos(1 - (step + 0.5) / count)",
        "exports/test_mmc.py",
    ),
    Mutation(
        "labels of voxels are written with the wrong axis first",
        "exports/monte_carlo.py",
        'tobytes(order="F")',
        'tobytes(order="C")',
        "exports/test_mcx.py",
    ),
    Mutation(
        "the error of a ratio has the absolute error of one of both",
        "exports/other_program.py",
        "self.ours_stderr / self.ours, self.theirs_stderr / self.theirs",
        "self.ours_stderr / self.ours, self.theirs_stderr",
        "exports/test_other_program.py",
    ),
    Mutation(
        "an exported circuit leaves out the drift of its readings",
        "exports/spice.py",
        "(result.detected_fraction.values * reading_gain(result))[i]",
        "result.detected_fraction.values[i]",
        "exports/test_spice.py",
    ),
    Mutation(
        "changes are held against the error of the level",
        "report/readings.py",
        'table["z_score"] = change / table.volts_change_stderr',
        'table["z_score"] = change / table.volts_start_stderr',
        "report/test_page.py",
    ),
    Mutation(
        "results of twice the required error are kept",
        "batch/folder.py",
        "reached is not None and reached <= required.relative_error",
        "reached is not None and reached <= 2 * required.relative_error",
        "batch/test_run.py",
    ),
    Mutation(
        "a failure stays beside the result of a later run",
        "batch/jobs.py",
        "    folder.failure(job.digest).unlink(missing_ok=True)\n",
        "",
        "batch/test_run.py",
    ),
    Mutation(
        "errors of value and slope add up with the wrong sign in those of V1",
        "paper/reduced_optics.py",
        "slope * growth * (centre * curvature - 1) / curvature**2",
        "slope * growth * (centre * curvature + 1) / curvature**2",
        "paper/test_reduced_optics.py",
    ),
    Mutation(
        "unloading is read backwards",
        "paper/responses.py",
        "np.stack([loading, unloading[..., ::-1]], axis=-2)",
        "np.stack([loading, unloading], axis=-2)",
        "paper/test_claims.py",
    ),
    Mutation(
        "drifts are drawn along eigenvectors, which rounding turns",
        "studies/force/training.py",
        "np.linalg.cholesky(subject.drift_covariance + 1e-12 * np.eye(len(series.over_rest)))",
        "(lambda values, vectors: vectors * np.sqrt(values))(*np.linalg.eigh(subject.drift_covariance))",
        "studies/force/test_ensemble.py",
    ),
    Mutation(
        "the file of a protocol presses both sides",
        "studies/force/reading_table.py",
        "    if touch.recorded_proximal_share and",
        '    if touch.profile == "protocol" and touch.recorded_proximal_share and',
        "scene/test_protocol.py",
    ),
    Mutation(
        "both sides' touches are the difference of those of either",
        "studies/force/training.py",
        "features[:, pair].sum(1)]",
        "features[:, pair[0]] - features[:, pair[1]]]",
        FORCE,
    ),
    Mutation(
        "the force of both sides' touches is the sum of those of either",
        "studies/force/training.py",
        "samples.force_n[pair].mean(0), np.nan",
        "samples.force_n[pair].sum(0), np.nan",
        FORCE,
    ),
    Mutation(
        "touches of both sides are distal to the gate",
        "studies/force/training.py",
        "np.nan_to_num(samples.site, nan=0.5)",
        "np.nan_to_num(samples.site, nan=0.0)",
        FORCE,
    ),
    Mutation(
        "what differs by side has the other side's sign",
        "studies/force/training.py",
        "np.array([1.0, -1.0])",
        "np.array([-1.0, 1.0])",
        FORCE,
    ),
    Mutation(
        "members are not trained with the touches that are made of both sides",
        "studies/force/training.py",
        "_trained(*_with_both_sides(subject, trained_on, samples), components)",
        "_trained(trained_on, samples, components)",
        FORCE,
    ),
    Mutation(
        "a share's error is that of the other side",
        "studies/force/training.py",
        "== side)] - side) for side in (1.0, 0.0)",
        "== side)] - side) for side in (0.0, 1.0)",
        FORCE,
    ),
    Mutation(
        "the filter says nothing of touches of both sides",
        "studies/force/ensemble.py",
        "moved_n = 0.5 * both",
        "moved_n = 0.0 * both",
        FORCE,
    ),
    Mutation(
        "the filter says half where no touch is",
        "studies/force/ensemble.py",
        " * np.minimum(members_n / TOUCH_N, 1.0)",
        "",
        FORCE,
    ),
    Mutation(
        "intervals of both sides' touches are as wide as those of one side's",
        "studies/force/ensemble.py",
        "@ terms, share) + 0.5 * np.abs(moved_n)",
        "@ terms, share)",
        FORCE,
    ),
    Mutation(
        "the zero follows readings however far they are",
        "studies/force/ensemble.py",
        "/ ZERO_S) * max(nearness, LEAST_NEARNESS))",
        "/ ZERO_S))",
        FORCE,
    ),
    Mutation(
        "a calibration's finger rests where the filter says so",
        "studies/force/training.py",
        "over_rest(every.volts, force_n < REST_FORCE_N",
        "over_rest(every.volts, by_filter.force_n < REST_FORCE_N",
        FORCE,
    ),
    Mutation(
        "a heartbeat is an LED's light",
        "studies/force/body_noise.py",
        "parts[:, 0] = rhs[:, 0] / normal[:, 0, 0]",
        "pass",
        "studies/force/test_body_noise.py",
    ),
    Mutation(
        "of touches of one side the filter says half",
        "studies/force/ensemble.py",
        "np.maximum(1.0 - np.abs(2.0 * share - 1.0) / ONE_SIDED, 0.0)",
        "np.minimum(np.abs(2.0 * share - 1.0) / ONE_SIDED, 1.0)",
        FORCE,
    ),
    Mutation(
        "an error of the calibration counts twice in its intervals",
        "studies/force/interval.py",
        "(higher - lower) / (2 * STEP_LN)",
        "(higher - lower) / STEP_LN",
        "studies/force/test_open_error.py studies/force/test_interval_coverage.py",
    ),
    Mutation(
        "held touches of one side alone are looked at",
        "studies/force/interval.py",
        "(np.eye(2)[..., None] * bends)",
        "(np.ones((2, 2))[..., None] * bends)",
        "studies/force/test_open_error.py studies/force/test_interval_coverage.py",
    ),
    Mutation(
        "the interval of a share is one standard error",
        "studies/force/interval.py",
        "ndtri(QUANTILES[1]) * by_share(error",
        "by_share(error",
        FORCE,
    ),
    Mutation(
        "what is made without one of a few large groups moves as without a small one",
        "statistics.py",
        "replicates[0] + changes * (count - 1) / (count - count // groups)",
        "replicates[0] + changes",
        "test_statistics.py",
    ),
    Mutation(
        "few photons bound no sum",
        "statistics.py",
        "shift = (2 * Z95**2 + 1) / 6 * np.asarray(skew)",
        "shift = 0 * np.asarray(skew)",
        "studies/model_error/test_few_photons.py",
    ),
    Mutation(
        "a file is written in place",
        "io.py",
        "            os.replace(aside, path)\n",
        "            path.write_bytes(data)\n            aside.unlink()\n",
        "test_io.py",
    ),
    Mutation(
        "new files of other writers are removed, and old ones stay",
        "io.py",
        "st_mtime < time.time() - LEFTOVER_S",
        "st_mtime > time.time() - LEFTOVER_S",
        "test_io.py",
    ),
)


def tested(mutation: Mutation | None, tests: str) -> tuple[bool, str, float]:
    """Whether tests pass with a mutation, or with none; what they printed last; and the seconds that they took."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "nailoptics"
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy2(ROOT / name, copy / name)
        if mutation:
            path = copy / "nailoptics" / mutation.file
            text = path.read_text(encoding="utf-8")
            assert text.count(mutation.old) == 1, f"{mutation.file} holds {text.count(mutation.old)} of {mutation.old}"
            path.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-x", "-n", "1", "-m", "not slow", "-p", "no:cacheprovider"]
        command += [f"tests/{test}" for test in tests.split()]
        begin = time.perf_counter()
        env = os.environ | {"PYTHONPATH": str(copy)}
        ran = subprocess.run(command, cwd=copy, env=env, capture_output=True, text=True, check=False)
    failed = [line for line in ran.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    if ran.returncode and not failed:
        raise SystemExit(f"pytest ended with {ran.returncode}:\n{ran.stdout}{ran.stderr}")
    return ran.returncode == 0, failed[0] if failed else "", time.perf_counter() - begin


def main() -> None:
    """Try the mutations, and print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--tests", nargs="+")
    given = parser.parse_args()
    chosen = [m for m in MUTATIONS if given.only in m.file or given.only in m.mistake]
    tests = {m: " ".join(given.tests) if given.tests else m.tests for m in chosen}
    passes, failed, _ = tested(None, " ".join(dict.fromkeys(test for each in tests.values() for test in each.split())))
    if not passes:
        raise SystemExit(f"the tests fail without any mutation: {failed}")
    killed = 0
    for mutation in chosen:
        passes, failed, seconds = tested(mutation, tests[mutation])
        killed += not passes
        outcome = "survived" if passes else "killed"
        print(f"{outcome:<9} {seconds:4.0f} s  {mutation.file}: {mutation.mistake}  {failed[:100]}", flush=True)
    print(f"{killed} of {len(chosen)} killed")


if __name__ == "__main__":
    main()
