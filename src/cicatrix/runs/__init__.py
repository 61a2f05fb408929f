"""The folder of a run, and the one driver that fills it."""
