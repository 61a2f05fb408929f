"""One run: case, build, results."""
