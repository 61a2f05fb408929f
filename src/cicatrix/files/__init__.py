"""File formats in and out: images, meshes, tables, networks, figures."""
