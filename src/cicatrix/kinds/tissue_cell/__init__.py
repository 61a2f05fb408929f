"""Tissue that grows because its cells pull (R Eqs 27-30)."""
