"""Tools without physics that all packages use: errors, units, law parameters, random numbers, MPI ranks, compiled kernels."""
