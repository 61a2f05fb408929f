"""Lumpectomy: from an image and a planned resection to the healed shape of the breast."""
