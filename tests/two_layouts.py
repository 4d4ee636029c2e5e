"""A placement scene with two given layouts on one board: photodiodes near the LED, and far from it."""

SCENE = """
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
[[placement.candidates]]
name = "near"
leds_mm = [[-3.0, 0.0]]
photodiodes_mm = [[-1.0, -2.0], [-1.0, -1.0], [-1.0, 1.0], [-1.0, 2.0]]
[[placement.candidates]]
name = "far"
leds_mm = [[-3.0, 0.0]]
photodiodes_mm = [[3.0, -2.0], [3.0, -1.0], [3.0, 1.0], [3.0, 2.0]]
"""
