"""The geometry of a finger with its board: sizes, places, labels, faces."""

import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from small_scenes import columns_of_photodiodes, phantom
from watertight import check_watertight, volumes_mm3

from nailoptics.errors import InputError
from nailoptics.geometry import AROUND, build
from nailoptics.scene import parse_scene

DIGITS = ("thumb", "index", "middle", "ring", "little")


def nail_coordinates(points, *, nail_radius_mm):
    """Arc length across on the plate's outer face, place along it and depth below it (k, 3) of points (k, 3)."""
    x, y, z = np.moveaxis(points, -1, 0)
    height = z + nail_radius_mm
    return np.stack([nail_radius_mm * np.arctan2(x, height), y, nail_radius_mm - np.hypot(x, height)], axis=-1)


def heights(geometry):
    """Least height of each triangle: how far it is from having no area. [mm]"""
    p = geometry.vertices[geometry.triangles]
    doubled = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return doubled / np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(axis=1)


def region(geometry, x, y, z):
    return geometry.regions[geometry.region_at(np.array([[x, y, z]]))[0]]


@pytest.mark.parametrize("digit", DIGITS)
def test_every_digit_builds_quickly_and_partitions_space(sensor, digit):
    scene = sensor(finger=f'digit = "{digit}"')
    start = time.thread_time()
    geometry = build(scene)
    assert time.thread_time() - start < 1.0
    assert len(geometry.triangles) < 100_000
    assert heights(geometry).min() > 1e-3
    report = check_watertight(geometry, crossings=20_000, seed=1)
    assert report.disagreements == 0 and report.crossings >= 20_000
    assert report.volume_error < 1e-12


@pytest.mark.parametrize("left_out", [("epidermis",), ("kapton",), ("bone",), ("epidermis", "kapton", "bone")])
def test_parts_left_out_have_no_faces_and_become_their_surroundings(sensor, left_out):
    scene = sensor()
    whole, without = build(scene), build(scene.model_copy(update={"light": scene.light.__class__(left_out=left_out)}))
    volumes, rest = volumes_mm3(whole), volumes_mm3(without)
    for part in left_out:
        assert volumes[part] > 0.1 and rest[part] == 0
        assert without.regions.index(part) not in {*without.below.tolist(), *without.above.tolist()}
    for around in set(AROUND.values()):
        taken = [volumes[part] for part in left_out if AROUND[part] == around]
        assert rest[around] == pytest.approx(volumes[around] + sum(taken), rel=1e-9)
    others = volumes.keys() - {*AROUND, *AROUND.values()}
    assert all(rest[name] == pytest.approx(volumes[name], rel=1e-9) for name in others)
    assert len(without.triangles) < len(whole.triangles)
    report = check_watertight(without, crossings=20_000, seed=1)
    assert report.disagreements == 0 and report.volume_error < 1e-12


def test_regions_lie_where_anatomy_has_them(geometry):
    # Index finger: plate 0.45 mm, bed 1.7 mm, bone below it ending 3.8 mm before the tip at 6 + 2 mm.
    assert region(geometry, 4, 0, -0.9446 - 0.2) == "plate"  # 4 mm across, the nail lies 0.94 mm lower
    assert region(geometry, 0, 0, -0.2) == "plate"
    assert region(geometry, 0, 0, -0.46) == "bed"
    assert region(geometry, 0, 0, -2.14) == "bed"
    assert region(geometry, 0, 0, -2.16) == "bone"
    assert region(geometry, 0, 4.1, -4.4) == "bone"
    assert region(geometry, 0, 4.3, -4.4) == "pulp"
    assert region(geometry, 0, 0, -10) == "pulp"
    assert region(geometry, 0, 0, -13.45) == "epidermis"
    assert region(geometry, 0, 7.95, -4.45) == "epidermis"
    assert region(geometry, 0, -8.5, -5) == "cut"  # 4 mm behind the nail
    assert region(geometry, 0, 8.1, -4.4) == "air"


def test_the_board_stands_on_the_nail_layer_by_layer(geometry):
    # 0.45 mm of epoxy and adhesive, 25 um of film, 0.5 mm of cover, counted from the nail along its radius.
    def at(u, v, height):
        angle, r = u / geometry.board_radius_mm, geometry.nail_radius_mm + height
        return region(geometry, r * np.sin(angle), v, r * np.cos(angle) - geometry.nail_radius_mm)

    assert at(-1.2, 0, 0.2) == "epoxy"
    assert at(-1.2, 0, 0.46) == "led:led0"
    assert at(-1.2, 0.6, 0.46) == "led:led1"
    assert at(0, -4 + 2.5 * 0.25, 0.46) == "photodiode:pd.2"
    assert at(0, -4 + 3.5 * 0.25, 0.46) == "silicon"
    assert at(-0.9, 0, 0.46) == "kapton"
    assert at(-1.2, 0, 0.6) == "cover"
    # Midway between the die's edge at -1.075 and the photodiodes' at -0.5 stands the wall, down to the nail.
    assert at(-0.7875, 0, 0.01) == at(-0.7875, 0, 0.44) == "barrier"
    # The rim closes the sides of the clear epoxy.
    assert at(1.05, 0, 0.2) == at(-1.2, 4.55, 0.2) == "cover"


def test_air_under_the_board_lifts_all_of_it(sensor):
    whole, lifted = build(sensor()), build(sensor(board="air_gap_um = 50"))
    assert lifted.board_radius_mm == pytest.approx(whole.board_radius_mm + 0.05)

    def at(geometry, u, v, height):
        angle, r = u / geometry.board_radius_mm, geometry.nail_radius_mm + height
        return region(geometry, r * np.sin(angle), v, r * np.cos(angle) - geometry.nail_radius_mm)

    # Below the epoxy, the wall and the rim.
    for u, above in ((-0.9, "epoxy"), (-0.7875, "barrier"), (1.05, "cover")):
        assert at(lifted, u, 0, 0.045) == "air" and at(lifted, u, 0, 0.055) == above == at(whole, u, 0, 0.005)
    assert at(lifted, -1.2, 0, 0.51) == "led:led0"
    assert build(sensor(board="air_gap_um = 50")).leds[0].area_mm2 == pytest.approx(whole.leds[0].area_mm2, rel=1e-3)
    names = [{lifted.regions[low], lifted.regions[high]} for low, high in lifted.interfaces()]
    assert {"air", "epoxy"} in names and {"plate", "epoxy"} not in names
    assert check_watertight(lifted, crossings=20_000, seed=1).passed


def test_no_clear_epoxy_meets_the_air(geometry):
    pairs = geometry.interfaces()
    epoxy = geometry.regions.index("epoxy")
    neighbours = {geometry.regions[high if low == epoxy else low] for low, high in pairs if epoxy in (low, high)}
    assert neighbours - {r for r in neighbours if r.startswith("photodiode:")} == {
        "plate", "barrier", "kapton", "cover", "silicon", "led:led0", "led:led1",
    }  # fmt: skip


def test_without_a_cover_the_film_meets_the_air_and_the_rim_still_stands(sensor):
    bare = build(sensor(board="cover_um = 0"))
    names = [{bare.regions[low], bare.regions[high]} for low, high in bare.interfaces()]
    assert {"air", "kapton"} in names and {"air", "led:led0"} in names and {"epoxy", "air"} not in names
    assert {"epoxy", "cover"} in names and check_watertight(bare, crossings=20_000, seed=1).passed
    # Film and epoxy end 0.475 mm above the nail; beside them the rim is as high.
    r = bare.nail_radius_mm + 0.47
    assert region(bare, r * np.sin(1.05 / 9.35), 0, r * np.cos(1.05 / 9.35) - bare.nail_radius_mm) == "cover"


def test_interfaces_hold_every_triangle_once_with_its_sides(geometry):
    pairs = geometry.interfaces()
    assert sum(len(t) for t in pairs.values()) == len(geometry.triangles)
    assert all(low < high for low, high in pairs)
    assert len(np.unique(np.sort(geometry.triangles, axis=1), axis=0)) == len(geometry.triangles)
    for (low, high), triangles in list(pairs.items())[::3]:
        p = geometry.vertices[triangles[:200]]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        middle, step = p.mean(axis=1), 1e-6 * normal / np.linalg.norm(normal, axis=1, keepdims=True)
        assert (geometry.region_at(middle + step) == high).all()
        assert (geometry.region_at(middle - step) == low).all()


def test_points_around_the_finger_are_in_the_air_alone_as_among_others(geometry):
    """Rationale: where all lie beyond the grid, its cells are not searched."""
    low, high = geometry.bounds_mm
    inside, around = np.array([[0.0, 0.0, -4.0]]), np.concatenate([np.diag(high + 1), np.diag(low - 1)])
    together = geometry.region_at(np.concatenate([inside, around]))
    assert geometry.regions[together[0]] != "air"
    np.testing.assert_array_equal(geometry.region_at(around), together[1:])
    assert {geometry.regions[i] for i in together[1:]} == {"air"}


def test_faces_point_at_the_nail_and_keep_their_areas(geometry):
    assert [f.name for f in geometry.leds] == ["led0", "led1"]
    assert [f.name for f in geometry.photodiodes] == [f"pd.{i}" for i in range(2, 32, 4)]
    for face, area in [*((f, 0.0625) for f in geometry.leds), *((f, 0.25) for f in geometry.photodiodes)]:
        # A chord of 0.25 to 0.5 mm on a radius of 9.35 mm is shorter than its arc by less than 1.2e-4.
        assert face.area_mm2 == pytest.approx(area, rel=2e-4)
        for quad, normal in zip(face.quads, face.normal, strict=True):
            a, b, c, d = quad
            assert np.cross(b - a, c - a) @ normal > 0 and abs((d - a) @ normal) < 1e-12
            assert np.linalg.norm(normal) == pytest.approx(1)
            into = geometry.region_at(np.stack([quad.mean(axis=0) + 1e-6 * normal, quad.mean(axis=0) - 1e-6 * normal]))
            assert [geometry.regions[r] for r in into] == ["epoxy", geometry.regions[face.region]]
    assert all(len(f.quads) == 1 for f in geometry.leds)


def test_dies_lie_where_the_scene_puts_them(geometry):
    center = geometry.leds[1].center_mm
    u, v, depth = nail_coordinates(center[None], nail_radius_mm=geometry.nail_radius_mm)[0]
    # A flat die lies a sagitta under the cylinder: 0.25^2 / 8 / 9.35 mm.
    assert u * geometry.board_radius_mm / geometry.nail_radius_mm == pytest.approx(-1.2, abs=1e-9)
    assert v == pytest.approx(0.6)
    assert depth == pytest.approx(-0.45 + 0.25**2 / 8 / 9.35, abs=1e-6)


def test_rolled_flat_the_board_has_its_photodiodes_where_the_scene_puts_them(sensor):
    scene = sensor(position_mm=[1.5, 0.5])
    for face, area in zip((built := build(scene)).photodiodes, scene.layout.photodiode_areas, strict=True):
        u, v = built.on_board(face.quads.reshape(-1, 3)).T
        edges = area.u_min, area.u_max, area.v_min, area.v_max
        assert (u.min(), u.max(), v.min(), v.max()) == pytest.approx(edges, abs=1e-6)


@pytest.mark.parametrize("digit", DIGITS)
def test_the_nails_facets_lie_within_2_um_of_its_cylinder(sensor, digit):
    geometry = build(sensor(finger=f'digit = "{digit}"'))
    plate = geometry.regions.index("plate")
    outer = [t for (low, high), t in geometry.interfaces().items() if plate in (low, high)]
    p = geometry.vertices[np.concatenate(outer)]
    on_face = np.abs(nail_coordinates(p.reshape(-1, 3), nail_radius_mm=geometry.nail_radius_mm)[:, 2]) < 1e-9
    p = p[on_face.reshape(-1, 3).all(axis=1)]
    inside = nail_coordinates(((p + np.roll(p, 1, axis=1)) / 2).reshape(-1, 3), nail_radius_mm=geometry.nail_radius_mm)
    assert len(p) > 500 and inside[:, 2].max() < 2e-3


def test_finer_grids_approach_the_smooth_finger_quadratically(sensor):
    # Facets cut chords: what they miss of the volume falls with the square of their size.
    volumes = [sum(volumes_mm3(build(sensor(), resolution=r)).values()) for r in (0.5, 1.0, 2.0)]
    assert 3 < (volumes[1] - volumes[0]) / (volumes[2] - volumes[1]) < 5.5


def test_plate_volume_is_that_of_its_shell(geometry):
    # Arc of 11.5 mm on 8.9 mm, 12 mm long, 0.45 mm thick; facets lose less than 2e-4 of it.
    shell = 11.5 / 8.9 / 2 * (8.9**2 - 8.45**2) * 12
    assert volumes_mm3(geometry)["plate"] == pytest.approx(shell, rel=5e-4)


def test_nail_coordinates_are_arc_length_place_and_depth():
    angle, r = 0.3, 8.0
    point = np.array([[r * np.sin(angle), 2.0, r * np.cos(angle) - 9.0]])
    assert nail_coordinates(point, nail_radius_mm=9.0)[0] == pytest.approx([9.0 * angle, 2.0, 1.0])


@pytest.mark.parametrize("led", [(-1.2, 0.1), (1.2, 0.1), (0.1, -2.4), (0.1, 2.4)])
@pytest.mark.parametrize("barrier", [True, False])
def test_leds_may_lie_on_any_side(sensor, led, barrier):
    geometry = build(sensor(leds=(led,), board=f"barrier = {str(barrier).lower()}", elements=4, wired=[0, 2]))
    assert (volumes_mm3(geometry)["barrier"] > 0) == barrier
    report = check_watertight(geometry, crossings=10_000, seed=2)
    assert report.disagreements == 0 and report.volume_error < 1e-12
    assert len(geometry.leds[0].quads) == 1


def test_one_sensor_may_have_leds_on_several_sides(sensor):
    geometry = build(sensor(leds=((-1.2, 0), (1.2, 0.3), (0, 2.4)), elements=4, wired=[0, 2]))
    assert check_watertight(geometry, crossings=10_000, seed=3).disagreements == 0


# The widest shapes that a scene can request: where no finger comes of one, one line reports it; else it is whole.
@settings(max_examples=8, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    width=st.floats(5, 40), thickness=st.floats(5, 40), radius=st.floats(2, 100), nail_width=st.floats(3, 30),
    nail_length=st.floats(3, 30), plate=st.floats(0.05, 3), bed=st.floats(0.1, 5), epidermis=st.floats(0.02, 1),
    bone=st.floats(1, 15),
)  # fmt: skip
def test_extreme_sizes_build_or_are_refused_with_the_reason(
    sensor, width, thickness, radius, nail_width, nail_length, plate, bed, epidermis, bone
):
    finger = (
        f"width_mm={width}\nthickness_mm={thickness}\nnail_radius_mm={radius}\nnail_width_mm={nail_width}\n"
        f"nail_length_mm={nail_length}\nnail_thickness_mm={plate}\nbed_thickness_mm={bed}\n"
        f"epidermis_thickness_mm={epidermis}\nbone_to_tip_mm={bone}\nlength_mm={nail_length + 6}"
    )
    try:
        geometry = build(sensor(finger=finger, leds=((-0.8, 0),), elements=2, wired=[0]))
    except InputError as error:
        assert "\n" not in str(error)
        return
    report = check_watertight(geometry, crossings=2000, seed=4)
    assert report.disagreements == 0 and report.volume_error < 1e-10


@pytest.mark.parametrize(
    ("finger", "words"),
    [
        ("width_mm = 11.0\nnail_width_mm = 11.5", "spans"),
        ("nail_radius_mm = 5.0\nnail_width_mm = 12.0\nthickness_mm = 6.0\nbed_thickness_mm = 1.0", "bends the nail"),
        ("nail_radius_mm = 3.0\nnail_width_mm = 5.0\nbed_thickness_mm = 2.1\nnail_thickness_mm = 0.48", "the axis"),
    ],
)
def test_impossible_fingers_get_one_clear_line(sensor, finger, words):
    with pytest.raises(InputError, match=words) as caught:
        build(sensor(finger=finger, leds=((-0.8, 0),), elements=2, wired=[0]))
    assert "\n" not in str(caught.value)


def test_a_phantom_has_no_finger_to_build():
    scene = parse_scene(phantom({}))
    with pytest.raises(InputError, match="phantom"):
        build(scene)


@pytest.mark.parametrize("resolution", [0, -1.0, float("nan"), 1e3])
def test_an_extreme_resolution_is_refused(sensor, resolution):
    with pytest.raises(InputError, match="resolution = "):
        build(sensor(), resolution=resolution)


def test_a_turned_photodiode_has_its_area_and_place_and_closes(sensor):
    turned = {"rotation_deg": 30.0, "position_mm": [0.5, 1.0]}
    scene = sensor(board="barrier = false", leds=((-3.5, 0.0),), elements=1, wired=[0], **turned)
    update = {"leds": (scene.leds[0].model_copy(update={"rotation_deg": 20.0}),)}
    layout = scene.model_copy(update=update).layout
    geometry = build(scene.model_copy(update=update))
    (face,), (area,) = geometry.photodiodes, layout.photodiode_areas
    # The nail is made of flat facets, and lines nearer than 1 um are one.
    assert face.area_mm2 == pytest.approx(0.25, rel=5e-3) and geometry.leds[0].area_mm2 == pytest.approx(
        0.0625, rel=5e-3
    )
    middle = face.center_mm
    arc_mm = geometry.board_radius_mm * np.arctan2(middle[0], middle[2] + geometry.nail_radius_mm)
    assert (arc_mm, middle[1]) == pytest.approx(area.center_mm, abs=5e-3)
    # Its long side points to 30 degrees: so do the second moments of its facets.
    places = face.quads.mean(axis=1)[:, :2] - middle[:2]
    weights = np.linalg.norm(np.cross(face.quads[:, 1] - face.quads[:, 0], face.quads[:, 3] - face.quads[:, 0]), axis=1)
    (uu, uv), (_, vv) = np.einsum("k,ki,kj->ij", weights, places, places)
    assert np.degrees(0.5 * np.arctan2(2 * uv, uu - vv)) == pytest.approx(30, abs=2)
    assert check_watertight(geometry, crossings=20_000).passed


def test_dies_that_stand_out_have_their_faces_there_and_walls_of_silicon(sensor):
    flush = sensor(leds=((-1.2, 0.0),))
    update = {
        "leds": tuple(led.model_copy(update={"height_um": 100.0}) for led in flush.leds),
        "photodiodes": tuple(p.model_copy(update={"height_um": 250.0}) for p in flush.photodiodes),
    }
    raised = build(flush.model_copy(update=update))
    flush = build(flush)
    radius = raised.board_radius_mm
    for faces, height_mm in ((raised.leds, 0.1), (raised.photodiodes, 0.25)):
        for face in faces:
            x, _, z = face.center_mm
            # The middle of 1 mm of a cylinder's arc lies 1 / (24 * 9) mm inside it, and facets 2 um.
            assert np.hypot(x, z + raised.nail_radius_mm) == pytest.approx(radius - height_mm, abs=7e-3)
    # 250 um nearer to the axis an arc is as much shorter, and so is the face.
    ratio = raised.photodiodes[0].area_mm2 / flush.photodiodes[0].area_mm2
    assert ratio == pytest.approx(1 - 0.25 / radius, rel=2e-3)
    more = {name: volumes_mm3(raised)[name] - volume for name, volume in volumes_mm3(flush).items()}
    # 32 elements, wired or not, and an LED displace the epoxy; of each wired one the face is no silicon.
    assert more["epoxy"] == pytest.approx(-(32 * 0.25 * 0.25 + 0.0625 * 0.1), rel=0.03)
    assert more["silicon"] > 0.8 * -more["epoxy"]
    assert check_watertight(raised, crossings=20_000).passed


def test_the_section_from_the_triangles_is_that_of_the_cells(geometry):
    """Two ways that share no arithmetic; the points lie on no interface."""
    y, z = np.arange(-13.9, geometry.bounds_mm[1, 1] + 0.5, 0.0873), np.arange(-8.9, 1.5, 0.0617)
    points = np.stack(np.meshgrid(0.0, y, z, indexing="ij"), -1).reshape(-1, 3)
    section = geometry.section(y, z)
    assert (section.ravel() == geometry.region_at(points)).all()
    assert len(np.unique(section)) > 5


def test_memory_for_interfaces_does_not_grow_with_the_regions():
    """1024 photodiodes, each a region of its own: a table of all faces by all regions took 1.2 GB."""
    scene = parse_scene(columns_of_photodiodes(32, 0.25, 0.25))
    tracemalloc.start()
    build(scene)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 40e6
