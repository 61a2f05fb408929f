"""A signalling network without tissue."""
