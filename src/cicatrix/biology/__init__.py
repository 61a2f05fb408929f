"""Rate laws of cells at a point, one law per file."""
