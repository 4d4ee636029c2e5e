"""The recipes around live estimation run: their files come from the page, the programs around them are stand-ins."""

import importlib
import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import made_sensor
import pandas as pd
import pytest

import nailoptics
from nailoptics.scene.importers.sensor_recordings import recording_csv

PAGE = Path(__file__).parents[2] / "docs/live.md"
BLOCK = re.compile(r"^```\{code-block\} python\n:caption: (\S+)\n(.*?)^```$", re.M | re.S)
RECIPES: dict[str, str] = dict(BLOCK.findall(PAGE.read_text(encoding="utf-8")))
SAMPLES = 6


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The page's files, a calibrated person and a short recording, in the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for file, text in RECIPES.items():
        Path(file).write_text(text, encoding="utf-8")
    Path("me.toml").write_text(made_sensor.subject(), encoding="utf-8")
    recording = recording_csv(made_sensor.record(made_sensor.cycle(0.6, lasting_s=4.0), "proximal", seed=3))
    Path("steps.csv").write_text("\n".join(recording.splitlines()[: 1 + SAMPLES]) + "\n", encoding="utf-8")
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if name in {Path(file).stem for file in RECIPES}:
            del sys.modules[name]


@pytest.fixture
def predicted() -> Any:
    """What `predict` estimates from the same recording."""
    return nailoptics.predict("me.toml", "steps.csv")


def stand_in(monkeypatch: pytest.MonkeyPatch, name: str, **contents: Any) -> None:
    """A module of that name with these contents, as are the packages that it lies in."""
    parts = name.split(".")
    for k in range(1, len(parts) + 1):
        monkeypatch.setitem(sys.modules, ".".join(parts[:k]), ModuleType(".".join(parts[:k])))
    vars(sys.modules[name]).update(contents)


def test_a_wrench_has_the_force_and_its_variance(monkeypatch, predicted):
    published: dict[str, list[Any]] = {}

    class Node:
        def __init__(self, name: str) -> None:
            self.ns = 0

        def create_publisher(self, kind: type, topic: str, depth: int) -> Any:
            return SimpleNamespace(publish=published.setdefault(topic, []).append)

        def create_subscription(self, kind: type, topic: str, answer: Any, depth: int) -> None:
            self.subscribed = {topic: answer}

        def get_clock(self) -> Any:
            self.ns += 20_000_000
            return SimpleNamespace(now=lambda ns=self.ns: SimpleNamespace(nanoseconds=ns, to_msg=lambda: ns))

    def wrench() -> Any:
        force = SimpleNamespace(x=0.0, y=0.0, z=0.0)
        return SimpleNamespace(header=SimpleNamespace(), wrench=SimpleNamespace(force=force))

    stand_in(monkeypatch, "rclpy.node", Node=Node)
    stand_in(monkeypatch, "geometry_msgs.msg", WrenchStamped=wrench)
    stand_in(monkeypatch, "std_msgs.msg", Float64MultiArray=SimpleNamespace)
    node = importlib.import_module("nail_force_node").NailForce()
    for _, volts in importlib.import_module("sensor").samples():
        node.subscribed["nail/volts"](SimpleNamespace(data=[*volts.values()]))
    forces = [one.wrench.force.z for one in published["nail/wrench"]]
    assert forces == pytest.approx(predicted.force_n.values, abs=1e-4)
    for one, low, high, force in zip(
        published["nail/wrench_covariance"],
        predicted.force_low_n.values,
        predicted.force_high_n.values,
        forces,
        strict=True,
    ):
        assert len(one.data) == 36 and sum(map(math.isinf, one.data)) == 5
        assert 1.96 * math.sqrt(one.data[14]) == pytest.approx(max(high - force, force - low), abs=3e-4)


def test_an_outlet_gets_a_sample_for_each(monkeypatch, predicted):
    pushed: list[list[float]] = []
    labels: list[tuple[str, str]] = []

    class Element:
        def append_child(self, name: str) -> "Element":
            return self

        def append_child_value(self, name: str, value: str) -> None:
            labels.append((name, value))

    def info(name: str, kind: str, channels: int, rate_hz: float, form: str, source: str) -> Any:
        return SimpleNamespace(desc=Element, channels=channels)

    def outlet(info: Any) -> Any:
        return SimpleNamespace(push_sample=lambda sample, at: pushed.append(sample))

    stand_in(monkeypatch, "pylsl", IRREGULAR_RATE=0.0, StreamInfo=info, StreamOutlet=outlet, local_clock=lambda: 0.0)
    importlib.import_module("lsl_outlet").main()
    assert [value for name, value in labels if name == "label"] == ["force_n", "force_low_n", "force_high_n"]
    assert [one[0] for one in pushed] == pytest.approx(predicted.force_n.values, abs=1e-4)


def test_a_file_has_a_message_for_each(monkeypatch, predicted):
    messages: list[tuple[int, dict[str, Any]]] = []

    class Writer:
        def __init__(self, stream: Any) -> None: ...

        def start(self) -> None: ...

        def finish(self) -> None: ...

        def register_schema(self, name: str, encoding: str, data: bytes) -> int:
            self.columns = json.loads(data)["properties"]
            return 1

        def register_channel(self, topic: str, message_encoding: str, schema_id: int) -> int:
            return 2

        def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int) -> None:
            messages.append((log_time, json.loads(data)))
            assert set(messages[-1][1]) == set(self.columns)

    stand_in(monkeypatch, "mcap.writer", Writer=Writer)
    importlib.import_module("mcap_file").main()
    assert [1e-9 * at_ns for at_ns, _ in messages] == pytest.approx(predicted.time.values)
    assert [one["force_n"] for _, one in messages] == pytest.approx(predicted.force_n.values, abs=1e-4)


def test_neurokits_columns_get_the_force_beside_them(monkeypatch, predicted):
    def ppg_process(signal: pd.Series, sampling_rate: float) -> tuple[pd.DataFrame, dict[str, Any]]:
        return pd.DataFrame({"PPG_Raw": signal.to_numpy()}), {}

    stand_in(monkeypatch, "neurokit2", ppg_process=ppg_process)
    volts = pd.read_csv("steps.csv")[importlib.import_module("sensor").PHOTODIODES]
    signals = importlib.import_module("with_neurokit").with_force(volts, 1 / made_sensor.STEP_S)
    assert list(signals) == ["PPG_Raw", "Force", "Force_Low", "Force_High"]
    assert signals.Force.to_numpy() == pytest.approx(predicted.force_n.values)


def test_the_loop_prints_a_line_for_each(predicted):
    done = subprocess.run([sys.executable, "print_force.py"], capture_output=True, text=True, check=True)
    printed = [float(re.search(r": (\S+) N", line)[1]) for line in done.stdout.splitlines()]
    assert printed == pytest.approx(predicted.force_n.values, abs=1e-3)
