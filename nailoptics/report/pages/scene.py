"""A scene as a notebook shows it: its board on the nail, and the finger cut lengthwise below it."""

from typing import TYPE_CHECKING

from ...errors import InputError
from ...light import section
from ...scene import Scene, to_toml
from ...studies.scene_check import check_scene
from .. import maps, style
from ..files import Report
from ..scene_description import check_lines

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@style.drawing()
def draw(scene: Scene) -> "Figure":
    """The board on the nail from above, and the section below it; raises InputError for a phantom."""
    if scene.finger is None:
        raise InputError("a phantom has no board to draw; give a scene with [finger].")
    figure, (top, cut) = style.panels(9.6, 4.2, 1, 2, width_ratios=(4, 5))
    maps.draw_top_view(top, scene)
    maps.draw_section(cut, scene, section(scene), led=0)
    return figure


SCENE = Report(
    ("scene.toml",),
    lambda scene: (to_toml(scene),),
    check_scene,
    lambda _, summary: check_lines(summary),
    {"board": draw},
)
