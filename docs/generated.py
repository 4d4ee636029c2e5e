"""Documentation generated from the code: `<!-- NAME -->` in a page is replaced by the text of that name,
with the line below it that stands for it where pages are read as they are."""

import ast
import inspect
import itertools
import json
import re
import statistics
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import nailoptics
from nailoptics.light import optics
from nailoptics.light.identity import light_digest
from nailoptics.options import TraceOptions
from nailoptics.report import html, style
from nailoptics.report.pages import validate as validation_page
from nailoptics.scene import Scene, load_scene
from nailoptics.scene.base import Table
from nailoptics.scene.catalogue import LedPart, ModuleLed, ModulePart, ModulePhotodiode, PhotodiodePart
from nailoptics.scene.files import json_schema, schema_of
from nailoptics.scene.priors import shipped_priors
from nailoptics.scene.sweep import sweep_json_schema

HERE = Path(__file__).parent
OUTPUTS = HERE / "output_variables.json"
UNIT = re.compile(r"\s*\[([^\]]+)\]$")
# Tables of a scene that are lists, which the schema does not say of tables within a list.
LISTS = {"leds", "photodiodes", "layers", "steps", "slots", "candidates", "fingers", "ranges", "sites", "axes"}
# Tables that decide the effort of a study, not its result.
EFFORT = {"accuracy", "placement"}
# Tables that are applied after tracing.
READ_ONLY = {"touch", "body", "electronics", "ambient", "oximeter", "colour", "priors"}
# Fields that set others, some of which change the light transport.
FILLS = {
    "digit",
    "part",
    "array",
    "kicad",
    "positions",
    "parts",
    "origin",
    "faces_nail",
    "turn_deg",
    "negate_x_on_bottom",
    "positions_unit",
}


def fill_in(app: object, name: str, source: list[str]) -> None:
    """Replace the placeholders of a page, when Sphinx reads it, by the generated text."""
    placeholder = r"<!-- (\w+) -->(?:\n_Here the built .*_)?"
    source[0] = re.sub(placeholder, lambda mark: MADE[mark[1]]() if mark[1] in MADE else mark[0], source[0])


# Fields


def fields() -> str:
    """Every table of a scene file, with every field."""
    schema = json_schema()
    return "\n".join(_section(where, table, schema, _light_fields(where)) for where, table in _tables(schema))


def sweep_fields() -> str:
    """Every table of a sweep file."""
    schema = sweep_json_schema()
    return "\n".join(_section(where, table, schema, None) for where, table in _tables(schema) if where != ("base",))


def part_fields() -> str:
    """Every kind of part, and the parts of a module."""
    kinds = {"led": LedPart, "photodiode": PhotodiodePart, "module": ModulePart}
    kinds |= {"[[leds]] of a module": ModuleLed, "[[photodiodes]] of a module": ModulePhotodiode}
    text = []
    for kind, model in kinds.items():
        schema = schema_of(model, kind)
        title = f"`{kind}`" if " " in kind else f'`kind = "{kind}"`'
        text += [f"### {title}\n", schema["description"], "", *_rows(schema, schema, None), ""]
    return "\n".join(text)


def _tables(schema: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
    """Each table of a file with its path, the outermost first; one that occurs twice is given once."""
    seen: set[str] = set()
    waiting: list[tuple[tuple[str, ...], Mapping[str, Any]]] = [((), schema)]
    while waiting:
        where, table = waiting.pop(0)
        yield where, table
        for name, one in table["properties"].items():
            for reference in dict.fromkeys(re.findall(r"#/\$defs/(\w+)", json.dumps(one))):
                if reference not in seen:
                    seen.add(reference)
                    waiting.append(((*where, name), schema["$defs"][reference]))


def _section(where: tuple[str, ...], table: Mapping[str, Any], schema: Mapping[str, Any], light: Any) -> str:
    name = ".".join(where)
    title = f"`[[{name}]]`" if where and where[-1] in LISTS else f"`[{name}]`" if where else "At the top of the file"
    return "\n".join([f"## {title}\n", _plain(table.get("description", "")), "", *_rows(table, schema, light), ""])


def _rows(table: Mapping[str, Any], schema: Mapping[str, Any], light: set[str] | None) -> list[str]:
    head = ["field", "takes", "unit", "default", "meaning"] + ([] if light is None else ["light"])
    rows = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for name, one in table["properties"].items():
        text, unit = described(one, schema)
        default = "**required**" if name in table.get("required", ()) else _default(one)
        row = [f"`{name}`", taken(one), unit, default, text]
        rows.append(f"| {' | '.join(row + ([] if light is None else ['●' if name in light else '']))} |")
    return rows


def described(one: Mapping[str, Any], schema: Mapping[str, Any]) -> tuple[str, str]:
    """Description and unit of a field; the unit is 1 for a dimensionless number."""
    text = " ".join((one.get("description") or _table_of(one, schema).get("description", "")).split())
    unit = UNIT.search(text)
    text = _plain(UNIT.sub("", text)).replace("|", "\\|")
    return text, unit[1] if unit else "1" if "number" in taken(one) else ""


def _table_of(one: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """The table that a field refers to; empty if it refers to none."""
    found = re.search(r"#/\$defs/(\w+)", json.dumps(one))
    return schema["$defs"][found[1]] if found else {}


def taken(one: Mapping[str, Any]) -> str:
    """The type and range of a field in words."""
    if "anyOf" in one:
        return " or ".join(dict.fromkeys(taken(choice) for choice in one["anyOf"] if choice.get("type") != "null"))
    if "$ref" in one:
        return "a table"
    if "const" in one:
        return f"`{json.dumps(one['const'])}`"
    if "enum" in one:
        return ", ".join(f"`{json.dumps(value)}`" for value in one["enum"])
    kind = one.get("type")
    if kind in ("number", "integer"):
        return " ".join(filter(None, ["number" if kind == "number" else "whole number", _range(one)]))
    if kind == "array":
        return _list(one)
    return {"string": "text", "boolean": "true or false", "object": "a table"}.get(str(kind), "anything")


def _range(one: Mapping[str, Any]) -> str:
    low, high = one.get("minimum"), one.get("maximum")
    if "exclusiveMinimum" in one:
        low, begin = one["exclusiveMinimum"], "above"
    else:
        begin = "from"
    if "exclusiveMaximum" in one:
        high, end = one["exclusiveMaximum"], "below"
    else:
        end = "to"
    return " ".join(
        [*([f"{begin} {low:g}"] if low is not None else []), *([f"{end} {high:g}"] if high is not None else [])]
    )


def _list(one: Mapping[str, Any]) -> str:
    if "prefixItems" in one:
        each = [taken(item) for item in one["prefixItems"]]
        return f"{len(each)} times {each[0]}" if len(set(each)) == 1 else f"[{', '.join(each)}]"
    items = one.get("items", {})
    least, most = one.get("minItems"), one.get("maxItems")
    count = f"{least or 0} to {most} times " if most else f"{least} or more times " if least else ""
    return f"list: {count}{taken(items) if items else 'anything'}"


def _default(one: Mapping[str, Any]) -> str:
    if "default" not in one or one["default"] is None:
        return "none"
    value = one["default"]
    return "its own defaults" if isinstance(value, dict) else f"`{json.dumps(value)}`"


def _plain(text: str) -> str:
    """A description in Markdown, with brackets and angles escaped."""
    return re.sub(r"([\[\]<>*])", r"\\\1", " ".join(text.split()))


def _light_fields(where: tuple[str, ...]) -> set[str] | None:
    """The fields of a table whose change needs a new trace, determined by changing each in a shipped scene."""
    if where and where[0] in EFFORT:
        return None
    if where and where[0] in READ_ONLY:
        return set()
    for name in ("prototype", "phantom"):
        scene = load_scene(HERE.parent / "scenes" / f"{name}.toml")
        table = _at(scene, where)
        if table is not None:
            break
    else:
        return set()
    rules = type(table).model_json_schema()["properties"]
    before, marked = light_digest(scene), set()
    with warnings.catch_warnings():
        # A list within a list gets a number: only whether the digest changes matters.
        warnings.simplefilter("ignore", UserWarning)
        for name, value in table:
            other = _other(value, taken(rules[name]))
            if name in FILLS or other is not None and light_digest(_with(scene, where, name, other)) != before:
                marked.add(name)
    return marked - {"schema_version"}


def _at(scene: Scene, where: tuple[str, ...]) -> Any:
    """The table at a path, the first of a list; None if the scene has none."""
    table: Any = scene
    for name in where:
        table = getattr(table, name)
        table = table[0] if isinstance(table, tuple) and table else table
        if not isinstance(table, Table):
            return None
    return table


def _other(value: Any, rule: str) -> Any:
    """Another value that a field could have; None for a table, whose fields are changed one by one."""
    if isinstance(value, Table) or "a table" in rule:
        return None
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, str):
        return f"{value}_"
    if isinstance(value, tuple) and value and isinstance(value[0], int | float):
        return tuple(one + 1 for one in value)
    words = {"whole number": 3, "number": 1.5, "2 times number": (9.0, 9.0), "true": True, "list": (1.0,)}
    return next((other for begin, other in words.items() if rule.startswith(begin)), "other")


def _with(table: Any, where: tuple[str, ...], name: str, value: Any) -> Any:
    """A copy of a table with another value at a path in it."""
    if not where:
        return table.model_copy(update={name: value})
    inner = getattr(table, where[0])
    first = _with(inner[0] if isinstance(inner, tuple) else inner, where[1:], name, value)
    return table.model_copy(update={where[0]: (first, *inner[1:]) if isinstance(inner, tuple) else first})


# Commands


def commands() -> str:
    """Every command with its options, from the command line's own help."""
    from nailoptics.cli import app

    text = app.generate_docs(output_format="markdown", heading_level=1)
    text = re.sub(r"^(nailoptics \S+) -m sphinx", r"\1", text, flags=re.M)  # of `python -m sphinx`, which builds this
    text = text[text.index("## nailoptics ") :]
    return re.sub(r"^(## )nailoptics ([\w-]+)", r"\1`\2`", text, flags=re.M)


# Library


SCENE_MEMBERS = "from_kicad, with_led, with_photodiode, with_, draw, layout, zone_edges_mm, zone_width_mm"


def library() -> str:
    """Every public name of the package, by kind."""
    kinds: dict[str, list[str]] = {"Functions": [], "Classes": [], "Errors": [], "Modules": []}
    for name in nailoptics.__all__:
        one = getattr(nailoptics, name)
        if inspect.ismodule(one):
            kinds["Modules"].append(_module(name, one))
        elif inspect.isclass(one) and issubclass(one, Exception):
            kinds["Errors"].append(f".. autoexception:: nailoptics.{name}\n")
        elif inspect.isclass(one):
            # The fields of a scene have a reference of their own.
            members = SCENE_MEMBERS if one is Scene else ""
            kinds["Classes"].append(f".. autoclass:: nailoptics.{name}()\n   :members: {members}\n")
        else:
            kinds["Functions"].append(f".. autofunction:: nailoptics.{name}\n")
    return "\n".join(f"## {kind}\n\n" + "\n".join(map(_rst, entries)) for kind, entries in kinds.items())


def _module(name: str, module: Any) -> str:
    """A module's functions, but for those that the package has, too."""
    public = [key for key, item in sorted(vars(module).items()) if callable(item) and not inspect.isclass(item)]
    functions = [
        f".. autofunction:: nailoptics.{name}.{key}\n"
        for key in public
        if key[0] != "_" and key not in nailoptics.__all__
    ]
    heading = f".. py:module:: nailoptics.{name}\n\n.. rubric:: nailoptics.{name}\n\n"
    return heading + f"{inspect.getdoc(module)}\n\n" + "\n".join(functions)


def _rst(text: str) -> str:
    return f"```{{eval-rst}}\n{text}```\n"


# Parameters that many functions have.
USUAL = {
    "scene": 'a scene, the path of its file, or the name of a shipped one, such as "prototype".',
    "progress": "called with how far the study is; `show_progress` shows it in a line.",
    "workers": "processes on this machine; one per core if not given.",
    "scheduler": "address of a Dask scheduler in place of local workers.",
    "path": "of the file.",
    "folder": "the folder, such as that of a sweep.",
    "text": "the scene as TOML.",
    "name": "of the scene in errors.",
}


@lru_cache
def usual_parameters() -> dict[str, str]:
    """What parameters are that a docstring does not say, as they are alike everywhere: above all options of a trace."""
    words = dict(USUAL)
    for name, one in json_schema()["$defs"]["Viewing"]["properties"].items():
        words[name] = " ".join(one["description"].split()) + " As [colour] says if not given."
    (options,) = ast.parse(inspect.getsource(TraceOptions)).body
    for field, text in itertools.pairwise(options.body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            said = " ".join(text.value.value.split())
            words[field.target.id] = said[0].lower() + said[1:]
    return words


def undescribed(one: object, lines: list[str]) -> list[str]:
    """Lines for parameters of a function that its docstring leaves to `usual_parameters`."""
    if not inspect.isfunction(one):
        return []
    described = {name for line in lines for name in re.findall(r"(\w+)(?=[\w, ]* : )", line)}
    words = usual_parameters()
    names = [name for name in inspect.signature(one).parameters if name in words and name not in described]
    return [f"{name} : {words[name]}" for name in names]


def as_markup(app: object, what: str, name: str, one: object, options: object, lines: list[str]) -> None:
    """Turn a docstring in this project's style into reStructuredText, arguments as fields."""
    lines += [*undescribed(one, lines), ""]
    written: list[str] = []
    entry: list[str] = []

    def end() -> None:
        text = " ".join(entry[1:])
        written.extend(f"{field} {text}" for field in entry[:1] for field in field.split("\n"))
        entry.clear()

    for line in lines:
        line = _marked(line)
        argument, section = (
            re.match(r"(\w[\w, ]*) : (.*)", line),
            re.match(r"(Returns|Raises|Warns|References): (.*)", line),
        )
        if argument or section:
            end()
            # `**requested` is spelled out in signatures.
            names = argument[1].replace("requested", "options").split(", ") if argument else []
            entry += ["\n".join(f":param {one}:" for one in names), argument[2]] if argument else []
            if section:
                entry += [f":{section[1].lower()}:" if section[1] == "Returns" else f":{section[1]}:", section[2]]
        elif entry and line.strip():
            entry.append(line.strip())
        else:
            end()
            written.append(line)
    end()
    lines[:] = [*in_order(one, written), ""]


def in_order(one: object, written: list[str]) -> list[str]:
    """The lines of a function with its parameters before all other fields, as in its signature."""
    order = (
        {f":param {name}": i for i, name in enumerate(inspect.signature(one).parameters)}
        if inspect.isfunction(one)
        else {}
    )
    parameters = [line for line in written if line.startswith(":param ")]
    others = [line for line in written if not line.startswith(":param ")]
    first = next((i for i, line in enumerate(others) if line.startswith(":")), len(others))
    parameters.sort(key=lambda line: order.get(line[: line.index(":", 1)], len(order)))
    return [*others[:first], *parameters, *others[first:]]


def _marked(line: str) -> str:
    """A line with names set as code and with reStructuredText's special characters escaped."""
    parts = re.sub(r"(?<!`)`([^`]+)`(?!`)", r"``\1``", line).split("``")
    parts[::2] = [re.sub(r"[*|@]|(?<=\w)_(?=\W|$)", r"\\\g<0>", part) for part in parts[::2]]
    return "``".join(parts)


# Output files


def outputs() -> str:
    """Every variable of every dataset that a command writes."""
    text = []
    for file, made in json.loads(OUTPUTS.read_text(encoding="utf-8")).items():
        text += [
            f"### {file}\n",
            f"Written by `{made['command']}`.\n",
            "| variable | dimensions | unit | meaning |",
            "|---|---|---|---|",
        ]
        for name, one in made["variables"].items():
            if name.endswith("_stderr") and name.removesuffix("_stderr") in made["variables"]:
                continue
            error = " ±" if f"{name}_stderr" in made["variables"] else ""
            dims = ", ".join(one["dims"]) or "scalar"
            text.append(f"| `{name}`{error} | {dims} | {one['units']} | {_plain(one['long_name'])} |")
        text.append("")
    return "\n".join(text)


def parts() -> str:
    """The shipped parts, with the comments that give their sources."""
    text = []
    for path in sorted((HERE.parent / "assets/parts").glob("*.toml")):
        lines = path.read_text(encoding="utf-8").splitlines()
        words = " ".join(line.removeprefix("#").strip() for line in lines if line.startswith("#"))
        kind = next(line for line in lines if line.startswith("kind")).split('"')[1]
        text += [f"`{path.stem}` ({kind})", f": {_plain(words)}", ""]
    return "\n".join(text)


def priors() -> str:
    """The shipped priors of a finger, with range and source."""
    rows = ["| field | quantity | range | source |", "|---|---|---|---|"]
    for one in shipped_priors():
        rows.append(f"| `{one.field}` | {one.name} | {one.low:g} to {one.high:g} | {_plain(one.source)} |")
    return "\n".join(rows) + "\n"


def tissue_optics() -> str:
    """Optical properties of every region of the prototype at rest, at three wavelengths."""
    scene, nm = load_scene(HERE.parent / "scenes/prototype.toml"), (660.0, 800.0, 940.0)
    whole = scene.with_(**{"light.left_out": [], "light.index_steps": True, "light.similarity": False})
    media = [optics.finger_media(whole, optics.TISSUES, one) for one in nm]
    at = ", ".join(f"{one:g}" for one in nm)
    rows = [f"| region | n | g | µs' [1/mm] at {at} nm | µa [1/mm] at {at} nm |", "|---|---|---|---|---|"]
    for i, region in enumerate(optics.TISSUES):
        scattered = ", ".join(f"{one.mu_s[i] * (1 - one.g[i]):.3g}" for one in media)
        absorbed = ", ".join(f"{one.mu_a[i]:.3g}" for one in media)
        rows.append(f"| {region} | {media[1].n[i]:.3g} | {media[1].g[i]:.2g} | {scattered} | {absorbed} |")
    return "\n".join(rows) + "\n"


def validation() -> str:
    """What was measured on people beside the model, what disagrees first: a table, and figures of curves."""
    made = json.loads((HERE / "validation.json").read_text(encoding="utf-8"))
    ranked = sorted(made["tables"].values(), key=lambda one: one["agrees"])
    rows = [validation_page.row(one) for one in ranked]
    cells = [[*rows[0]], ["---"] * len(rows[0]), *(row.values() for row in rows)]
    table = [f"| {' | '.join(map(str, line))} |" for line in cells]
    return (
        "\n".join([f"{validation_page.counts_in_words(made).capitalize()}.", "", *table, "", *map(_compared, ranked)])
        + "\n"
    )


def _compared(one: Mapping[str, Any]) -> str:
    """A heading and the statistic of one quantity, of a curve below its figure."""
    # A blank line would end the HTML.
    figure = re.sub(r"\n\s*\n", "\n", validation_page.figure_of(one))
    name = one["quantity"] if one["quantity"][1] == "*" else one["quantity"][0].upper() + one["quantity"][1:]
    name = name.replace("*", "\\*")
    return f"**{name}**\n\n{figure}\n\n{one.get('remark', '')}\n"


def force() -> str:
    """How well force is estimated of virtual people: medians over each simulator's, with the best and the worst."""
    numbers = ("rms_n", "filter_n", "cubic_n", "components_n", "sigmoid_n", "covered", "half_width_n", "open")
    head = [
        "virtual people of",
        "touches",
        "error",
        "best, worst",
        "floor",
        "filter",
        "cubic",
        "components",
        "sigmoid",
        "covered",
        "half width",
        "open",
    ]
    rows = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for names, of_group in _force_groups():
        median = {name: statistics.median(one[name] for one in of_group) for name in numbers}
        errors = sorted(one["rms_n"] for one in of_group)
        ends = f"{1e3 * errors[0]:.0f}, {1e3 * errors[-1]:.0f}"
        error, *cells = (f"{1e3 * median[name]:.0f}" for name in numbers[:5])
        cells += [f"{median['covered']:.0%}", f"{1e3 * median['half_width_n']:.0f}", f"{median['open']:.0%}"]
        floors = [1e3 * one["floor_n"] for one in of_group if "floor_n" in one]
        floor = f"{statistics.median(floors):.0f}" if floors else ""
        rows.append(f"| {' | '.join([*names, error, ends, floor, *cells])} |")
    return "\n".join(rows) + "\n"


def force_exceptions() -> str:
    """Of how many virtual people the estimate is worse than a simpler one or seldom covers, by their touches."""
    head = ["virtual people of", "touches", "> 1.15 filter", "> 1.1 cubic", "covered < 85 %", "half width / error"]
    rows = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for names, of_group in _force_groups():
        beside_filter, beside_cubic, half_widths = (
            [one[name] / one[to] for one in of_group]
            for name, to in (("rms_n", "filter_n"), ("rms_n", "cubic_n"), ("half_width_n", "rms_n"))
        )
        cells = [
            _count_and_worst([ratio for ratio in beside_filter if ratio > 1.15], max, "{:.2f}"),
            _count_and_worst([ratio for ratio in beside_cubic if ratio > 1.1], max, "{:.2f}"),
            _count_and_worst([one["covered"] for one in of_group if one["covered"] < 0.85], min, "{:.0%}"),
            f"{statistics.median(half_widths):.1f}",
        ]
        rows.append(f"| {' | '.join([*names, *cells])} |")
    return "\n".join(rows) + "\n"


def _force_groups() -> Iterator[tuple[tuple[str, str], list[dict[str, Any]]]]:
    """Simulator with its number of people, and kind of touches; and the scores of each of these people."""
    people = json.loads((HERE / "force_benchmark.json").read_text(encoding="utf-8"))["people"]
    kinds = [f"{kind} {site}" for site in ("proximal", "distal", "even") for kind in ("slow", "steps")]
    for simulator, touches in itertools.product(dict.fromkeys(one["simulator"] for one in people), kinds):
        scores = [one for one in people if (one["simulator"], one["touches"]) == (simulator, touches)]
        yield (f"{simulator} ({len(scores)})", touches), scores


def _count_and_worst(values: list[float], worst: Callable[[list[float]], float], text: str) -> str:
    """How many values, with the worst of them in brackets."""
    return f"{len(values)} ({text.format(worst(values))})" if values else "0"


@lru_cache
def force_pictures() -> str:
    """The touches of the best, the median and the worst virtual person of each simulator."""
    kept = json.loads((HERE / "force_benchmark.json").read_text(encoding="utf-8"))["series"]
    out = []
    for (simulator, rank), group in itertools.groupby(kept, key=lambda one: (one["simulator"], one["rank"])):
        touches = list(group)
        title = f"Virtual person {touches[0]['person']} of {simulator}, the {rank}"
        figure = html.figure(
            _touch_figure(touches), f"{title}. Black: true force; blue: estimate with its 95 % interval."
        )
        out.append(f"**{title}**\n\n" + re.sub(r"\n\s*\n", "\n", figure))
    return "\n\n".join(out) + "\n"


@style.drawing()
def _touch_figure(touches: list[dict[str, str]]) -> "style.Figure":
    figure, axes = style.panels(7.2, 3.6, 2, 3, sharey=True)
    for panel, one in zip(axes.ravel(), touches, strict=True):
        columns = (one[name].split() for name in ("time_s", "known_n", "force_n", "low_n", "high_n"))
        time_s, known_n, force_n, low_n, high_n = ([float(text) / 1e3 for text in column] for column in columns)
        most_n = 1.5
        panel.fill_between(
            time_s, low_n, [min(high, most_n) for high in high_n], color=style.ZONES[1], alpha=0.2, linewidth=0
        )
        panel.plot(time_s, force_n, color=style.ZONES[1])
        panel.plot(time_s, known_n, color=style.INK, linewidth=0.9)
        panel.set(title=one["touches"], ylim=(-0.05, most_n))
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    for panel in axes[:, 0]:
        panel.set_ylabel("force [N]")
    return figure


MADE: dict[str, Callable[[], str]] = {
    one.__name__: one
    for one in (
        fields,
        sweep_fields,
        part_fields,
        commands,
        library,
        outputs,
        parts,
        priors,
        tissue_optics,
        validation,
        force,
        force_exceptions,
        force_pictures,
    )
}
