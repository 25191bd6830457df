"""The report's figures, one file each; every one takes subjects and returns an SVG."""
