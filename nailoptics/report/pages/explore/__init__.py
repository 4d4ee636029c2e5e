"""The page to drag LEDs and photodiodes on: markup, styles and scripts, and what Python puts into it."""
