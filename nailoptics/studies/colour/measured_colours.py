"""Colours of people that were published: what a traced finger should lie among."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MeasuredColour:
    """L*, a* and b* of some people's skin, as published.

    lab : of their mean, or of each group that was told apart.
    sd : standard deviations between people; None where groups are given.
    """

    name: str
    source: str
    lab: tuple[tuple[float, float, float], ...]
    sd: tuple[float, float, float] | None = None


# Of nails no table of L*a*b* was found. They were measured on 92 people (K. Horibata et al., J. Gen. Fam. Med. (2025),
# doi 10.1002/jgf2.776) and on one (C. Monpeurt et al., Int. J. Cosmet. Sci. (2017)), but the numbers were not at hand.
MEASURED = (
    MeasuredColour(
        name="skin of 148 Asians",
        source="Yun 2010, Skin Res. Technol., doi 10.1111/j.1600-0846.2010.00434.x: forehead, cheek, arm, back of the "
        "hand and chest, spectrophotometer",
        lab=((64.15, 8.96, 18.34),),
        sd=(4.86, 2.65, 2.39),
    ),
    MeasuredColour(
        name="facial skin of 120 people, five groups",
        source="IADR 2009, Miami, abstract 120461: White, Black, Asian and other people, 45/0 degrees, not in contact",
        lab=((52.5, 17.0, 18.9), (37.7, 17.2, 14.7), (49.4, 22.0, 12.3), (41.5, 25.5, 13.3), (26.7, 14.6, 14.7)),
    ),
)
