"""The race as other libraries expect it; whoever imports one of them can make `racerl/Race-v0`."""

from racerl.registration import register

register()
