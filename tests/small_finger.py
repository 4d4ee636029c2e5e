"""A finger with one LED and one photodiode, as little as a scene can be, for tests to add tables to."""

SMALL_FINGER = """
schema_version = 1
[finger]
[[leds]]
name = "ir"
part = "led_800"
position_mm = [-1.2, 0.0]
[[photodiodes]]
name = "pd"
position_mm = [0.5, 0.0]
"""
SMALL_FINGER_BEST = SMALL_FINGER + '[blood]\nparameters = "best"\n'
