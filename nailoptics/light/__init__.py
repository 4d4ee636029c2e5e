"""MEDIA AND SHAPE TO DETECTED LIGHT: the only room that imports Mitsuba, and only when light is traced."""

from .board_map import map_board
from .engines import Light, open_light
from .rest import Rest, read_rest
from .tracing import Progress, trace
from .transfer import RereadWarning, Transfer

__all__ = ["Light", "Progress", "RereadWarning", "Rest", "Transfer", "map_board", "open_light", "read_rest", "trace"]
