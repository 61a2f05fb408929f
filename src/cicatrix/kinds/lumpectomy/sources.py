"""Sources of the default numbers of a case, by key; the manifest of a run lists them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ...cases.table import Table
from .priors import PRIORS

NEARLY_INCOMPRESSIBLE = "nearly incompressible soft tissue, 0.49 to 0.499; Garbey et al., Eq. (2)"
CHOSEN = "chosen; no published value"
IN_VIVO = "Ex vivo 3.25 +- 0.91 kPa and by suction 3.0 +- 1.2 kPa, too stiff for the weight of the breast"
AS_FAT = "as fat; " + CHOSEN

SOURCES: dict[str, str] = {
    "tissue.fat.E_kPa": "0.2 to 0.3 kPa move a breast from prone to supine as in images; Mira et al. (2018), one woman. "
    + IN_VIVO,
    "tissue.fat.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.fat.stiffening": "prone tissue this soft must stiffen to be stable; spread assumed. Law: Demiray (1972)",
    "tissue.fat.density_kg_m3": "0.92 to 0.95 g/ml",
    "tissue.gland.E_kPa": "1.2 times fat; ex vivo and by suction the two hardly differ, by images up to several times",
    "tissue.gland.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.gland.stiffening": AS_FAT,
    "tissue.gland.density_kg_m3": "1.04 g/ml",
    "tissue.skin.E_kPa": "4 kPa, from images in three positions; Mira et al. (2018), one woman. By suction 56 +- 16 kPa",
    "tissue.skin.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.skin.density_kg_m3": "1.09 g/ml",
    "tissue.skin.thickness_mm": "1.44 +- 0.25 mm, rounded up; 1.55 +- 0.25 mm, Sutradhar & Miller (2013)",
    "tissue.skin.prestretch": "skin retracts when it is cut; 1.10 on the breast is " + CHOSEN,
    "tissue.skin.locking_stretch": "breast skin stretches by up to 1.25 to 1.60 from supine to upright; Khatam et al. (2015)",
    "tissue.skin.stiff_kPa": "times steepness 344 kPa, as breast skin by suction in 23 women; Sutradhar & Miller (2013)",
    "tissue.skin.steepness": "ln(83.3 / 1.18) / 0.54: slopes, strain at failure, skin of the back; Ni Annaidh et al. (2012)",
    "tissue.tumour.E_kPa": "6 times gland; tumours are 3 to 13 times stiffer",
    "tissue.tumour.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.tumour.stiffening": AS_FAT,
    "tissue.tumour.density_kg_m3": "as gland; " + CHOSEN,
    "tissue.scar.E_kPa": "fat times 29/15: tumour bed 29 kPa at 12 months against 15 kPa on the other side",
    "tissue.scar.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.scar.stiffening": "as fat, so that the ratio of their stiffness, which is what is measured, holds at every stretch",
    "tissue.scar.density_kg_m3": "as gland; " + CHOSEN,
    "tissue.ligaments.share": "up to 2 % of the breast; assumed",
    "tissue.ligaments.stiffness_kPa": "120 kPa / 3, fascia of one woman from images; Mira et al. (2018). See Briot et al. (2022)",
    "tissue.ligaments.slack_stretch": "slack up to 1.05 to 1.4; assumed",
    "tissue.least_bulk_modulus_kPa": "tissue is mostly water; nu alone would let soft tissue change its volume by a fifth; "
    + CHOSEN,
    "trunk.medial_mm": "the sternum holds the skin at the midline; with 40 mm the breast rolls onto its rim; " + CHOSEN,
    "trunk.lateral_mm": "lying on the back the breast spreads to the side; " + CHOSEN,
    "trunk.above_mm": CHOSEN,
    "trunk.below_mm": CHOSEN,
    "fascia.stiffness_kPa_per_mm": "tissue 12 mm off the ribs moves by 61 mm from prone to supine in women; order of magnitude",
    "fascia.fold_factor": "the fold hardly moves with the breast; " + CHOSEN,
    "healing.deposition": "stress-free in the unloaded reference; Garbey et al.",
    "healing.deposition_prestretch": "1: deposited without stretch; " + CHOSEN,
    "healing.contraction_kPa": "0: no contraction; Garbey et al.",
    "healing.pitch_um": "one cell, 10 um; Garbey et al., section 3",
    "healing.hours_per_step": "cell cycle of 10 to 20 h; Garbey et al., section 3",
    "healing.p_edge": "with p_layer and layer_um calibrated to clinical cavity volumes: papers/clinic-closure",
    "healing.p_layer": "calibrated: 0.080 mm/day, clinical cavity volumes give 0.079 +- 0.004; papers/clinic-closure",
    "healing.layer_um": "reach of the growth factor, sqrt(D_c / d_c) = 1.1 to 1.6 mm; docs/decisions/0005",
    "healing.contact_inhibition": CHOSEN,
    "healing.motility_substeps": "4 to 8 keep the wound near-circular; " + CHOSEN,
    "healing.redistribution": "pushing along paths keeps division local; the global level set is the paper's variant",
    "healing.feedback": "p_layer (1 + W / W_ref), Garbey et al., section 3; W_ref the mean over the fresh wound edge",
    "healing.mechanosensing": "continuum model: elastic change of volume; docs/theory/wound.md",
    "healing.parameters": "continuum model: values of papers/breast-cavity with this fat and scar; docs/decisions/0023",
    "healing.time_tolerance": "a tenth of a percent of healthy densities in a step; " + CHOSEN,
    "coupling.days_per_cycle": "one mechanical solve a week; " + CHOSEN,
    "outcome.visits_weeks": "clinical visits at weeks 2, 6, 10 and 26",
}


def value_at(case: Table, key: str) -> Any:
    """Return the value of a dotted key, such as ``tissue.fat.nu``."""
    value: Any = case
    for name in key.split("."):
        value = getattr(value, name)
    return value


def keys(table: Table, prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys of all values in a table and its subtables, in order; a table with a source of its own is one key."""
    for name in type(table).model_fields:
        value = getattr(table, name)
        if isinstance(value, Table) and prefix + name not in SOURCES:
            yield from keys(value, f"{prefix}{name}.")
        else:
            yield prefix + name


def sources_of(case: Table, default: Table) -> dict[str, str]:
    """Return for every key with a source where its value comes from: the default's source and its prior, or the case itself.

    Parameters
    ----------
    case, default : LumpectomyCase
        The case as run, and one with every default.

    Returns
    -------
    dict of str to str
        Source by dotted key, in the order of :data:`SOURCES`.
    """
    same = {key: value_at(case, key) == value_at(default, key) for key in SOURCES}
    said = {key: f"{source}; prior: {PRIORS[key]}" if key in PRIORS else source for key, source in SOURCES.items()}
    return {key: source if same[key] else "given by the case" for key, source in said.items()}
