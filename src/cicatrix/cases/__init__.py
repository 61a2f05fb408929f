"""The language of case files: tables with checked bounds, reading, paths, and the laws that tables name."""
