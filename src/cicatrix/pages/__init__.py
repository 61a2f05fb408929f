"""Pages that people read: the report of a run, runs side by side, and the planning page."""
