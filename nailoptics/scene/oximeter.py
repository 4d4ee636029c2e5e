"""How a pulse oximeter's LEDs are lit in turn, and how the stage behind its photodiodes is sampled."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field, model_validator

from .base import Name, NonNegative, Positive, Table, check_unique
from .parts import Led

DARK = "dark"
# Nearer to each other, two lines see nearly the same blood.
LEAST_APART_NM = 20.0


class Slot(Table):
    """A part of a frame with one LED lit, or none."""

    light: Name
    """Name of the LED that is lit; "dark" for none, to measure ambient light."""
    start_ms: NonNegative
    """From the start of the frame. [ms]"""
    length_ms: Positive
    """Duration. [ms]"""


class Oximeter(Table):
    """The timing of a pulse oximeter, repeated every frame."""

    frame_hz: Annotated[float, Field(ge=10, le=10_000)] = 100.0
    """Frame rate: each frame gives one reading of each LED. [Hz]"""
    slots: Annotated[tuple[Slot, ...], Field(min_length=2, max_length=66)] | None = None
    """Slots in order of time; if not given one for each LED and a dark one, each a third of the frame."""
    settle: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Fraction of a slot at its start in which the amplifier settles and nothing is sampled."""
    samples: Annotated[int, Field(ge=1, le=1000)] = 4
    """Number of samples averaged over the rest of a slot."""
    hold_pf: Positive = 10.0
    """Capacitor of the sample-and-hold, which adds its thermal noise to each sample. [pF]"""

    @model_validator(mode="after")
    def _slots_follow_each_other(self) -> Self:
        slots = self.slots or ()
        for i, (before, after) in enumerate(pairwise(slots)):
            end_ms = before.start_ms + before.length_ms
            if after.start_ms < end_ms - 1e-9:
                raise ValueError(
                    f"slots[{i + 1}].start_ms = {after.start_ms:g} overlaps slots[{i}], which ends at {end_ms:g} ms; "
                    "start it later, or shorten that one"
                )
        if slots and slots[-1].start_ms + slots[-1].length_ms > 1e3 / self.frame_hz + 1e-9:
            raise ValueError(
                f"slots end at {slots[-1].start_ms + slots[-1].length_ms:g} ms, after their frame of "
                f"{1e3 / self.frame_hz:g} ms; shorten them or lower frame_hz"
            )
        check_unique([slot.light for slot in slots], "slots")
        return self

    def schedule(self, leds: Sequence[Led]) -> tuple[Slot, ...]:
        """The slots as given, or one for each of these LEDs and a dark one."""
        if self.slots is not None:
            return self.slots
        names = [*(led.name for led in leds), DARK]
        length_ms = 1e3 / self.frame_hz / len(names)
        return tuple(Slot(light=name, start_ms=k * length_ms, length_ms=length_ms) for k, name in enumerate(names))


def two_leds(leds: Sequence[Led], slots: Sequence[Slot] | None) -> tuple[int, int]:
    """The numbers of the red and the infrared LED, distinguished by their wavelengths, among those that have slots.

    Raises: ValueError where there are not two of different wavelengths.
    """
    lit = [i for i, led in enumerate(leds) if slots is None or led.name in {slot.light for slot in slots}]
    if len(lit) != 2:
        raise ValueError(
            f"an oximeter takes two LEDs, a red and an infrared one, and {len(lit)} of the scene's {len(leds)} "
            f"{'would be lit' if slots is None else 'have slots'}; give two, such as led_660 and led_940, each a slot"
        )
    red, infrared = sorted(lit, key=lambda i: leds[i].wavelength_nm)
    apart_nm = leds[infrared].wavelength_nm - leds[red].wavelength_nm
    if apart_nm < LEAST_APART_NM:
        raise ValueError(
            f'LEDs "{leds[red].name}" and "{leds[infrared].name}" have wavelength_nm {leds[red].wavelength_nm:g} and '
            f"{leds[infrared].wavelength_nm:g}, which see the same blood; take two at least {LEAST_APART_NM:g} nm "
            "apart, such as 660 and 940"
        )
    return red, infrared
