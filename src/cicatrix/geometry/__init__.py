"""Where: volumes, lattices, meshes and the transfer between them."""
