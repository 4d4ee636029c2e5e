"""Probe of one of Mitsuba's backends, in a process of its own, as a library that does not fit aborts it.

Run: probe_backend.py VARIANT NOT_INSTALLED; prints each engine that works, and exits with NOT_INSTALLED without
Mitsuba. A kernel alone is not enough: on CUDA, rays need OptiX, which can be missing where kernels work. What the
photons engine needs comes first: libLLVM 15 and 16 abort at the maxima of floats that Mitsuba's own kernels hold.
"""

import sys

try:
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except (ImportError, ValueError, OSError):
    pass
try:
    import mitsuba as mi
except ImportError as error:
    print(error, file=sys.stderr)
    sys.exit(int(sys.argv[2]))
mi.set_variant(sys.argv[1])
import drjit as dr  # noqa: E402  (needs a variant)

two = dr.opaque(mi.Float, 2.0)
assert dr.allclose(dr.sum(dr.arange(mi.Float, 16) * two), 240.0), "a kernel computed a wrong sum"
scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(0, 0, -5), mi.Vector3f(0, 0, 1)))
assert dr.allclose(hit.t, 4.0), "a ray met a sphere at the wrong place"
print("photons", flush=True)
assert dr.allclose(dr.sum(dr.maximum(dr.arange(mi.Float, 16), two)), 123.0), "a kernel computed a wrong maximum"
print("volpath", flush=True)
