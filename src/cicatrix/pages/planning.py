"""Measures of a planned resection, computed from the labels only, and the case file for it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator
from scipy.ndimage import distance_transform_edt

from ..cases.bounds import NotNegative, Positive, Rule, Vector, bounds
from ..cases.table import Table
from ..core.errors import InputError
from ..files.atomic import write_bytes
from ..files.toml import toml_text
from ..geometry.labels import TISSUES, Label
from ..geometry.volume import Volume
from ..kinds.lumpectomy.body import MIN_SKIN_FLAP_MM
from ..kinds.lumpectomy.case import ModelName
from ..kinds.registry import load_case
from .cosmesis import ML

PITCH_UM = {2: 50.0, 3: 250.0}  # lattice pitch by dimension; coarser than the default, so that runs are shorter
FARTHEST_MM, LARGEST_MM = 10_000.0, 1000.0  # beyond these a coordinate, a radius or a margin is a slip of the pen
NEAR_WORDS = f"must be 3 numbers of at most {FARTHEST_MM:g} mm"
SOLID_MESH = {"edge_mm": 11.0, "cavity_edge_mm": 5.0}


class ResectionPlan(Table):
    """Resection and model settings that the page sends."""

    centre_mm: Annotated[Vector, AfterValidator(Rule(NEAR_WORDS, lambda v: max(map(abs, v)) <= FARTHEST_MM))]
    radius_mm: Annotated[Positive, bounds(most=LARGEST_MM)] = 12.0
    margin_mm: Annotated[NotNegative, bounds(most=LARGEST_MM)] = 5.0
    dimension: Literal[2, 3] = 2
    model: ModelName = "automaton"  # pyright: ignore[reportInvalidTypeForm]
    mode: Literal["one-way", "two-way"] = "two-way"

    @classmethod
    def of(cls, table: Any) -> ResectionPlan:
        """Validate the settings that a page sent.

        Raises
        ------
        InputError
            If they are not valid; the message names the first fault.
        """
        if not isinstance(table, Mapping):
            raise InputError("a plan must be a table with centre_mm")
        plan, faults = cls.checked(table, Path())
        if plan is None:
            raise InputError(faults[0])
        return plan


@dataclass(frozen=True, eq=False)
class PlanningTable:
    """Segmented breast on which resections are planned.

    Parameters
    ----------
    picture : Volume
        Grey values (nz, ny, nx) uint8.
    labels : Volume
        Tissue labels (nz, ny, nx).
    image_keys : mapping
        Keys of the ``[image]`` table for the case file; paths are absolute.
    notes : tuple of str
        Notes from reading and segmenting the image, shown on the page.
    """

    picture: Volume
    labels: Volume
    image_keys: Mapping[str, Any]
    notes: tuple[str, ...]

    @cached_property
    def breast(self) -> np.ndarray:
        """Voxels that belong to the breast (nz, ny, nx) bool."""
        return np.isin(self.labels.values, TISSUES)

    @cached_property
    def depth_mm(self) -> np.ndarray:
        """Depth of each voxel in the breast (nz, ny, nx) [mm].

        The depth is the distance between centres to the nearest voxel outside the breast, minus half a voxel.
        """
        return distance_transform_edt(self.breast, sampling=self.labels.spacing_mm[::-1]) - 0.5 * min(
            self.labels.spacing_mm
        )  # pyright: ignore[reportOperatorIssue]

    @cached_property
    def breast_mm3(self) -> float:
        """Volume of the breast [mm^3]."""
        return float(np.count_nonzero(self.breast) * np.prod(self.labels.spacing_mm))

    @cached_property
    def tumour_mm(self) -> np.ndarray:
        """Voxels of the tumour (n, 3) LPS [mm]."""
        return self.labels.position(np.argwhere(self.labels.values == Label.TUMOUR))

    @cached_property
    def surface_mm(self) -> np.ndarray:
        """Voxels of the breast at its surface (n, 3) LPS [mm]."""
        return self.labels.position(np.argwhere(self.breast & (self.depth_mm <= max(self.labels.spacing_mm))))

    def first_centre(self) -> np.ndarray:
        """Return the initial centre of the resection (3,) LPS [mm]: the tumour's centroid, or else the deepest voxel."""
        if len(self.tumour_mm):
            return self.tumour_mm.mean(axis=0)
        deepest = np.unravel_index(int(np.argmax(self.depth_mm)), self.labels.shape)
        return self.labels.position(np.asarray(deepest, float))

    def measured(self, plan: ResectionPlan) -> dict[str, Any]:
        """Return volume removed, its share of the breast, margin around the tumour, depth of the centre, and warnings.

        A voxel on the border of the ball counts by the fraction inside, to first order. Tissue within
        :data:`..kinds.lumpectomy.body.MIN_SKIN_FLAP_MM` of the surface is not removed, as in a run.
        """
        centre = np.array(plan.centre_mm)
        across = float(np.cbrt(np.prod(self.labels.spacing_mm)))
        box = self._box(centre, plan.radius_mm + across)
        inside = np.clip(0.5 + (plan.radius_mm - self._away(centre, box)) / across, 0.0, 1.0)
        taken = inside * (self.breast[box] & (self.depth_mm[box] >= MIN_SKIN_FLAP_MM))
        removed = float(taken.sum() * np.prod(self.labels.spacing_mm))
        tumour = self.tumour_mm
        margin = float(plan.radius_mm - np.linalg.norm(tumour - centre, axis=1).max()) if len(tumour) else None
        depth = self.depth_at(centre)
        return {
            "removed_ml": removed * ML,
            "breast_ml": self.breast_mm3 * ML,
            "percent": 100.0 * removed / self.breast_mm3,
            "margin_mm": margin,
            "depth_mm": depth,
            "warnings": list(self._warnings(plan, depth, margin)),
        }

    def depth_at(self, point: np.ndarray) -> float:
        """Return the depth of a point (3,) LPS [mm] in the breast [mm]; outside, minus its distance from the breast."""
        index = np.rint(self.labels.voxel(point)).astype(int)
        if ((index >= 0) & (index < self.labels.shape)).all() and self.breast[tuple(index)]:
            return float(self.labels.with_values(self.depth_mm).sample(point[None])[0])
        half = 0.5 * min(self.labels.spacing_mm)
        return half - float(np.linalg.norm(self.surface_mm - point, axis=1).min())

    def _box(self, centre: np.ndarray, reach: float) -> tuple[slice, ...]:
        """Return the block of voxels around a ball at ``centre`` (3,) LPS [mm] of radius ``reach`` [mm]: slices of z, y, x."""
        low, high = self.labels.voxel(np.stack([centre - reach, centre + reach]))
        first, last = np.floor(low).astype(int), np.ceil(high).astype(int) + 1
        return tuple(slice(max(a, 0), max(b, 0)) for a, b in zip(first, last))

    def _away(self, centre: np.ndarray, box: tuple[slice, ...]) -> np.ndarray:
        """Return the distances of a block of voxels from a point (3,) LPS [mm] (nz, ny, nx) [mm]."""
        z, y, x = (self.labels.axis(number)[box[number]] for number in range(3))
        return np.sqrt((z[:, None, None] - centre[2]) ** 2 + (y[:, None] - centre[1]) ** 2 + (x - centre[0]) ** 2)

    def _warnings(self, plan: ResectionPlan, depth: float, margin: float | None):
        if depth < 0.0:
            yield f"The centre lies outside the breast that is labelled, {-depth:.1f} mm from it; place it inside."
        elif depth < MIN_SKIN_FLAP_MM:
            yield f"The centre must lie at least {MIN_SKIN_FLAP_MM:g} mm inside the breast; it lies {depth:.1f} mm inside."
        widest = float(self.depth_mm.max())
        if plan.radius_mm > widest:
            yield f"The radius must be smaller; the largest ball inside the breast has a radius of {widest:.0f} mm."
        if margin is not None and margin < plan.margin_mm:
            yield f"The margin around the tumour is {margin:.1f} mm; {plan.margin_mm:g} mm are wanted."

    def case_text(self, plan: ResectionPlan, folder: Path) -> str:
        """Return the text of the case file, with paths relative to ``folder``."""
        image = {
            key: os.path.relpath(value, folder) if isinstance(value, Path) else value
            for key, value in self.image_keys.items()
        }
        tables = {
            "kind": "lumpectomy",
            "dimension": plan.dimension,
            "image": image,
            "resection": {
                "centre_mm": [round(c, 2) for c in plan.centre_mm],
                "radius_mm": plan.radius_mm,
                "margin_mm": plan.margin_mm,
            },
            "healing": {"model": plan.model, "pitch_um": PITCH_UM[plan.dimension]},
            "coupling": {"mode": plan.mode},
        }
        return toml_text(tables | ({"mesh": SOLID_MESH} if plan.dimension == 3 else {}))


def save_case(table: PlanningTable, plan: ResectionPlan, folder: Path) -> Path:
    """Write the case as ``plan-1.toml``, ``plan-2.toml``, ...; a file that has the same settings already is reused.

    Raises
    ------
    InputError
        If the case is not valid; no file is written then.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = table.case_text(plan, folder)
    for number in range(1, 10_000):
        path = folder / f"plan-{number}.toml"
        if not path.exists():
            break
        if path.read_text(encoding="utf-8") == text:
            return path
    with tempfile.NamedTemporaryFile("w", suffix=".toml", dir=folder, encoding="utf-8") as half:
        half.write(text)
        half.flush()
        try:
            load_case(half.name)
        except InputError as error:
            raise InputError(str(error).removeprefix(f"{half.name}: ")) from None
    write_bytes(path, text.encode())
    return path
