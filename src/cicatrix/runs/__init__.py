"""The folder of a run, and the driver that runs every kind of case and writes the folder."""
