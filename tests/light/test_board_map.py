"""The photon map: its sums over a photodiode are that photodiode's reading, direct part and sensitivity."""

import numpy as np
import pytest
from small_scenes import finger

import nailoptics as nail
from nailoptics.errors import InputError
from nailoptics.light import optics
from nailoptics.light.board_map import Arrivals, BoardTracer, PhotonMap, blood_point, map_dataset, readings
from nailoptics.light.tracing.store import LightStore
from nailoptics.light.transfer.series import readings_over_states
from nailoptics.scene import parse_scene, to_toml
from nailoptics.scene.rectangles import Rectangle

BOARD = finger(
    {"name": "near", "position_mm": [-0.2, -0.5], "size_mm": [1.0, 1.0]},
    {"name": "far", "position_mm": [1.4, 2.0], "size_mm": [1.5, 1.5]},
    leds=({"position_mm": [-2.0, 0.5]},),
    board={"barrier_gap_mm": 0.4, "size_mm": [8.0, 9.0]},
)
BATCHES = 3


@pytest.fixture(scope="module")
def scene():
    return parse_scene(BOARD)


@pytest.fixture(scope="module")
def arrivals(chosen_jit, scene):
    """Light onto a board that carries one speck of a photodiode, far from those that will be read."""
    speck = scene.photodiodes[0].model_copy(update={"position_mm": (3.5, 0.5), "size_mm": (0.05, 0.05)})
    tracer = BoardTracer(scene.model_copy(update={"photodiodes": (speck,)}))
    return [tracer.arrivals(0, photons=tracer.batch_photons, seed=i) for i in range(BATCHES)]


@pytest.fixture(scope="module")
def transfer(chosen_jit, scene):
    return nail.trace(scene, photons=1 << 18, seed=7)


def together(arrivals, point, rectangles):
    """Means over all batches, and their errors."""
    each = [readings(one, point.values(one), rectangles) for one in arrivals]
    return np.mean([mean[0] for mean, _ in each], 0), np.sqrt(np.mean([e**2 for _, e in each], 0) / len(each))


@pytest.mark.long
def test_over_a_photodiode_the_map_reads_what_the_photodiode_reads(scene, arrivals, transfer):
    """The map's board has no photodiodes, the trace's board has two: same reading, to 3 % and 6 %."""
    areas = list(scene.layout.photodiode_areas)
    point = blood_point(scene, 0)
    mean, error = together(arrivals, point, areas)
    series = readings_over_states(transfer, np.array([[0.03, 0.03]]))
    expected, spread = series.fraction[0, :, 0], series.stderr[0, :, 0]
    assert np.all(np.abs(mean[:, 0] - expected) < 4 * np.hypot(error[:, 0], spread))
    assert np.all(np.hypot(error[:, 0], spread) < [0.03, 0.06] * expected)


def test_light_from_far_below_counts_as_much_as_without_roulette(scene, chosen_jit):
    """Expected: of light that left the finger, the mean path below the bed is that of a walk in which roulette does not
    end what goes deep, within 4 standard errors; it ended one photon in thirty or more."""
    from nailoptics.light.walk import sampling
    from nailoptics.light.walk.tallies import BoardTally

    tracer, photons = BoardTracer(scene).tracer, 1 << 16

    def below(board):
        walked = tracer.walk(0, photons=photons, seed=3, board=board, only_arrivals=board is not None)
        path = walked.path_mm[[optics.TISSUES.index(name) for name in ("pulp", "bone")]].sum(0)
        each = np.where(walked.outcome == sampling.TOP, walked.weight * path, 0.0)
        return each.mean(), each.std() / np.sqrt(photons), (walked.outcome == sampling.LOST).mean()

    tally = BoardTally(tracer.geometry, photons=photons, paths=tracer.paths)
    (mean, error, ended), (expected, spread, lost) = below(tally), below(None)
    assert abs(mean - expected) < 4 * np.hypot(error, spread) < 0.35 * expected
    assert ended > 1 / 30 and lost < 1e-3


@pytest.mark.long
def test_sensitivities_are_the_finite_differences_of_a_trace(scene, arrivals, transfer):
    """The map's derivative by each zone's blood, and 1 % more blood read from the trace of the real board."""
    areas = list(scene.layout.photodiode_areas)
    mean, error = together(arrivals, blood_point(scene, 0), areas)
    for zone in range(2):
        step = np.zeros(2)
        step[zone] = 3e-4
        series = readings_over_states(transfer, np.array([0.03 - step / 2, 0.03 + step / 2]))
        slope, spread = (part[0, :, 1] / 3e-4 for part in (series.change, series.change_stderr))
        assert np.all(np.abs(mean[:, 2 + zone] - slope) < 4 * np.hypot(error[:, 2 + zone], spread))
        assert np.all(np.hypot(error[:, 2 + zone], spread) < 0.1 * np.abs(mean[:, 2:].sum(1)))


@pytest.mark.long
def test_sensitivities_are_the_finite_differences_of_fresh_traces(scene, arrivals, chosen_jit):
    """Two traces at 1 and 5 % blood in the whole bed, none of whose photons made the map: their difference.

    Readings fall by a few percent there, and a difference about the middle is bent by less than 1 % of itself.
    """
    areas = list(scene.layout.photodiode_areas)
    mean, error = together(arrivals, blood_point(scene, 0), areas)
    slope, noise = mean[:, 2:].sum(1), np.linalg.norm(error[:, 2:], axis=1)
    each = []
    for blood in (0.01, 0.05):
        at = scene.model_copy(update={"blood": scene.blood.model_copy(update={"rest_blood_fraction": blood})})
        tracer, point = BoardTracer(at), blood_point(at, 0)
        fractions = [tracer.detected(0, point, photons=tracer.batch_photons, seed=70 + i)[:, 0] for i in range(BATCHES)]
        each.append(np.array(fractions))
    difference = (each[1] - each[0]) / 0.04
    spread = difference.std(0, ddof=1) / np.sqrt(BATCHES)
    # Few batches estimate their own spread badly; the map's slopes come from as many photons.
    assert np.all(np.abs(difference.mean(0) - slope) < 4 * np.hypot(noise, np.maximum(spread, noise)))
    assert np.all(noise < 0.1 * np.abs(slope)) and np.all(spread < 0.2 * np.abs(slope))


@pytest.mark.long
def test_a_fresh_trace_with_more_blood_reads_what_the_map_predicts(scene, arrivals, chosen_jit):
    """No photon is shared: the map's reread reading beside a trace at 5 % blood in the bed, to 4 % and 7 %."""
    blood = [0.05, 0.05]
    mean, error = together(arrivals, blood_point(scene, 0, blood_fraction=blood), list(scene.layout.photodiode_areas))
    more = scene.model_copy(update={"blood": scene.blood.model_copy(update={"rest_blood_fraction": 0.05})})
    fresh = nail.trace(more, photons=1 << 17, seed=11)
    series = readings_over_states(fresh, np.array([blood]))
    noise = np.hypot(error[:, 0], series.stderr[0, :, 0])
    assert np.all(np.abs(mean[:, 0] - series.fraction[0, :, 0]) < 4 * noise)
    assert np.all(noise < [0.04, 0.07] * mean[:, 0])


@pytest.mark.parametrize("blood", [0.02, 0.05])
def test_the_derivative_by_blood_is_that_of_the_reading(scene, blood):
    """Rationale: beyond rest blood is arterial, squeezed out it is as it was. Expected: at 660 nm, where both differ
    most, a finite difference in each zone, to its curvature."""
    red = scene.with_({"leds.0.wavelength_nm": 660.0, "blood.venous_so2": 0.7})
    states = [[blood, blood], [blood + 1e-5, blood], [blood, blood + 1e-5]]
    points = [blood_point(red, 0, blood_fraction=state) for state in states]
    path = np.zeros((3, points[0].mu_a.shape[1]))
    path[:, points[0].beds] = [[2.0, 0.5], [1.0, 1.0], [0.2, 3.0]]
    light = Arrivals(3, np.arange(3), np.zeros((3, 2)), np.ones(3), path, np.zeros(path.shape[1]))
    at, *moved = (point.values(light) for point in points)
    slopes = np.stack([(one[:, 0] - at[:, 0]) / 1e-5 for one in moved], 1)
    assert at[:, 2:] == pytest.approx(slopes, rel=1e-3)


@pytest.mark.long
def test_without_a_wall_shunted_light_reaches_the_photodiode(scene, arrivals, chosen_jit):
    areas = list(scene.layout.photodiode_areas)
    point = blood_point(scene, 0)
    behind, _ = together(arrivals, point, areas)
    open_board = scene.model_copy(update={"board": scene.board.model_copy(update={"barrier": False})})
    tracer = BoardTracer(open_board)
    bare, _ = together([tracer.arrivals(0, photons=1 << 18, seed=3)], point, areas)
    assert np.all(behind[:, 1] <= behind[:, 0])
    assert bare[0, 1] > 2 * behind[0, 1]


def test_binned_map_and_records_agree_on_any_rectangle(scene, chosen_jit):
    point, tracer = blood_point(scene, 0), BoardTracer(scene)
    arrivals = [tracer.arrivals(0, photons=1 << 16, seed=i) for i in (2, 3)]
    binned = PhotonMap(scene.layout.outline, values=4, spacing_mm=0.1)
    for one in arrivals:
        binned.add(one, point.values(one))
    areas = [Rectangle("r", -0.33, 0.62, -1.27, 0.11), Rectangle("s", 0.7, 1.95, 0.33, 2.41)]
    exact, error = together(arrivals, point, areas)
    blocks = binned.over(areas)
    assert blocks.shape == (32, 2, 4) and binned.photons == sum(one.photons for one in arrivals)
    assert np.all(np.abs(blocks.mean(0) - exact) < 0.5 * error + 0.01 * np.abs(exact))
    spread = blocks.std(0, ddof=1) / np.sqrt(len(blocks))
    # 31 degrees of freedom determine a standard error to 13 %.
    assert np.all(np.abs(spread / error - 1) < 0.55)


def test_whole_outline_of_the_map_holds_every_arrival_once():
    rng = np.random.default_rng(1)
    place = rng.uniform([-1, -2], [1, 2], (1000, 2))
    one = Arrivals(1000, np.arange(1000), place, np.ones(1000), np.zeros((1000, 3), np.float32), np.zeros(3))
    binned = PhotonMap(Rectangle("o", -1, 1, -2, 2), values=1, blocks=10)
    binned.add(one, np.ones((1000, 1)))
    assert binned.over(np.array([[-1.0, 1.0, -2.0, 2.0]])).mean() == pytest.approx(1.0, rel=1e-12)
    halves = binned.over(np.array([[-1.0, 0.03, -2.0, 2.0], [0.03, 1.0, -2.0, 2.0]])).mean(0)
    assert halves.sum() == pytest.approx(1.0, rel=1e-12)
    density, error = binned.per_mm2()
    assert density.mean() == pytest.approx(1 / 8) and error.shape == (1, 20, 40)


def test_what_no_light_reaches_is_read_as_nothing_at_all():
    """Rationale: differences of large sums left 1e-16 of the light there, by which dark photodiodes were scored."""
    rng = np.random.default_rng(2)
    one = Arrivals(
        1000,
        np.arange(1000),
        rng.uniform(-1, 0, (1000, 2)),
        np.ones(1000),
        np.zeros((1000, 1), np.float32),
        np.zeros(1),
    )
    binned = PhotonMap(Rectangle("o", -1, 1, -1, 1), values=1, blocks=4)
    binned.add(one, rng.random((1000, 1)))
    dark = [
        Rectangle.around("", (u, v), (0.33, 0.21), angle)
        for u, v, angle in ((0.5, 0.5, 0), (-0.5, 0.6, 0), (0.6, -0.3, 30))
    ]
    assert (binned.over(dark) == 0).all() and (binned.over([binned.outline]) > 0).all()


@pytest.mark.parametrize("photons", [1 << 16, pytest.param(1 << 18, marks=pytest.mark.slow)])
def test_light_from_a_to_b_is_light_from_b_to_a(chosen_jit, scene, photons):
    """Reciprocity: equal faces under one medium exchange equal fractions; the wall stands midway both ways."""
    face = {"size_mm": (1.0, 1.0)}
    swapped = []
    board = scene.board.model_copy(update={"barrier_gap_mm": None})
    for led_at, photodiode_at in (((-1.5, -1.0), (0.5, 1.0)), ((0.5, 1.0), (-1.5, -1.0))):
        one = scene.model_copy(
            update={
                "board": board,
                "leds": (scene.leds[0].model_copy(update=face | {"position_mm": led_at}),),
                "photodiodes": (scene.photodiodes[0].model_copy(update=face | {"position_mm": photodiode_at}),),
            }
        )
        tracer = BoardTracer(one)
        result = [tracer.arrivals(0, photons=photons, seed=i) for i in range(2)]
        swapped.append(together(result, blood_point(one, 0), [one.layout.photodiodes[0].area]))
    (there, there_error), (back, back_error) = swapped
    error = np.hypot(there_error, back_error)
    assert np.all(np.abs(there - back)[0, [0, 2, 3]] < 4 * error[0, [0, 2, 3]])
    assert error[0, 0] < 0.08 * there[0, 0]


def test_map_as_a_dataset_integrates_to_the_light_on_the_board(scene, chosen_jit):
    tracer, point = BoardTracer(scene), blood_point(scene, 0)
    one = PhotonMap(scene.layout.outline, values=2 + len(point.beds), spacing_mm=0.5)
    arrivals = tracer.arrivals(0, photons=1 << 17, seed=0)
    one.add(arrivals, values := point.values(arrivals))
    result = map_dataset([led.name for led in scene.leds], [one])
    assert dict(result.sizes) == {"led": 1, "u": 16, "v": 18, "blood_zone": 2}
    whole = 0.25 * result.sel(led="ir").sum(("u", "v"))
    arrived = values[scene.layout.outline.holds(*arrivals.place_mm.T)].sum(0) / (1 << 17)
    assert np.r_[whole.irradiance, whole.direct, whole.sensitivity] == pytest.approx(arrived, rel=1e-6)
    # The board sends some back, which arrive again.
    assert 0.001 < 1 - len(np.unique(arrivals.photon)) / len(arrivals.photon) < 0.05
    assert bool((result.direct <= result.irradiance + 1e-12).all())
    assert one.photons == 1 << 17 and parse_scene(to_toml(scene)) == scene


def test_a_photon_counts_once_in_each_rectangle_as_it_first_arrived_there():
    """Expected: of four photons, two of which arrive again, weights that a photodiode would have taken of each."""
    u = np.array([0.1, 0.2, 1.5, 0.5, 1.6, 0.3])
    place, weight = np.column_stack([u, 0 * u]), np.array([1.0, 0.5, 0.2, 3.0, 7.0, 11.0])
    one = Arrivals(4, np.array([0, 0, 0, 1, 1, 3]), place, weight, np.zeros((6, 1), np.float32), np.zeros(1))
    rectangles = [Rectangle("a", 0, 1, -1, 1), Rectangle("b", 1, 2, -1, 1)]
    mean, error = readings(one, weight[:, None], rectangles)
    taken = np.array([[1.0, 3.0, 0.0, 11.0], [0.2, 7.0, 0.0, 0.0]])
    assert mean[0, :, 0] == pytest.approx(taken.mean(1))
    assert error[:, 0] == pytest.approx(taken.std(1, ddof=1) / 2)


def test_batches_together_count_every_photon_by_itself():
    u, place = np.linspace(-0.9, 0.9, 10), np.zeros((10, 2))
    place[:, 0] = u
    batch = Arrivals(20, np.arange(10), place, np.ones(10), np.zeros((10, 1), np.float32), np.zeros(1))
    both = Arrivals.joined([batch, batch.reweighted(3.0)])
    (mean,), error = readings(both, both.weight[:, None], [Rectangle("all", -1, 1, -1, 1)])
    assert both.photons == 40 and mean == pytest.approx(1.0)
    assert error == pytest.approx(np.repeat([1.0, 0.0, 3.0, 0.0], 10).std(ddof=1) / np.sqrt(40))


def test_stored_light_is_that_of_its_blood(scene, chosen_jit, tmp_path):
    tracer = BoardTracer(scene, stores=[LightStore(tmp_path)])
    few, much = (blood_point(scene, 0, blood_fraction=[part, part]) for part in (0.01, 0.05))
    pale, red, again = (tracer.detected(0, point, photons=1 << 12, seed=1)[:, 0] for point in (few, much, few))
    assert np.array_equal(pale, again) and (red < pale).all()


def test_a_map_without_a_jit_backend_is_refused_in_one_line(scene):
    with pytest.raises(InputError) as caught:
        BoardTracer(scene, backend="scalar")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.long
def test_a_turned_photodiode_reads_the_map_over_its_rectangle(scene, arrivals, chosen_jit):
    """In the geometry it is cut into strips; of the map's photons those count that came within its own edges."""
    turned = {"position_mm": (0.3, -0.5), "size_mm": (1.6, 0.6), "rotation_deg": 35.0}
    one = scene.model_copy(update={"photodiodes": (scene.photodiodes[0].model_copy(update=turned),)})
    (area,) = one.layout.photodiode_areas
    mean, error = together(arrivals, blood_point(scene, 0), [area])
    series = readings_over_states(nail.trace(one, photons=1 << 18, seed=21), np.array([[0.03, 0.03]]))
    expected, spread = series.fraction[0, 0, 0], series.stderr[0, 0, 0]
    assert abs(mean[0, 0] - expected) < 4 * np.hypot(error[0, 0], spread)
    assert np.hypot(error[0, 0], spread) < 0.04 * expected
    # Straight, it would differ by far more than that.
    straight, _ = together(arrivals, blood_point(scene, 0), [Rectangle.around("straight", area.center_mm, (1.6, 0.6))])
    across, _ = together(arrivals, blood_point(scene, 0), [Rectangle.around("across", area.center_mm, (0.6, 1.6))])
    assert abs(straight[0, 0] - across[0, 0]) > 0.05 * expected


def test_a_turned_rectangle_of_a_map_holds_what_came_within_its_edges():
    """Light that falls off towards a corner, in points: strips on cells of 0.1 mm sum nearly what lies inside."""
    rng = np.random.default_rng(4)
    place = -4 + 8 * rng.random((200_000, 2)) ** 1.3
    light = Arrivals(
        200_000, np.arange(200_000), place, np.ones(200_000), np.zeros((200_000, 1), np.float32), np.zeros(1)
    )
    outline = Rectangle.around("board", (0.0, 0.0), (8.0, 8.0))
    summed = PhotonMap(outline, values=1)
    summed.add(light, light.weight[:, None])
    turned = [Rectangle.around("a", (-2.0, -1.0), (1.6, 0.6), angle) for angle in (35.0, 80.0, 0.0)]
    (inside,), error = readings(light, light.weight[:, None], turned)
    of_halves, _ = readings(light, light.weight[:, None], turned, blocks=2)
    odd = light.photon % 2 == 1
    expected = [light.weight[odd & area.holds(*light.place_mm.T)].sum() / 100_000 for area in turned]
    assert of_halves.mean(0) == pytest.approx(inside) and of_halves[1, :, 0] == pytest.approx(expected)
    result = summed.over(turned).mean(0)
    assert result.shape == inside.shape and np.all(error < 0.03 * inside)
    # Cells cut at the edge share some of their points with their neighbours: within the points' own noise.
    assert np.all(np.abs(result - inside) < 2 * error)
    alone = np.stack([summed.over([one]).mean(0)[0] for one in turned])
    assert np.allclose(alone, result)
