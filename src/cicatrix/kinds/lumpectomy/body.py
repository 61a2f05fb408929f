"""The body before surgery and what will be removed: what a section and a solid have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...core.units import STANDARD_GRAVITY_M_S2, acceleration_mm_s2, density_kg_mm3
from ...coupling.cycle import Tissue, tissue_law
from ...geometry.labels import TISSUES, Label
from ...geometry.volume import Volume
from ...materials.neo_hookean import NeoHookean, moduli_from_young
from ...mechanics.body import Body, Frame
from ...mechanics.elements import meshed_wrinkling_strain, wrinkling_strain
from ...mechanics.space import SolidSpace, Space
from ...outcome.change import ShapeChange
from .case import LumpectomyCase
from .case import Tissue as TissueTable

# which way is down, as LPS components, for each position of the patient
DOWN = {"upright": (0.0, 0.0, -1.0), "prone": (0.0, -1.0, 0.0), "supine": (0.0, 1.0, 0.0)}
FARTHEST_NIPPLE_MM = 15.0  # from the skin of the mesh, or of the section
LEAST_SKIN_FLAP_MM = 3.0  # the cavity stays this far below the skin and off the chest wall


@dataclass(frozen=True, eq=False)
class Anatomy:
    """The segmented image: labels (nz, ny, nx) and tissue probabilities (4, nz, ny, nx) on one grid.

    ``tumour_mm`` (3,) LPS [mm] is where the tumour is known to be, if it is known otherwise than by its label.
    """

    image: Volume | None
    labels: Volume
    probabilities: Volume
    tumour_mm: np.ndarray | None = None

    @property
    def breast(self) -> Volume:
        """Share of breast in each voxel (nz, ny, nx) [1]."""
        return self.probabilities.with_values(self.probabilities.values.sum(axis=0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan(ABC):
    """The meshed body, before anything is removed.

    Parameters
    ----------
    intact : Body
        As imaged.
    tissue, scar : Tissue
        What is there before surgery, and what grows in the cavity.
    cavity : (n_elements,) bool array
        Elements that the resection takes out.
    centre_mm : (3,) array [mm]
        Centre of the resection, LPS.
    radius_mm : float
        Its radius (in the section).
    nipple_mm : (3,) array [mm], optional
        Where the nipple is in the image, LPS, if the case says so.
    notes : tuple of str
        What there is to tell about the mesh.
    """

    intact: Body
    tissue: Tissue
    scar: Tissue
    cavity: np.ndarray
    centre_mm: np.ndarray
    radius_mm: float
    nipple_mm: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    @property
    def x_imaged(self) -> np.ndarray:
        """Positions as imaged (n_nodes, 3) [mm]."""
        return self.intact.frame.space.positions

    def gravity(self, position: str) -> np.ndarray:
        """Gravity in the body's axes (3,) [mm/s^2]."""
        return self.from_patient(np.array(DOWN[position])) * acceleration_mm_s2(STANDARD_GRAVITY_M_S2)

    @property
    @abstractmethod
    def nipple(self) -> int:
        """Number of the skin's point that is taken for the nipple (``nipple_among``)."""

    def nipple_among(self, skin_mm: np.ndarray) -> int:
        """Row of the skin's points (n, 3) LPS [mm], as imaged, that is nearest to the nipple; the foremost if it is not given.

        Raises
        ------
        InputError
            If none is near.
        """
        if self.nipple_mm is None:
            return int(np.argmin(skin_mm[:, 1]))
        away = np.linalg.norm(skin_mm - self.nipple_mm, axis=1)
        if away.min() > FARTHEST_NIPPLE_MM:
            raise InputError(
                f"outcome.nipple_mm must lie on the skin of the body that is meshed; it lies {away.min():.1f} mm from it."
            )
        return int(np.argmin(away))

    @property
    def slice_mm(self) -> float | None:
        """Where a section lies along its normal, LPS [mm]; a solid has none."""
        return None

    @abstractmethod
    def from_patient(self, vectors: np.ndarray) -> np.ndarray:
        """LPS components in the body's axes: (..., 3) -> (..., 3)."""

    @abstractmethod
    def change(self, before: np.ndarray, after: np.ndarray) -> ShapeChange:
        """Compare loaded shapes (n_nodes, 3) [mm]."""

    @abstractmethod
    def margin_mm(self, anatomy: Anatomy) -> float:
        """Least distance from the labelled tumour to the edge of the resection [mm]; inf without tumour."""

    @abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """What is needed to make the same plan again."""

    def tissue_arrays(self) -> dict[str, np.ndarray]:
        """The part of ``arrays`` that all plans have."""
        tissue = self.tissue
        return {
            "mu": tissue.mu,
            "kappa": tissue.kappa,
            "density": tissue.density,
            "centre_mm": self.centre_mm,
            "radius_mm": np.array(self.radius_mm),
        }


def resection_of(case: LumpectomyCase, anatomy: Anatomy) -> np.ndarray:
    """Centre of the resection (3,) LPS [mm]: as the case says, else the tumour's.

    Raises
    ------
    InputError
        If there is neither.
    """
    if case.resection.centre_mm is not None:
        return np.asarray(case.resection.centre_mm, float)
    if anatomy.tumour_mm is not None:
        return anatomy.tumour_mm
    tumour = np.argwhere(anatomy.labels.values == Label.TUMOUR)
    if not len(tumour):
        raise InputError("resection.centre_mm is missing and the labels hold no tumour: give the centre.")
    return anatomy.labels.position(tumour.mean(axis=0))


def check_flap(depth_mm: float) -> None:
    """Refuse a resection that is centred too near to the surface: depth of its centre [mm]."""
    if depth_mm < LEAST_SKIN_FLAP_MM:
        raise InputError(
            f"resection.centre_mm must lie at least {LEAST_SKIN_FLAP_MM:g} mm inside the breast; "
            f"it lies {depth_mm:.1f} mm inside."
        )


def nipple_of(case: LumpectomyCase) -> np.ndarray | None:
    """Where the case says that the nipple is (3,) LPS [mm]."""
    return None if case.outcome.nipple_mm is None else np.asarray(case.outcome.nipple_mm, float)


def scar_of(case: LumpectomyCase) -> Tissue:
    """What grows in the cavity."""
    new = case.tissue.scar
    return Tissue(*moduli_from_young(new.E_kPa, new.nu), density_kg_mm3(new.density_kg_m3))


def intact_body(case: LumpectomyCase, frame: Frame, tissue: Tissue) -> Body:
    """Join mesh and tissue."""
    skin = case.tissue.skin
    natural = np.broadcast_to(np.eye(3), (*tissue.mu.shape, 3, 3))
    return Body(
        frame,
        law=tissue_law(NeoHookean(tissue.mu, tissue.kappa), np.zeros_like(tissue.mu), natural),
        density=tissue.density,
        fraction=np.ones(frame.space.n_elements),
        skin=NeoHookean(*moduli_from_young(skin.E_kPa, skin.nu)),
        skin_thickness=np.full(len(frame.skin_facets), skin.thickness_mm),
        wrinkling_strain=_wrinkling_strain(case, frame),
    )


def _wrinkling_strain(case: LumpectomyCase, frame: Frame) -> float:
    """Of skin on fat, as far as the mesh bears it [1]."""
    skin, below = case.tissue.skin, case.tissue.fat.E_kPa
    if isinstance(frame.space, Space):
        return wrinkling_strain(skin.E_kPa, below)
    corners = frame.space.positions[frame.skin_nodes[:, :3]]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return meshed_wrinkling_strain(skin.E_kPa, below, skin.thickness_mm, float(edges.min(initial=np.inf)))


def quadrature_points(space: Space | SolidSpace) -> np.ndarray:
    """Where the tissue is looked up (n_elements, n_qp, 3) [mm]."""
    return np.einsum("qa,eai->eqi", space.table.value, space.positions[space.element_nodes])


def tissue_at(table: TissueTable, anatomy: Anatomy, points: np.ndarray) -> Tissue:
    """Mix constants by probability at points (..., 3) LPS [mm]; skin weighs there, but bears load as a membrane."""
    shares = np.moveaxis(anatomy.probabilities.sample(points), 0, -1)
    shares[..., TISSUES.index(Label.FAT)] += 1e-3  # where there is nothing at all
    bearing = np.where(np.array(TISSUES) == Label.SKIN, 0.0, shares)
    parts = [getattr(table, label.name.lower()) for label in TISSUES]
    mu, kappa = _mean(bearing, np.array([moduli_from_young(p.E_kPa, p.nu) for p in parts]))
    (density,) = _mean(shares, np.array([[density_kg_mm3(p.density_kg_m3)] for p in parts]))
    return Tissue(mu, kappa, density)


def _mean(shares: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Mean of some values of each tissue, by shares: (..., n_tissues), (n_tissues, n) -> (n, ...)."""
    return np.moveaxis(shares @ values / shares.sum(axis=-1, keepdims=True), -1, 0)
