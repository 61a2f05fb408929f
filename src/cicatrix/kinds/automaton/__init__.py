"""Wound healing without mechanics: the cellular automaton on a lattice."""
