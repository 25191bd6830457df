"""Attacks by the thousand; run before a release with `pytest -n0 -s -m soak`."""
