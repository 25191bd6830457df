"""Identification: a car's parameters from measured driving, by gradients through long rollouts."""
