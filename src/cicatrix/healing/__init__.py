"""Wound closure."""
