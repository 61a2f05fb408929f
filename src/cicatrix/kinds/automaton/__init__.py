"""Healing alone: the cellular automaton on a lattice."""
