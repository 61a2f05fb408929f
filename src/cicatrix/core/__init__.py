"""Numbers with meaning and no physics."""
