"""Rates at a point: what cells do, one law per file."""
