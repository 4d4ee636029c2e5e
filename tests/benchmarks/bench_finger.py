"""What the photon walk costs in a finger, and what one trace for every state saves. Run: python bench_finger.py

Prints, for the shipped prototype with refracting interfaces: scatterings per CPU second; the figure of merit of a
modulation (the change of a reading when the proximal blood rises by 10 %) against two separate renders by stock
Mitsuba, paths from the photodiode to the LED and the other way round; 10 000 blood states of three LEDs and eight
photodiodes read after their traces; and the map of the whole board against the eight readings alone.
"""

import time

import numpy as np

import nailoptics as nail
from nailoptics import geometry
from nailoptics.assets import data_dir
from nailoptics.light import backend, optics
from nailoptics.light.transfer.series import readings_over_states

PHOTODIODE = 1
MORE_BLOOD = 1.1
PATHS = 11264


def main() -> None:
    """Run every comparison in one process, so that they share the machine's mood."""
    scene = nail.load_scene(data_dir("scenes") / "prototype.toml")
    nail.trace(scene, photons=20_000)  # compiles
    walk = nail.trace(scene, photons=3_000_000, seed=1)
    print(f"photons      {walk.events / walk.cpu_seconds / 1e6:8.1f} M scatterings per CPU second")
    print(f"             {walk.photons / walk.cpu_seconds / 1e3:8.1f} k photons per CPU second")
    modulation(scene, walk)
    press(scene)
    board(scene)


def modulation(scene: nail.Scene, walk: nail.Transfer) -> None:
    """Figure of merit of a 10 % change of the proximal blood: (change / its error)^2 per CPU second."""
    rest = np.full(2, scene.blood.rest_blood_fraction)
    states = np.stack([rest, rest * [MORE_BLOOD, 1]])
    readings = readings_over_states(walk, states)
    change, error = readings.change[0, PHOTODIODE, 1], readings.change_stderr[0, PHOTODIODE, 1]
    ours = (change / error) ** 2 / walk.cpu_seconds
    print(
        f"modulation   {change:.3e} +- {error:.1e}   figure of merit {ours:10.3g}  one trace, {walk.cpu_seconds:.0f} s"
    )
    shape, zones = geometry.build(scene), optics.zones(scene)
    led = scene.leds[0].wavelength_nm
    v = np.linspace(-15, 10, 501)
    from nailoptics.light.reference.mitsuba_scene import BedAbsorption
    from nailoptics.light.reference.readings import finger_paths

    means, variances, cpu = [], [], 0.0
    for k, state in enumerate(states):
        mu_a = optics.absorption(scene, led, blood_fraction=state)[0]
        bed = BedAbsorption(v, (zones.weights(v) @ mu_a[1 : 1 + scene.zone_count])[None])
        paths = finger_paths(
            shape,
            optics.finger_media(scene, shape.regions, led),
            bed=bed,
            led=0,
            photodiodes=(PHOTODIODE,),
            backend=backend.choose("llvm", volpath=True),
        )
        start = time.process_time()
        batches = np.array([paths.batch(paths=PATHS, seed=100 * k + i)[0] for i in range(12)])
        cpu += time.process_time() - start
        means.append(batches.mean())
        variances.append(batches.var(ddof=1) / len(batches))
    # The true change is the traced one; the cost of two renders to resolve it is set by their noise.
    stock = change**2 / sum(variances) / cpu
    result = means[1] - means[0]
    print(
        f"             {result:.3e} +- {np.sqrt(sum(variances)):.1e}   figure of merit {stock:10.3g}  two renders, "
        f"{cpu:.0f} s; ratio {ours / stock:.3g}"
    )


def press(scene: nail.Scene) -> None:
    """Ten thousand states of eight photodiodes and three LEDs, after the traces."""
    leds = tuple(
        nail.scene.Led(name=name, part=part, position_mm=(-1.2, y))
        for name, part, y in (("red", "led_660", -0.5), ("ir", "led_800", 0.0), ("far", "led_940", 0.5))
    )
    transfer = nail.trace(scene.model_copy(update={"leds": leds}), relative_error=0.03, seed=2)
    t = np.linspace(0, 1, 10_000)
    states = np.stack([0.03 * (1 + 0.8 * np.sin(6 * t)), 0.03 * (1 + 0.9 * np.cos(9 * t))], -1)
    start = time.perf_counter()
    readings_over_states(transfer, states)
    detected = sum(len(trace.weight) for trace in transfer.traces)
    print(
        f"press        10 000 states x 3 LEDs x 8 photodiodes in {time.perf_counter() - start:.2f} s "
        f"({detected} photons)"
    )


def board(scene: nail.Scene) -> None:
    """CPU time of a walk with the map of the whole board over the same walk without, in turns."""
    from nailoptics.light.board_map import BoardTracer

    tracer = BoardTracer(scene)
    tracer.arrivals(0, photons=1 << 19, seed=0)  # compiles
    ratios = []
    for seed in range(5):
        spent = []
        for walk in (tracer.tracer.walk, tracer.arrivals):
            start = time.process_time()
            walk(0, photons=1 << 19, seed=seed)
            spent.append(time.process_time() - start)
        ratios.append(spent[1] / spent[0])
    print(f"board map    {np.median(ratios):8.2f} times the cost of the eight readings")


if __name__ == "__main__":
    main()
