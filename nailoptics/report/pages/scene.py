"""A scene as a notebook shows it, its board on the nail and the section below it, and the page of its check."""

from typing import Any

import numpy as np

from ...errors import InputError
from ...geometry import build
from ...light import section as cut
from ...scene import Scene
from ...studies.scene_check import SceneCheck, check
from .. import maps, style
from ..files import Report
from ..html import document, figure, preformatted, section, texts
from ..scene_description import blood_words, body_words, check_lines, touch_words


@style.drawing()
def draw(scene: Scene) -> "style.Figure":
    """The board on the nail from above, and the section below it; raises InputError for a phantom."""
    if scene.finger is None:
        raise InputError("a phantom has no board to draw; give a scene with [finger].")
    figure, (top, below) = style.panels(9.6, 4.2, 1, 2, width_ratios=(4, 5))
    maps.draw_top_view(top, scene)
    maps.draw_section(below, scene, cut(scene), led=0)
    return figure


def page(checked: SceneCheck) -> str:
    """The page of a check."""
    caption = "The board on the nail, and the section below it."
    drawn = figure(draw(checked.scene), caption) if checked.scene.finger else ""
    lines = preformatted("\n".join(check_lines(summary(checked))))
    return document(
        kicker="check",
        title=repr(checked.scene)[1:-1],
        lead="Readings are those of a short trace.",
        warnings=checked["warnings"],
        body=[section("The scene", drawn, lines)],
        attributes={},
    )


def summary(checked: SceneCheck) -> dict[str, Any]:
    """A check's results; of a finger also its touch, blood and body in words, and the geometry."""
    scene, made = checked.scene, {"valid": True, **checked}
    if scene.finger is None:
        return made
    mesh, remark = build(scene), texts("scene")["sets"].get(scene.blood.parameters, "")
    there = [mesh.regions[k] for k in np.union1d(mesh.below, mesh.above)]
    made |= {"touch": touch_words(scene), "blood": blood_words(scene) + remark, "body": body_words(scene)}
    made |= {"vessels": scene.blood.parameters, "regions": there, "triangles": len(mesh.triangles)}
    return made


CHECK = Report(
    ("check.html",),
    page,
    summary,
    lambda _, summary: check_lines(summary),
    {"board": lambda checked: draw(checked.scene)},
)
SCENE = Report(
    ("check.html",),
    lambda scene: page(check(scene)),
    lambda scene: scene.model_dump(mode="json", exclude_none=True),
    lambda scene, _: [repr(scene)],
    {"board": draw},
    scene=lambda scene: scene,
)
