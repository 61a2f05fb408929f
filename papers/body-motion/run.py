"""Move breasts from prone to supine and upright over the priors of a body: prints claim | measured | holds (see README.md).

`python run.py` reads the draws that were computed (draws.csv) and computes those that are missing, each geometry in turn.
"""

from __future__ import annotations

import csv
import json
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from cicatrix.core.errors import ConvergenceError
from cicatrix.geometry.labels import TISSUES, Label
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.lumpectomy.build import equilibrium_of
from cicatrix.kinds.lumpectomy.case import LumpectomyCase
from cicatrix.kinds.lumpectomy.priors import draws
from cicatrix.kinds.lumpectomy.solid import SolidModel, intact_solid, solid_from_arrays
from cicatrix.kinds.registry import case_from
from cicatrix.mechanics.elements import principal_strains
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
SEED, N_DRAWS = 1, 6
TOLERANCE = 1e-5  # residual over weight
NEAR_RIBS_MM = 12.0
PHANTOMS_MM = [
    *((92, 60, 86), (104, 70, 98), (100, 95, 95), (120, 75, 110)),
    *((112, 110, 104), (130, 95, 120), (124, 130, 116), (140, 110, 130)),
]  # width, depth and height: 250 to 1050 ml
PATIENTS: dict[str, dict[str, Any]] = {
    "A13": {"path": "data:mimbcd_A13_t1tse.nii.gz"},
    "A25": {"path": "data:mimbcd_A25_t1fs.nii.gz", "weighting": "t1-fatsat"},
    "d9e7d915": {"path": "data:mimbcd_full_d9e7d915.nii.gz", "weighting": "t1-fatsat"},
    "breast CT": {"labels": "data:sarno_breastct3_labels_0273.nrrd", "axes": "RIA"},
}
NIPPLES_MM = {"A13": [72.0, -21.0, -6.0]}  # others: the foremost point of the skin
# what 63 women showed (landmarks of prone and supine MRI, public aggregates): mean, standard deviation [mm]
NIPPLE = {"whole": (103.0, 34.0), "posterior": (87.0, 28.0), "lateral": (50.0, 21.0), "caudal": (19.0, 13.0)}
PER_DEPTH, PER_DEPTH_SD = (0.78, -14.4), 13.0  # posterior motion of the nipple = 0.78 depth - 14.4 mm, residual
LANDMARK, NEAR_RIBS = (72.6, 29.3), 61.0
RIB_RATIO = (0.57, 0.33, 1.19)  # median, least and largest
STRETCH = (1.25, 1.60)  # skin from supine to upright (for validation; nothing is fitted to it)

Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Motion:
    """One draw of a geometry: its shapes (n_nodes, 3) [mm], as far as they were found."""

    model: SolidModel
    prone: np.ndarray
    supine: np.ndarray
    upright: np.ndarray

    def numbers(self) -> Row:
        """Return what is compared with images of women, in mm where nothing else is said."""
        nipple, wall = self.model.nipple, self.model.wall
        assert wall is not None
        moved = self.supine[nipple] - self.prone[nipple]
        landmarks = self._landmarks()
        prone, supine = (np.einsum("qa,eai->eqi", self._table.value, y[self._nodes])[landmarks] for y in self._two)
        ribs = [np.asarray(wall.distance.at(points)) for points in (prone, supine)]
        skin = [cKDTree(y[self.model.intact.discretization.skin_nodes.ravel()]).query(p)[0] for y, p in self._pairs(prone, supine)]
        near, path = ribs[0] < NEAR_RIBS_MM, np.linalg.norm(supine - prone, axis=1)
        return {
            "depth": float(wall.distance.at(self.prone[nipple])),
            "depth_supine": float(wall.distance.at(self.supine[nipple])),
            "nipple": float(np.linalg.norm(moved)),
            "posterior": float(moved[1]),
            "lateral": float(moved[0]),
            "caudal": float(-moved[2]),
            "landmark": float(path.mean()),
            "near_ribs": float(path[near].mean()) if near.any() else np.nan,
            "ribs_prone": float(ribs[0].mean()),
            "ribs_supine": float(ribs[1].mean()),
            "ribs_ratio": float(np.median(ribs[1] / ribs[0])),
            "skin_prone": float(skin[0].mean()),
            "skin_supine": float(skin[1].mean()),
            "stretch": self._stretch(),
        }

    @property
    def _two(self) -> tuple[np.ndarray, np.ndarray]:
        return self.prone, self.supine

    def _pairs(self, prone: np.ndarray, supine: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        yield from zip(self._two, (prone, supine), strict=True)

    @property
    def _nodes(self) -> np.ndarray:
        return self.model.space.element_nodes

    @property
    def _table(self):
        return self.model.space.table

    def _landmarks(self) -> np.ndarray:
        """Return which quadrature points are gland, where inner landmarks are found in images (n_elements, n_qp) bool."""
        shares = self.model.shares
        return shares[..., TISSUES.index(Label.GLAND)] > 0.5 * shares.sum(axis=-1)

    def _stretch(self) -> float:
        """Return the stretch of skin from supine to upright that 5 % of the skin of the breast exceed [1]."""
        nodes = self.model.intact.discretization.skin_nodes
        table = self.model.space.facet_table
        maps = [np.einsum("eai,qab->eqib", y[nodes], table.gradient) for y in (self.supine, self.upright)]
        area, (larger, _) = principal_strains(*maps)
        size = table.weight * np.asarray(area)
        front = np.asarray(self.model.wall.distance.at(self.prone[nodes].mean(axis=1))) > 25.0  # the breast, not the trunk
        stretch, weight = np.exp(np.asarray(larger))[front].ravel(), size[front].ravel()
        order = np.argsort(stretch)
        return float(stretch[order][np.searchsorted(np.cumsum(weight[order]), 0.95 * weight.sum())])


def cases(edge_mm: float) -> dict[str, LumpectomyCase]:
    """Return the case of each geometry, with all defaults but the mesh and the solver's tolerance."""
    images = {f"phantom {w}x{d}x{h}": {"phantom": "half-ellipsoid", "voxel_mm": 2.0, "phantom_size_mm": [w, d, h]} for w, d, h in PHANTOMS_MM}
    common = {
        "kind": "lumpectomy",
        "dimension": 3,
        "mesh": {"edge_mm": edge_mm, "cavity_edge_mm": edge_mm},
        "solver": {"relative_tolerance": TOLERANCE},
        "healing": {"pitch_um": 1000.0},
    }
    all_images = images | PATIENTS
    outcome = {name: {"nipple_mm": NIPPLES_MM[name]} if name in NIPPLES_MM else {} for name in all_images}
    return {name: case_from(common | {"image": image, "outcome": outcome[name]}, HERE) for name, image in all_images.items()}


def with_draw(case: LumpectomyCase, drawn: Mapping[str, float]) -> LumpectomyCase:
    """Return a case with the values of a draw, by dotted key."""
    tables = case.model_dump(exclude_unset=True)
    for key, value in drawn.items():
        *path, name = key.split(".")
        table = tables
        for part in path:
            table = table.setdefault(part, {})
        table[name] = float(value)
    return case_from(tables, HERE)


def move(case: LumpectomyCase, arrays: Mapping[str, np.ndarray], solver: Equilibrium, starts: list | None) -> tuple[Row, list | None]:
    """Compute one draw; return its numbers, or why there are none, and its shapes to start the next draw from."""
    began = time.process_time()
    model = solid_from_arrays(case, arrays)
    X0, supine0, upright0 = starts or (None, None, None)
    try:
        X, report = solver.unloaded(model.intact, model.x_imaged, model.gravity("prone"), X0)
        supine, _ = solver.loaded(model.intact, X, model.gravity("supine"), supine0)
        upright, _ = solver.loaded(model.intact, X, model.gravity("upright"), upright0)
    except ConvergenceError as error:
        return {"comes_through": 0, "why": str(error)[:200], "seconds": time.process_time() - began}, starts
    numbers = Motion(model, model.x_imaged, supine, upright).numbers()
    return {
        "comes_through": 1,
        "stable": int(report.is_stable),
        "tetrahedra": model.space.n_elements,
        **numbers,
        "seconds": time.process_time() - began,
    }, [X, supine, upright]


def compute(edge_mm: float, n_draws: int, geometries: list[str] | None = None, known: list[Row] = ()) -> Iterator[Row]:
    """Yield the rows of all draws that are not known yet; draw -1 is the median of all priors, the defaults."""
    drawn = draws(n_draws, SEED)
    have = {(row["geometry"], int(row["draw"])) for row in known}
    for name, case in cases(edge_mm).items():
        wanted = [k for k in range(-1, n_draws) if (name, k) not in have]
        if not wanted or (geometries is not None and name not in geometries):
            continue
        anatomy, _ = anatomy_of(case)
        arrays = intact_solid(case, anatomy).arrays()
        solver, starts = equilibrium_of(case), None
        for k in wanted:
            now = case if k < 0 else with_draw(case, {key: values[k] for key, values in drawn.items()})
            row, starts = move(now, arrays, solver, starts)
            yield {"geometry": name, "draw": k, **row}
