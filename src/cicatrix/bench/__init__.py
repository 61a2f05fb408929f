"""Benchmarks: speed of cicatrix compared with that of other programs and with hardware limits measured in the same run."""
