"""What similarity would buy, and at what bias: why the walk keeps the full phase function.

Run: python bench_similarity.py. The middle of a slab scatters less often and more evenly, with the same reduced
scattering (g* = 0) or with the
same first two moments (g* = g / (1 + g)); a margin below and above keeps the full phase function. Printed:
reading of the photodiode 2 mm away, its bias against the full walk, and figure of merit per CPU second.
"""

import math

import nailoptics as nail

MU_S_PER_MM, G, THICKNESS_MM = 10.0, 0.9, 10.0
SCENE = """
schema_version = 1
[phantom]
layers = [{name = "slab", thickness_mm = 10.0, mu_a_per_mm = 0.05, mu_s_per_mm = 10.0, g = 0.9}]
[[leds]]
name = "beam"
wavelength_nm = 800.0
pattern = "pencil"
[[photodiodes]]
name = "square"
aperture = true
position_mm = [2.0, 0.0]
"""


def similar(scene: nail.Scene, *, margin_mm: float, g: float, mu_s_per_mm: float) -> nail.Scene:
    """The slab with its middle replaced."""
    [slab] = scene.phantom.layers
    middle = {"name": "middle", "thickness_mm": THICKNESS_MM - 2 * margin_mm, "g": g, "mu_s_per_mm": mu_s_per_mm}
    layers = [slab.model_copy(update=middle)]
    if margin_mm:
        edges = [slab.model_copy(update={"name": name, "thickness_mm": margin_mm}) for name in ("top", "bottom")]
        layers = [edges[0], *layers, edges[1]]
    return scene.model_copy(update={"phantom": scene.phantom.model_copy(update={"layers": tuple(layers)})})


def main() -> None:
    """Print one row per kind of similarity and margin."""
    full = nail.scene.parse_scene(SCENE)
    rows = [("full phase function", full)]
    for name, g, factor in (("two moments", G / (1 + G), 1 - G**2), ("isotropic", 0.0, 1 - G)):
        for margin in (1.0, 0.5, 0.0):
            scene = similar(full, margin_mm=margin, g=g, mu_s_per_mm=MU_S_PER_MM * factor)
            rows.append((f"{name}, {margin} mm kept", scene))
    reference = None
    for name, scene in rows:
        nail.trace(scene, photons=1000)  # compiles
        transfer = nail.trace(scene, photons=10_000_000, seed=5)
        seen = transfer.at()
        value, error = float(seen.detected_fraction.squeeze()), float(seen.detected_fraction_stderr.squeeze())
        reference = reference or (value, error)
        bias, noise = value / reference[0] - 1, math.hypot(error / value, reference[1] / reference[0])
        merit = (value / error) ** 2 / transfer.cpu_seconds
        print(f"{name:<26} {value:.6f} +- {error:.6f}  bias {bias:+7.2%} +- {noise:.2%}  figure of merit {merit:9.3g}")


if __name__ == "__main__":
    main()
