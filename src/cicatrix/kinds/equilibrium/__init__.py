"""Mechanics without healing: the equilibrium of a body on a mesh that the user supplies."""
