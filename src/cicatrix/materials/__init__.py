"""Constitutive laws: stress at a point, one law per file."""
