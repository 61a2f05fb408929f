"""A signalling network by itself."""
