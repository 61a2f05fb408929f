"""Equilibrium of a body."""
