"""The race as other libraries expect it."""
