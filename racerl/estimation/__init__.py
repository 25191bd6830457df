"""Estimating parameters from rollouts: what identification and the gap workflow both stand on."""
