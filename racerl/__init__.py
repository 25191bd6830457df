"""racerl: racing policies for small cars that work on the real car."""

__version__ = "0.1.0"
