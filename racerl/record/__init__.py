"""The record stage: a simulated car is driven and measured, and what its sensors say becomes a drive log."""
