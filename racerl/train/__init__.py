"""Training a policy by proximal policy optimisation."""
