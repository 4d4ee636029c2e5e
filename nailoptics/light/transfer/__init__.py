"""Traced light that can be read in any state of the blood: records, their sums, interpolation between states."""

from .transfer import ReweightWarning, Transfer, current_versions, mean_of_leds, photodiode_names, provenance
