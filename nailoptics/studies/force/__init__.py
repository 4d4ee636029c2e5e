"""Force from volts: calibrate a person's sensor with a known force, then estimate the force from its readings."""
