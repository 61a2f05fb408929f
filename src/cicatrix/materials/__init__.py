"""Stress at a point, one law per file."""
