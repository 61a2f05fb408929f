"""Estimation of law parameters from data."""
