"""Clinical outcomes: change of shape, and closure of the wound."""
