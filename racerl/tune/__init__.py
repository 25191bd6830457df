"""Finding a controller's numbers by driving."""
