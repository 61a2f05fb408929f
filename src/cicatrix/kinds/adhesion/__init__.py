"""A cell that adheres to a substrate (R Eqs 20-26)."""
