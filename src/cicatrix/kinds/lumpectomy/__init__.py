"""The main job: from an image and a planned resection to the healed shape."""
