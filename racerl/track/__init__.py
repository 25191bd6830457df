"""The track: a closed centreline with widths, its files, and the projection of cars onto it."""
