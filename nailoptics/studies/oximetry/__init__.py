"""Oxygen saturation from two LEDs: forward from the finger, and back from recordings."""
