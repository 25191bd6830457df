"""Driving by hand: a person, or a script in their place, at the wheel of the simulated car."""
