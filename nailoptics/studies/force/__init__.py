"""Force from volts: calibrate a person's sensor with a known force, then tell the force from its readings."""
