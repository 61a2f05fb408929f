"""Models of wound healing: the cellular automaton and the continuum model."""
