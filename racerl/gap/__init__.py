"""The gap between simulation and measurement: where it is, which effect is missing, and whether adding it closes it."""
