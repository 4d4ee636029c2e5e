"""The protocol of touches: what it holds for any seed, the same as a profile, as a file and as a command's output."""

import numpy as np
import pytest
from pydantic import ValidationError

import nailoptics as nail
from nailoptics.cli import run
from nailoptics.scene import Touch, load_scene
from nailoptics.scene.protocol import (
    CLOSING_N,
    FIRST_REST_S,
    LEAST_LEVELS,
    LEAST_TOUCHES,
    LEVEL_N,
    REST_S,
    SIDE_S,
    Protocol,
    protocol,
)
from nailoptics.studies.force.reading_table import site_of


@pytest.mark.parametrize("seed", range(5))
def test_both_sides_have_rests_varied_touches_and_one_that_closes(seed):
    time_s, force_n, share = protocol(seed)
    assert (np.diff(time_s) > 0).all() and force_n[0] == force_n[1] == force_n[-1] == 0 and time_s[1] == FIRST_REST_S
    for side in (1.0, 0.0):
        at = share == side
        level_n = force_n[at][1:][(np.diff(force_n[at]) == 0) & (force_n[at][1:] > 0)]
        assert len(level_n) >= LEAST_LEVELS and LEVEL_N[0] <= level_n.min() < 0.3 and 1.0 < level_n.max() <= LEVEL_N[1]
        rests_s = np.diff(time_s[at])[(force_n[at][1:] == 0) & (force_n[at][:-1] == 0)]
        assert len(rests_s) > LEAST_TOUCHES and rests_s[1:].min() >= REST_S[0]
        assert np.ptp(time_s[at]) > SIDE_S and CLOSING_N[0] <= force_n[at].max() <= CLOSING_N[1]
    # The side changes while nothing is touched.
    changed = np.flatnonzero(np.diff(share))
    assert len(changed) == 1 and force_n[changed[0]] == force_n[changed[0] + 1] == 0


def test_the_command_writes_the_touch_of_the_profile(tmp_path):
    path = tmp_path / "protocol.csv"
    assert run(["protocol", "prototype", "--seed", "3", "-o", str(path)]) == 0
    nail.protocol(3).save(tmp_path / "python" / path.name)
    assert (tmp_path / "python" / path.name).read_bytes() == path.read_bytes()
    drawn = Touch(profile="protocol", protocol_seed=3)
    read = Touch.model_validate({"profile": "recorded", "file": path.name}, context={"folder": tmp_path})
    for name in ("recorded_force_n", "recorded_proximal_share"):
        at_s = np.array(read.recorded_time_s)
        expected = np.interp(at_s, drawn.recorded_time_s, getattr(drawn, name))
        # Within the rest in which it changes, the file changes the side at once.
        expected = np.round(expected) if name == "recorded_proximal_share" else expected
        assert np.array(getattr(read, name)) == pytest.approx(expected, abs=1e-4)
    assert protocol(3).force_n.tolist() != protocol(4).force_n[: len(protocol(3).force_n)].tolist()


def test_a_protocol_of_fast_samples_has_times_that_rise(tmp_path):
    drawn = Protocol(np.array([0.0, 100.0, 101.0]), np.full(3, 0.5), np.ones(3))
    drawn.save(tmp_path / "fast.csv", sample_rate_hz=2000.0)
    read_s = np.array([float(row.partition(",")[0]) for row in (tmp_path / "fast.csv").read_text().splitlines()[1:]])
    assert read_s == pytest.approx(np.arange(202000) / 2000.0, abs=1e-9)


def test_a_protocol_of_one_side_or_of_no_seed_is_refused(tmp_path, capsys):
    for wrong, message in (
        ({"site": "distal"}, "touches both sides"),
        ({"protocol_seed": -1}, "greater than or equal"),
    ):
        with pytest.raises(ValidationError, match=message):
            Touch.model_validate({"profile": "protocol"} | wrong)
    assert run(["protocol", "prototype", "--seed", "-1", "-o", str(tmp_path / "p.csv")]) == 2
    assert run(["protocol", "nothing", "-o", str(tmp_path / "p.csv")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2 and not (tmp_path / "p.csv").exists()


def test_a_scene_with_the_protocol_keeps_it_in_its_file(tmp_path):
    from nailoptics.scene import parse_scene, to_toml

    scene = load_scene("prototype")
    scene = scene.model_copy(update={"touch": Touch(profile="protocol", sample_rate_hz=20.0)})
    assert parse_scene(to_toml(scene)).touch == scene.touch


def test_its_file_as_a_touch_presses_the_sides_that_the_profile_does(tmp_path):
    """Rationale: a recording simulated from it calibrates. Expected: of another file, a side only where it has one."""
    drawn, path = protocol(1), tmp_path / "protocol.csv"
    drawn.save(path, sample_rate_hz=25.0)
    of_file = Touch.model_validate({"profile": "recorded", "file": "protocol.csv"}, context={"folder": tmp_path})
    scene, sites = load_scene("prototype"), []
    for touch in (of_file, Touch(profile="protocol", protocol_seed=1)):
        sites.append(site_of(scene.model_copy(update={"touch": touch}), of_file.times_s()))
    assert set(sites[0].tolist()) == {0.0, 1.0} and (sites[0] != sites[1]).mean() < 1e-3
    shared = of_file.model_copy(update={"recorded_proximal_share": (0.4,) * len(of_file.times_s())})
    assert np.isnan(site_of(scene.model_copy(update={"touch": shared}), drawn.time_s)).all()
