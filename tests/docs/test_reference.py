"""The generated reference: no field, command or public name without its words, no number without its unit."""

import ast
import inspect
import json
import re
import runpy
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import nailoptics
from nailoptics.scene.catalogue import LedPart, ModulePart, PhotodiodePart
from nailoptics.scene.files import json_schema, schema_of
from nailoptics.scene.sweep import sweep_json_schema

DOCS = Path(__file__).parents[2] / "docs"
SCHEMAS = {"scene": json_schema(), "sweep": sweep_json_schema()}
SCHEMAS |= {kind.__name__: schema_of(kind, kind.__name__) for kind in (LedPart, PhotodiodePart, ModulePart)}
UNITS = {
    "mm": "mm",
    "um": "um",
    "nm": "nm",
    "mw": "mW",
    "deg": "deg",
    "n": "N",
    "pa": "Pa",
    "s": "s",
    "hz": "Hz",
    "ohm": "ohm",
    "mohm": "Mohm",
    "pf": "pF",
    "na": "nA",
    "k": "K",
    "v": "V",
    "mm2": "mm^2",
    "kg": "kg",
    "m": "m",
    "m2": "m^2",
    "ms": "ms",
    "lux": "lux",
}
# Whose unit is a product.
NO_UNIT = {"viscosity_pa_s"}


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    """What the marks become that are read here; pages that are built have all of them."""
    make = runpy.run_path(str(DOCS / "generated.py"))["MADE"]
    return {name: make[name]() for name in ("fields", "commands", "library", "parts")}


def fields(schema: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Each table, field and its rules."""
    for table, rules in {"": schema, **schema.get("$defs", {})}.items():
        yield from ((table, name, one) for name, one in rules.get("properties", {}).items())


def words(one: dict[str, Any], schema: dict[str, Any]) -> str:
    tables = re.findall(r"#/\$defs/(\w+)", json.dumps(one))
    return str(one.get("description") or (schema["$defs"][tables[0]].get("description", "") if tables else ""))


@pytest.mark.parametrize("kind", SCHEMAS)
def test_every_field_is_described(kind):
    schema = SCHEMAS[kind]
    silent = [f"{table}.{name}" for table, name, one in fields(schema) if not words(one, schema) and name != "kind"]
    assert silent == []


@pytest.mark.parametrize("kind", SCHEMAS)
def test_a_field_with_a_unit_in_its_name_states_it_in_its_description(kind):
    wrong = []
    for table, name, one in fields(SCHEMAS[kind]):
        unit = UNITS.get(name.rpartition("_")[2]) if "_per_" not in name and "_" in name else None
        text = " ".join(one.get("description", "").split())
        if unit and name not in NO_UNIT and f"[{unit}]" not in text and not text.startswith("As in"):
            wrong.append((table, name, unit, text))
    assert wrong == []


def test_the_field_reference_has_every_field_of_a_scene(made):
    rows = re.findall(r"^\| `(\w+)` \|", made["fields"], re.M)
    known = [name for _, name, _ in fields(SCHEMAS["scene"])]
    assert sorted(rows) == sorted(known) and len(rows) > 110


def test_what_decides_where_light_goes_is_marked(made):
    """A size of the finger, a die's place and a wavelength do; blood, force and amplifier do not."""
    marked = {name for name, mark in re.findall(r"^\| `(\w+)` \|.*\| (●?) \|$", made["fields"], re.M) if mark}
    assert {"nail_width_mm", "position_mm", "wavelength_nm", "zones", "plate_scattering", "mu_s_per_mm"} <= marked
    assert not {"rest_blood_fraction", "force_n", "feedback_ohm", "plate_absorption", "flux_mw"} & marked


def test_the_reference_has_every_command_and_public_name(made):
    from nailoptics.cli import app

    for command in (name for name in app if not name.startswith("-")):
        assert f"## `{command}`" in made["commands"], command
    for name in nailoptics.__all__:
        assert re.search(rf":: nailoptics\.{name}\b", made["library"]), name


def test_the_parts_page_has_every_shipped_part_with_its_source(made):
    for path in (DOCS.parent / "assets/parts").glob("*.toml"):
        assert re.search(rf"^`{path.stem}` \(\w+\)\n: \S", made["parts"], re.M), path.stem


def test_every_output_variable_is_described_in_english():
    table = json.loads((DOCS / "output_variables.json").read_text(encoding="utf-8"))
    for file, result in table.items():
        for name, one in result["variables"].items():
            assert one["long_name"], (file, name)
            assert not re.search(r"\b[a-z0-9]+_[a-z0-9]+_", one["long_name"]), (file, name)


def names_in_code() -> Iterator[tuple[str, str]]:
    """Each variable that these rooms name in their tables or in their code outright, and where."""
    package = DOCS.parent / "nailoptics"
    rooms = [package / room for room in ("studies", "sensor", "paper")]
    for path in sorted(path for room in rooms for path in room.rglob("variables.toml")):
        yield from ((name, str(path.relative_to(package))) for name in tomllib.loads(path.read_text(encoding="utf-8")))
    for path in sorted(path for room in rooms for path in room.rglob("*.py")):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "variable":
                if isinstance(first := call.args[0], ast.Constant):
                    yield first.value, str(path.relative_to(package))


def test_every_variable_of_a_study_is_documented():
    """What a calibration returns is for Python alone: its command writes a subject and a page."""
    table = json.loads((DOCS / "output_variables.json").read_text(encoding="utf-8"))
    documented = {name for one in table.values() for name in one["variables"]}
    made = {name: path for name, path in names_in_code() if path != "studies/force/calibrate.py"}
    assert len(made) > 70
    assert {name: path for name, path in made.items() if name not in documented} == {}


def test_every_parameter_of_a_public_function_is_described():
    """Of what the docstring states, and of what is the same everywhere."""
    generated, counted = runpy.run_path(str(DOCS / "generated.py")), 0
    for name in nailoptics.__all__:
        one = getattr(nailoptics, name)
        if inspect.isfunction(one):
            lines = (inspect.getdoc(one) or "").splitlines()
            generated["as_markup"](None, "function", name, one, None, lines)
            written = [line.split(":")[1] for line in lines if re.match(r":param \w+: \w", line)]
            named = [f"param {parameter}" for parameter in inspect.signature(one).parameters]
            assert {*named} <= {*written} and len({*written}) == len(written), name
            counted += len(named)
    assert counted > 100
