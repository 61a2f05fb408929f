"""Order of solves."""
