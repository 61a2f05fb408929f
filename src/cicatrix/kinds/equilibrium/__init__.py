"""Mechanics alone: the equilibrium of a body on a mesh of the user's."""
