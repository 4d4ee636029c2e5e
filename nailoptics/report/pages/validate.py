"""The page of `validate`: the model compared with tables measured on people, the largest disagreement first."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...studies.validation.validate import Validation
from .. import style
from ..files import Report
from ..html import Html, document, figure, section, small, table, texts
from ..numbers import aligned, significant

TEXTS = texts("validate")


def page(result: Validation) -> str:
    """The page of a validation."""
    ranked = [quantity for _, quantity in _ranked(summary(result))]
    cards = [(f"{n} of {count}", f"{words} quantities agree") for words, (n, count) in result.counts().items()]
    compared, missing = table(list(map(row, ranked)), kind="compared"), (f"No data: {name}." for name in result.no_data)
    body = [section("All quantities, what disagrees first", compared, small(TEXTS["note"]), *missing)]
    body += [section(one["quantity"], figure_of(one), small(one.get("remark", ""))) for one in ranked]
    return document(**TEXTS["page"], lead=TEXTS["lead"], cards=cards, body=body, attributes=result.attributes)


def figure_of(quantity: Mapping[str, Any]) -> Html:
    """The statistic of a quantity of a summary, what was fitted, and its source; of a curve below its figure."""
    agrees = "agrees" if quantity["agrees"] else "disagrees"
    counted = f" of {quantity['counted']}" if "counted" in quantity else ""
    fit = f"{quantity['basis'].capitalize()}: {quantity['fit']}"
    caption = f"{_statistic(quantity)}{counted}: {agrees}. {fit}. People: {quantity['source']}"
    if quantity.get("over"):
        return figure(draw(quantity), caption, narrow=True)
    return small("{} Intervals are, of people, {}, and of the model, {}.".format(caption, *quantity["bands"]))


def row(quantity: Mapping[str, Any]) -> dict[str, str]:
    """A quantity of a summary as a row of a table."""
    low, high = quantity["accepted"]
    return {
        "Quantity": quantity["quantity"] + _units(quantity),
        "Basis": quantity["basis"],
        "Agrees": "yes" if quantity["agrees"] else "no",
        "Statistic": _statistic(quantity),
        "Accepted": f"{low:g} to {high:g}",
        "People": _range(_ends(quantity, "people")),
        "Model": _range(_ends(quantity, "model")),
    }


def _statistic(quantity: Mapping[str, Any]) -> str:
    if "z" in quantity:
        return f"z {significant(quantity['z'], 2)}"
    return f"coverage {significant(quantity['coverage'], 3)}"


def _ranked(summary: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """The quantities of a summary by their names, what disagrees first."""
    return sorted(summary["tables"].items(), key=lambda item: item[1]["agrees"])


def _units(quantity: Mapping[str, Any]) -> str:
    return "" if quantity["units"] == "1" else f" [{quantity['units']}]"


def _ends(quantity: Mapping[str, Any], side: str) -> np.ndarray:
    """Lower end, middle and upper end of a side, (3, n) float."""
    return np.array([np.atleast_1d(quantity[side][end]) for end in ("low", "middle", "high")])


def _range(ends: np.ndarray) -> str:
    """A middle with its interval; of a curve, over all its points."""
    if ends.shape[1] > 1:
        return f"{significant(float(ends[1].min()), 3)} to {significant(float(ends[1].max()), 3)}"
    low, middle, high = (significant(float(value), 3) for value in ends[:, 0])
    return f"{middle} ({low} to {high})"


@style.drawing()
def draw(quantity: Mapping[str, Any]) -> "style.Figure":
    """People and model with their intervals over what the quantity is measured over."""
    ((x_label, x),) = quantity["over"].items()
    drawing, axes = style.panels(5.5, 3.0)
    for k, (side, colour) in enumerate({"people": style.MUTED, "model": style.ZONES[0]}.items()):
        low, middle, high = _ends(quantity, side)
        axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(x, middle, color=colour, label=f"{side}: {quantity['bands'][k]}")
    axes.set(xlabel=x_label, ylabel=_units(quantity).strip(" []"))
    style.legend_above(drawing, axes, ncols=1)
    return drawing


def lines(summary: Mapping[str, Any]) -> list[str]:
    """Every quantity's verdict for the terminal, what disagrees first."""
    rows = [row(quantity) for _, quantity in _ranked(summary)]
    return [*aligned(rows), *(f"{name}: no data" for name in summary["no_data"]), f"{counts_in_words(summary)}."]


def counts_in_words(summary: Mapping[str, Any]) -> str:
    """How many quantities of a summary agree, in words; the documentation has it, too."""
    return ", ".join(f"of {count} {words} quantities {n} agree" for words, (n, count) in summary["counts"].items())


def summary(result: Validation) -> dict[str, Any]:
    """Every quantity as plain numbers and texts."""
    tables = {name: quantity.as_dict() for name, quantity in result.tables.items()}
    return {"tables": tables, "counts": result.counts(), "no_data": [*result.no_data], **result.attributes}


def _figure(result: Validation, quantity: str = "") -> "style.Figure":
    """One quantity that is a curve, the first that disagrees if none is named."""
    curves = {name: one for name, one in _ranked(summary(result)) if one.get("over")}
    return draw(curves[quantity or next(iter(curves))])


VALIDATION = Report(("validation.html",), page, summary, lambda result, summary: lines(summary), {"quantity": _figure})
