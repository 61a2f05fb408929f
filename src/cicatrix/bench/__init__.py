"""Benchmarks: speed against measured ceilings and against other programs in the same run."""
