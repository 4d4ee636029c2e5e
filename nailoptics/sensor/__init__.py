"""LIGHT -> VOLTS: electronics, sampling, drift and motion, ambient light, and what readings tell of force."""
