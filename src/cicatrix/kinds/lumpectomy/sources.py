"""Sources of the default numbers of a case, by key; the manifest of a run lists them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ...cases.table import Table

NEARLY_INCOMPRESSIBLE = "nearly incompressible soft tissue, 0.49 to 0.499; Garbey et al., Eq. (2)"
CHOSEN = "chosen; no published value"

SOURCES: dict[str, str] = {
    "tissue.fat.E_kPa": "ex vivo 3.25 +- 0.91 kPa, nearly that of gland; in vivo fat and gland 3.0 +- 1.2 kPa",
    "tissue.fat.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.fat.density_kg_m3": "0.92 to 0.95 g/ml",
    "tissue.gland.E_kPa": "ex vivo 3.24 +- 0.61 kPa, nearly that of fat; in vivo fat and gland 3.0 +- 1.2 kPa",
    "tissue.gland.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.gland.density_kg_m3": "1.04 g/ml",
    "tissue.skin.E_kPa": "in vivo 56 +- 16 kPa",
    "tissue.skin.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.skin.density_kg_m3": "1.09 g/ml",
    "tissue.skin.thickness_mm": "1.44 +- 0.25 mm, rounded up",
    "tissue.tumour.E_kPa": "6 times gland; tumours are 3 to 13 times stiffer",
    "tissue.tumour.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.tumour.density_kg_m3": "as gland; " + CHOSEN,
    "tissue.scar.E_kPa": "fat times 29/15: tumour bed 29 kPa at 12 months against 15 kPa on the other side",
    "tissue.scar.nu": NEARLY_INCOMPRESSIBLE,
    "tissue.scar.density_kg_m3": "as gland; " + CHOSEN,
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
    """Return for every key with a source where its value comes from: the default's source, or the case itself.

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
    return {key: source if same[key] else "given by the case" for key, source in SOURCES.items()}
