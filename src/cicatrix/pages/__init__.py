"""Web pages: the report of a run, the comparison of several runs, and the planning page."""
