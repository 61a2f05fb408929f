"""What the surgeon asks."""
