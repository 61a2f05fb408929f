"""Numerical methods without physics: linear and nonlinear solvers, time integration, small dense tensors."""
