"""Whatever a result shows of itself, as Python and notebooks request it."""

import json
from typing import Any

from matplotlib.figure import Figure


def all_shown(result: Any, *, page: bool = True) -> dict[str, Figure]:
    """The figures of a result, each made, after its page, summary and lines have been made, too.

    page : whether its page is made, which takes seconds; a command may have written it before.
    """
    shown, again = result.nail, json.dumps(result.nail.summary(), default=str)
    assert not page or shown.report().startswith("<!doctype html>")
    assert shown._repr_html_().startswith("<pre>") and len(again) > 2
    drawn = {name: shown.plot(name) for name in shown.figures}
    assert all(isinstance(one, Figure) and one.axes for one in drawn.values())
    return drawn
