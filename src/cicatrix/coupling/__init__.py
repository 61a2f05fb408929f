"""Coupling of mechanics and healing: the order of solves in each cycle."""
