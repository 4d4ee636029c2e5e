"""What is unknown of a finger as changes of its scene, to be ranked beside the parts that it models or leaves out."""

from collections.abc import Iterator

import numpy as np

from ...scene import Prior, Scene
from ..prior_uncertainty import only_absorbs, value_of
from .effect import Change


def unknown_changes(scene: Scene) -> Iterator[Change]:
    """Each prior of the scene at that end of its range which is farther from the scene's value."""
    if not scene.priors.spread:
        return
    for prior in scene.priors.of_finger():
        end = _farther_end(prior, value_of(scene, prior.field))
        table, name = prior.field.split(".")
        text = f"{name} = {end:g}, of {prior.low:g} to {prior.high:g}"
        yield Change(
            prior.name, True, text, {table: {name: end}}, same_photons=only_absorbs(scene, prior), unknown=True
        )


def _farther_end(prior: Prior, value: float) -> float:
    """The end of a range that lies farther from a value, on the prior's scale."""
    low, middle, high = (np.log(x) if prior.scale == "log" else x for x in (prior.low, value, prior.high))
    # A nudge, so that rounding does not decide between ends that are as far.
    return prior.low if middle - low > high - middle + 1e-3 else prior.high
