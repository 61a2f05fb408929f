"""A coarse lumpectomy in a section, from the label map of the phantom, for tests of what a run does."""

from cicatrix.files.images import write_volume
from cicatrix.image.phantom import phantom

LUMPECTOMY = """
kind = "lumpectomy"
dimension = 2
[image]
labels = "labels.nii.gz"
[healing]
pitch_um = 200.0
p_layer = 0.05
[mesh]
edge_mm = 8.0
cavity_edge_mm = 3.0
[outcome]
positions = ["upright", "supine"]
visits_weeks = [3, 40]
[coupling]
days_per_cycle = 21.0
"""


def write_labels(folder):
    """Write the label map that the case names, and return it."""
    _, labels = phantom(spacing_mm=3.0, seed=4, side="left", tumour_diameter_mm=14.0)
    write_volume(folder / "labels.nii.gz", labels)
    return labels
