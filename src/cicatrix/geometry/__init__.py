"""Geometry: image volumes, lattices, meshes, and the transfer of fields between them."""
