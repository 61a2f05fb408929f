"""A wound healed by the continuum model, in a sheet or in a solid."""
