"""The score of one layout, as tests want it."""

from typing import Any

from nailoptics.studies.placement.objective import LayoutScore, Objective, scores_of
from nailoptics.studies.placement.photon_maps import PhotonMapCache


def score_layout(layout: Any, cache: PhotonMapCache, objective: Objective) -> LayoutScore:
    """From the light that a cache has of its board."""
    return scores_of([cache.read(layout.scene, layout.board, len(objective.points))], objective)[0]
