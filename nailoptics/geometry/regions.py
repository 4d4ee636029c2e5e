"""Names of the regions of a finger with its board, in the order of their indices."""

from ..scene.layout import Layout

REGIONS = ("air", "plate", "bed", "bone", "pulp", "epidermis", "epoxy", "barrier", "kapton", "cover", "cut", "silicon")
"""Regions that every geometry names, though some may be empty; dies and photodiode elements follow.

plate, bed, bone : the nail and what lies under it.
pulp : all other soft tissue.
epidermis : the outermost skin, outside the nail.
epoxy : clear epoxy and adhesive, one region because they have one index.
barrier : opaque walls between LEDs and photodiodes, from the nail to the board.
kapton : the board's film beside its parts.
cover : opaque epoxy over the board, if it has a cover, and the rim of it that closes the board's four sides down to
    the nail.
cut : a slice beyond the proximal end of the modelled finger, to distinguish light that goes up the finger from light
    that leaves to the air.
silicon : photodiode elements that are not wired.
"""
AROUND = {"bone": "pulp", "epidermis": "pulp", "kapton": "epoxy"}
"""The region around each part that a scene may leave out, which takes its place."""
AIR, PLATE, BED, BONE, PULP, EPIDERMIS, EPOXY, BARRIER, KAPTON, COVER, CUT, SILICON = range(len(REGIONS))


def region_names(layout: Layout) -> tuple[str, ...]:
    """Names of all regions of a finger with a board of this layout; their order is that of the geometry's indices."""
    leds = (f"led:{die.name}" for die in layout.leds)
    return (*REGIONS, *leds, *(f"photodiode:{name}" for name in layout.photodiode_names))
