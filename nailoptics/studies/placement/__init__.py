"""Where LEDs and photodiodes should go."""
