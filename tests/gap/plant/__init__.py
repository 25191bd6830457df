"""A car and its flaws, coded apart from racerl, that drives the logs of the blind test of `racerl gap`.

Nothing here imports racerl. `python -m tests.gap.plant OUT --set single` writes OUT/logs/*.parquet and OUT/keys.json.

Axes: x ahead, y to the left, yaw anticlockwise. Units: m, s, rad, N, kg. Arrays hold one car per entry of the last
axis, (B,); wheels, (W, B), are ordered from front to rear and from left to right.
"""
