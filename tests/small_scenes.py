"""Fingers and boards as small as a scene can be, for tests to add tables to."""

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

# A board of its own size, whose LED lies behind the barrier, without a search.
PLACEMENT = """
schema_version = 1
[finger]
[blood]
parameters = "best"
[board]
size_mm = [9.0, 9.0]
[[leds]]
name = "ir"
part = "led_800"
position_mm = [-3.0, 0.0]
[[photodiodes]]
name = "pd"
position_mm = [1.0, 0.0]
size_mm = [1.0, 0.25]
[placement]
search = false
photodiodes = 4
"""
# Two given layouts on one board: photodiodes near the LED, and far from it.
TWO_LAYOUTS = (
    PLACEMENT
    + """
[[placement.candidates]]
name = "near"
leds_mm = [[-3.0, 0.0]]
photodiodes_mm = [[-1.0, -2.0], [-1.0, -1.0], [-1.0, 1.0], [-1.0, 2.0]]
[[placement.candidates]]
name = "far"
leds_mm = [[-3.0, 0.0]]
photodiodes_mm = [[3.0, -2.0], [3.0, -1.0], [3.0, 1.0], [3.0, 2.0]]
"""
)
