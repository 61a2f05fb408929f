"""Case files: their tables with checked bounds, how they are read, paths of inputs, and the laws that they name."""
