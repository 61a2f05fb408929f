"""One file per verb, in the order of the road."""
