"""A coarse lumpectomy in a section, from the label map of the phantom, and stiff tissue, for tests of what a run does."""

import tomllib

from cicatrix.files.images import write_volume
from cicatrix.image.phantom import phantom
from cicatrix.kinds.lumpectomy.case import TissueTable

# tissue as measured ex vivo and by suction, neo-Hookean, in which an empty cavity stays open
STIFF_TISSUE = """
[tissue]
fat = { E_kPa = 3.25, stiffening = 0.0 }
gland = { E_kPa = 3.24, stiffening = 0.0 }
tumour = { E_kPa = 19.44, stiffening = 0.0 }
scar = { E_kPa = 6.283333333333333, stiffening = 0.0 }
skin = { E_kPa = 56.0, prestretch = 1.0, stiff_kPa = 0.0 }
ligaments = { share = 0.0 }
least_bulk_modulus_kPa = 0.0

[trunk]
medial_mm = 0.0
lateral_mm = 0.0
above_mm = 0.0
below_mm = 0.0

[fascia]
slides = false
"""

LUMPECTOMY = f"""
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
{STIFF_TISSUE}
"""


def stiff_tissue(**changed):
    """Return the table of stiff tissue with other values in some of its tables, such as ``scar={"density_kg_m3": 930.0}``."""
    table = tomllib.loads(STIFF_TISSUE)["tissue"]
    return TissueTable.model_validate(table | {name: table[name] | values for name, values in changed.items()})


def write_labels(folder):
    """Write the label map that the case names, and return it."""
    _, labels = phantom(spacing_mm=3.0, seed=4, side="left", tumour_diameter_mm=14.0)
    write_volume(folder / "labels.nii.gz", labels)
    return labels
