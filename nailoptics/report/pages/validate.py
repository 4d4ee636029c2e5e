"""The page of `validate`: the model compared with tables measured on people, the largest disagreement first."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ...studies.validate import Comparison, Validation
from .. import style
from ..files import Report
from ..html import Html, document, figure, section, small, table
from ..numbers import aligned, significant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAD = (
    "What was measured on people, and what the model says of the same quantity. Fitted: the model was fitted to these "
    "people. Held out: it was fitted to others of the same table. Prediction: it was not fitted to the quantity."
)
NOTE = (
    "z: difference over its standard error, which agrees between -2 and 2. Coverage: the part of what each figure "
    "states; an interval of the model that holds more than 99 % of many people does not agree either."
)


def page(result: Validation) -> str:
    """The page of a validation."""
    ranked = sorted(result.tables.values(), key=lambda comparison: comparison.agrees)
    return document(
        kicker="validation",
        title="Comparison with measurements on people",
        lead=LEAD,
        cards=[(f"{n} of {count}", f"{words} quantities agree") for words, (n, count) in result.counts().items()],
        body=[
            section(
                "All quantities, what disagrees first",
                table([_row(one) for one in ranked], kind="compared"),
                small(NOTE),
                *(f"No data: {name}." for name in result.no_data),
            ),
            *(section(one.quantity, figure_of(one), small(one.remark)) for one in ranked),
        ],
        attributes=result.attributes,
    )


def figure_of(comparison: Comparison) -> Html:
    """The figure of a quantity with its statistic, what was fitted, and its source."""
    agrees = "agrees" if comparison.agrees else "disagrees"
    counted = f" of {comparison.counted}" if comparison.counted else ""
    caption = (
        f"{comparison.statistic} {significant(comparison.value, 2)}{counted}: {agrees}. "
        f"{comparison.basis.capitalize()}: {comparison.fit}. People: {comparison.source}"
    )
    return figure(draw(comparison), caption, narrow=True)


def _range(rows: np.ndarray) -> str:
    """A middle with its interval; of a curve, over all its points."""
    if rows.shape[1] > 1:
        return f"{significant(float(rows[1].min()), 3)} to {significant(float(rows[1].max()), 3)}"
    low, middle, high = (significant(float(value), 3) for value in rows[:, 0])
    return f"{middle} ({low} to {high})"


def _row(comparison: Comparison) -> dict[str, object]:
    low, high = comparison.accepted
    return {
        "Quantity": comparison.quantity + _units(comparison),
        "Basis": comparison.basis,
        "Agrees": "yes" if comparison.agrees else "no",
        "Statistic": f"{comparison.statistic} {significant(comparison.value, 2)}",
        "Accepted": f"{low:g} to {high:g}",
        "People": _range(comparison.people),
        "Model": _range(comparison.model),
    }


def _units(comparison: Comparison) -> str:
    return "" if comparison.units == "1" else f" [{comparison.units}]"


@style.drawing()
def draw(comparison: Comparison) -> "Figure":
    """People and model with their intervals: side by side, or over what the quantity is measured over."""
    of_people, of_model = comparison.bands
    both = (
        (f"people: {of_people}", comparison.people, style.MUTED),
        (f"model: {of_model}", comparison.model, style.ZONES[0]),
    )
    if not comparison.x_label:
        drawing, axes = style.panels(5.5, 1.3)
        for row, (name, values, colour) in enumerate(both):
            low, middle, high = values[:, 0]
            axes.plot([low, high], [row, row], color=colour, lw=2.2)
            axes.plot(middle, row, "o", color=colour, label=name)
        axes.set_yticks([0, 1], ["people", "model"])
        axes.set(ylim=(1.6, -0.6), xlabel=_units(comparison).strip(" []"))
        style.legend_above(drawing, axes, ncols=1)
        return drawing
    drawing, axes = style.panels(5.5, 3.0)
    for name, values, colour in both:
        axes.fill_between(comparison.x, values[0], values[2], color=colour, alpha=0.2, linewidth=0)
        axes.plot(comparison.x, values[1], color=colour, label=name)
    axes.set(xlabel=comparison.x_label, ylabel=_units(comparison).strip(" []"))
    style.legend_above(drawing, axes, ncols=1)
    return drawing


def lines(summary: dict[str, Any]) -> list[str]:
    """Every table's verdict for the terminal, what disagrees first."""
    rows = []
    for name, one in sorted(summary["tables"].items(), key=lambda item: item[1]["agrees"]):
        statistic, row = "z" if "z" in one else "coverage", {"quantity": name, "basis": one["basis"]}
        for side in ("people", "model"):
            values = np.atleast_1d(one[side]["middle"])
            row[side] = f"{values.min():.3g}" + (f" to {values.max():.3g}" if len(values) > 1 else "")
        row |= {"statistic": f"{statistic} {one[statistic]:.2g}", "verdict": "agrees" if one["agrees"] else "DISAGREES"}
        rows.append(row)
    counts = [f"of {count} {words} quantities {n} agree" for words, (n, count) in summary["counts"].items()]
    return [*aligned(rows), *(f"{name}: no data" for name in summary["no_data"]), ", ".join(counts)]


def summary(result: Validation) -> dict[str, Any]:
    """Every table as plain numbers and texts."""
    made: dict[str, Any] = {"tables": {name: table.as_dict() for name, table in result.tables.items()}}
    made |= {"counts": result.counts(), "no_data": [*result.no_data]}
    return made | dict(result.attributes)


def _files(result: Validation) -> tuple[Any, ...]:
    return (lambda _: page(result),)


VALIDATION = Report(("validation.html",), _files, summary, lambda result, summary: lines(summary))
