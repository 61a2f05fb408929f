"""Finite-element equilibrium of a body, its unloaded shape, contact with plates, and a single material point."""
