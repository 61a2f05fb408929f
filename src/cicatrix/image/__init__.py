"""Voxels to labels."""
