"""racerl: racing policies for small cars, from the logs of your own car.

Imported after Gymnasium it registers `racerl/Race-v0` there; otherwise `racerl.register()` does, so that a command line
that needs no environment does not wait for one.
"""

import sys

from racerl.registration import register as register

__version__ = "0.1.0"

if "gymnasium" in sys.modules:
    register()
