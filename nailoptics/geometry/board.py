"""The board bent onto the nail: its edges as angles and places, and what each cell above the nail is."""

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene import Scene
from ..scene.rectangles import Rectangle, encloses, sides_of
from .regions import AIR, BARRIER, COVER, EPOXY, KAPTON, REGIONS, SILICON, region_names
from .surfaces import Array, FingerSurfaces

RIM_MM = 0.15  # width of the opaque epoxy around the board
EDGE_MM = 0.01  # the rim ends this far before the nail's edges
NAIL_STEP_MM = 0.5  # the largest cells on the nail
STEP_MM = 0.2  # those below a board whose outline is drawn, less than half of the usual epoxy's depth
STRAIGHT_MM = 1e-6  # an edge that runs aside by less is straight
FACE_MM = 0.01  # of a part that stands out of the board, so much is the face; the walls above are silicon


class BentBoard:
    """A board whose underside is a cylinder around the nail's axis.

    Positions across the board are arc lengths on that underside: a film that bends keeps its lengths there, and its
    dies keep their areas.

    radius_mm : Radius of the underside. [mm]
    heights_mm : (n + 3,) float, or one more with a layer of air. Heights above the nail: the air, faces of parts that
        stand out of the underside, the underside, film and cover. [mm]
    rim : The outline with the rim of opaque epoxy around it, as far as the nail carries it.
    parts : Region, rectangle and height below the underside of each part: LEDs, photodiodes, unwired elements.
    rectangles : Everything on the board that begins or ends somewhere. step_mm : The largest cells. [mm]
    """

    def __init__(self, scene: Scene, surfaces: FingerSurfaces) -> None:
        board, layout = scene.board, scene.layout
        self.scene, self.layout = scene, layout
        height_mm = board.height_mm
        stands_out = [*(led.height_um for led in scene.leds), *(e.photodiode.height_um for e in layout.photodiodes)]
        stands_out += [layout.unwired_height_um] * len(layout.unwired)
        # Depths below the underside where a part's face or the walls above it begin, the deepest first.
        depths = {round(1e-3 * h - less, 3) for h in stands_out if h for less in (0.0, FACE_MM)}
        self.depths_mm = sorted((depth for depth in depths if depth > 0), reverse=True)
        above = np.array([0.0, board.kapton_um, board.kapton_um + board.cover_um]) * 1e-3
        heights = height_mm + np.concatenate([-np.array(self.depths_mm), above])
        self.heights_mm = heights if board.air_gap_um is None else np.append(1e-3 * board.air_gap_um, heights)
        self.radius_mm = surfaces.finger.nail_radius_mm + height_mm
        outline, v_end = layout.outline, surfaces.nail_end - EDGE_MM
        u_end = surfaces.nail_half_angle * self.radius_mm - EDGE_MM
        self.rim = Rectangle(
            "rim",
            max(outline.u_min - RIM_MM, -u_end),
            min(outline.u_max + RIM_MM, u_end),
            max(outline.v_min - RIM_MM, -v_end),
            min(outline.v_max + RIM_MM, v_end),
        )
        self.regions = region_names(layout)
        regions = [*range(len(REGIONS), len(self.regions)), *[SILICON] * len(layout.unwired)]
        areas = zip(regions, [*layout.leds, *layout.photodiode_areas, *layout.unwired], stands_out, strict=True)
        self.parts = [(region, r, round(1e-3 * height, 3)) for region, r, height in areas]
        self.rectangles = [self.rim, outline, *layout.barriers, *(s for _, r, _ in self.parts for s in r.strips())]
        # A drawn border runs in steps through the cells, but for its straight edges.
        self.step_mm = STEP_MM if layout.border_mm else NAIL_STEP_MM
        ends = (self.rim.u_min, self.rim.v_min), (self.rim.u_max, self.rim.v_max)
        for line in layout.border_mm:
            for edge in sides_of(line):
                if np.ptp(edge, axis=0).min() < STRAIGHT_MM:
                    (a, b), (c, d) = np.sort(np.clip(edge, *ends), axis=0).tolist()
                    self.rectangles.append(Rectangle("edge", a, c, b, d))

    def labels(self, theta: Array, v: Array) -> NDArray[np.int32]:
        """Region of the layers above the nail, (a, n, k), in cells with middles theta (a,) [rad], v (n,) [mm]."""
        film = len(self.depths_mm) + 1  # below it lies the epoxy, above it the cover
        result = np.full((len(theta), len(v), film + 2), AIR, np.int32)

        def inside(r: Rectangle) -> NDArray[np.bool_]:
            u = theta * self.radius_mm
            return ((u > r.u_min) & (u < r.u_max))[:, None] & ((v > r.v_min) & (v < r.v_max))

        top, rim, board = COVER if self.scene.board.cover_um else AIR, inside(self.rim), inside(self.layout.outline)
        if self.layout.border_mm:
            u, v_on = np.meshgrid(theta * self.radius_mm, v, indexing="ij")
            ways = STEP_MM * np.exp(0.25j * np.pi * np.arange(8))
            drawn, *beside = (encloses(u + way.real, v_on + way.imag, *self.layout.border_mm) for way in (0j, *ways))
            board, rim = board & drawn, rim & np.any([drawn, *beside], axis=0)
        result[rim] = [COVER] * (film + 1) + [top]
        result[board] = [EPOXY] * film + [KAPTON, top]
        for wall in self.layout.barriers:
            result[inside(wall) & board, :film] = BARRIER
        for region, r, height_mm in self.parts:
            cells = np.any([inside(strip) for strip in r.strips()], axis=0)
            if r.turned_size_mm is not None:
                # Steps of neighbours that touch may overlap by less than a strip.
                cells &= result[..., film] == KAPTON
            if not cells.any() or (result[cells][:, film] != KAPTON).any():
                why = "or lies on another part; make it larger than 1 um and move it."
                raise InputError(f'board: "{r.name}" is smaller than the geometry can show, {why}')
            result[cells, film] = SILICON if height_mm else region
            for k, (below, above) in enumerate(zip(self.depths_mm, [*self.depths_mm, 0.0][1:], strict=True), start=1):
                if below <= height_mm:
                    result[cells, k] = region if above >= height_mm - FACE_MM - 1e-9 else SILICON
        if self.scene.board.air_gap_um is not None:
            result = np.concatenate([np.full_like(result[..., :1], AIR), result], axis=2)
        return result
