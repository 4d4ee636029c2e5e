"""R against SpO2 from raw recordings of a real finger: `python tests/benchmarks/real_oximeter.py FOLDER`.

The recordings are public, but not ours to ship: FOLDER is spo2-data/proto1 of https://github.com/aarusso/OxiWear, 58
tables named TIME-SPO2-RATE of an evaluation kit (MAX86161 in reflectance, 64 Hz, some 4.5 s each; one finger, air
with little oxygen). Expected: of 56 with a standard error of R below a tenth SpO2 = 109.5 - 31.2 R, rms 3.2 %, and
pulses, peak to peak, of 0.57 % of the light in the infrared and 0.26 % in the red at 95 to 98 %.
"""

import argparse
import re
from pathlib import Path

import numpy as np

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.scene.importers.sensor_recordings import read_oximeter_recording
from nailoptics.studies.oximetry.recording import pulses_over_time


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    scene, rows = load_scene(data_dir("scenes") / "pulse_oximeter.toml"), []
    print("file,spo2_percent,rate_per_min,ratio,ratio_stderr,pulse_rate_per_min,red_percent,infrared_percent,moved")
    for path in sorted(parser.parse_args().folder.glob("*.csv")):
        named = re.match(r"\d+-(\d+)-(\d+)", path.name)
        try:
            recording = read_oximeter_recording(
                path, leds=("red", "infrared"), photodiodes=["finger"], delays_s={}, frame_hz=64.0
            )
            _, (values,) = pulses_over_time(recording, scene)
        except InputError as error:
            print(f"{path.name}: {error}")
            continue
        names = ("ratio", "ratio_stderr", "rate_per_min", "perfusion_index_red", "perfusion_index_infrared", "motion")
        ratio, stderr, rate, red, infrared, motion = (float(values[name][0]) for name in names)
        spo2, reference = (float(x) for x in named.groups()) if named else (np.nan, np.nan)
        print(f"{path.name},{spo2:g},{reference:g},{ratio:.3f},{stderr:.3f},{rate:.0f},{100 * red:.3f},"
              f"{100 * infrared:.3f},{motion:.2f}")  # fmt: skip
        if np.isfinite(ratio) and stderr < 0.1 * ratio:
            rows.append((spo2, ratio, rate - reference))
    spo2, ratio, off = np.array(rows).T
    slope, intercept = np.polyfit(ratio, spo2, 1)
    rms = np.std(spo2 - intercept - slope * ratio, ddof=2)
    line = f"SpO2 = {intercept:.1f} - {-slope:.1f} R, rms {rms:.1f} %"
    print(f"{len(rows)} recordings: {line}; pulse rate off by {np.nanmedian(off):+.1f}/min, median")


if __name__ == "__main__":
    main()
