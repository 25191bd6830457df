"""The time-optimal lap of a car on a track: the floor under every lap time."""
