"""racerl: racing policies for small cars that work on the real car.

Importing it registers `racerl/Race-v0` with Gymnasium.
"""

from racerl.registration import register

__version__ = "0.1.0"

register()
