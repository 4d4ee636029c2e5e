"""LIGHT -> VOLTS: electronics, sampling, drift and motion, ambient light, and the information of readings on force."""
