"""Body before surgery and planned resection: base of the models of a section and of a whole breast."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...core.errors import InputError
from ...core.positions import down
from ...core.units import STANDARD_GRAVITY_M_S2, acceleration_mm_s2, density_kg_mm3
from ...coupling.cavity import Tissue, tissue_law
from ...geometry.borders import wall_heights
from ...geometry.chest_wall import inframammary_fold, wall_distance
from ...geometry.labels import TISSUES, Label
from ...geometry.volume import Volume
from ...image.segment import Segmentation
from ...materials.locking_skin import LockingSkin
from ...materials.material import Material
from ...materials.neo_hookean import NeoHookean, moduli_from_young
from ...mechanics.body import Body, Discretization
from ...mechanics.elements import meshed_wrinkling_strain
from ...mechanics.self_contact import SkinContact, is_available
from ...mechanics.space import AnySpace, SolidSpace, Space
from ...outcome.change import ShapeChange
from .case import LumpectomyCase, SkinTable, TissueTable
from .fascia import Wall

MAX_NIPPLE_DISTANCE_MM = 15.0  # largest distance of a given nipple from the skin of the mesh
MIN_SKIN_FLAP_MM = 3.0  # the cavity stays this far below the skin and off the chest wall


@dataclass(frozen=True, eq=False)
class Anatomy:
    """The segmented image: labels (nz, ny, nx) and tissue probabilities (4, nz, ny, nx) on one grid.

    The probabilities hold the breast and the trunk around it, the labels only the breast. ``tumour_mm`` (3,) LPS [mm] is the
    position of the tumour, if it is known from another source than the labels. ``found_body`` (nz, ny, nx) [1] and
    ``found_wall_mm`` (nz, nx) [mm] are the share of breast and trunk and the y of the chest wall, NaN where it is unknown;
    without them, they follow from the probabilities and the labels.
    """

    image: Volume | None
    labels: Volume
    probabilities: Volume
    tumour_mm: np.ndarray | None = None
    found_body: Volume | None = None
    found_wall_mm: np.ndarray | None = None

    @classmethod
    def of(cls, image: Volume | None, found: Segmentation, tumour_mm: np.ndarray | None = None) -> Anatomy:
        """Return the anatomy of a segmentation."""
        return cls(image, found.labels, found.probabilities, tumour_mm, found.body, found.wall_mm)

    @property
    def body(self) -> Volume:
        """Share of breast and trunk in each voxel (nz, ny, nx) [1]."""
        if self.found_body is not None:
            return self.found_body
        return self.probabilities.with_values(self.probabilities.values.sum(axis=0))

    @cached_property
    def has_trunk(self) -> bool:
        """Whether the body has a trunk around the breast."""
        return bool(self._in_trunk.any())

    def breast_share(self, breast: np.ndarray, body: np.ndarray) -> float:
        """Return the share of the breast in the body, from labels and shares of the body at points (...) [1]; 1 without trunk."""
        return float(body[np.isin(breast, TISSUES)].sum() / body.sum()) if self.has_trunk else 1.0

    @cached_property
    def _in_trunk(self) -> np.ndarray:
        return (self.labels.values == Label.CHEST) & (self.probabilities.values.sum(axis=0) > 0.5)

    @cached_property
    def domain(self) -> Volume:
        """Labels (nz, ny, nx) in which the trunk is fat instead of chest."""
        return self.labels.with_values(np.where(self._in_trunk, np.uint8(Label.FAT), self.labels.values))

    @cached_property
    def wall_mm(self) -> np.ndarray:
        """Position y of the chest wall (nz, nx) [mm]; NaN where it is unknown."""
        return wall_heights(self.labels) if self.found_wall_mm is None else self.found_wall_mm

    @cached_property
    def wall_distance(self) -> Volume:
        """Signed distance to the chest wall, positive in front of it (nz, ny, nx) [mm], around the body; `wall_distance`."""
        return wall_distance(self.domain, self.wall_mm)

    @cached_property
    def fold(self) -> np.ndarray:
        """Inframammary fold (2, nx) [mm]: x of each column, and z of the lower border of the breast's base, NaN where none is."""
        return inframammary_fold(self.labels)


@dataclass(frozen=True, eq=False, kw_only=True)
class BreastModel(ABC):
    """The meshed body before surgery, with its planned resection.

    Parameters
    ----------
    intact : Body
        The body as imaged.
    tissue, scar : TissueTable
        Tissue before surgery, and new tissue in the cavity.
    shares : (n_elements, n_qp, 4) array [1]
        Probability of each tissue at the quadrature points, in the order of ``TISSUES``.
    wall : Wall or None
        Chest wall on which the body slides.
    breast_share : float
        Share of the imaged body that is breast, not trunk [1].
    cavity : (n_elements,) bool array
        Elements that the resection removes.
    centre_mm : (3,) array [mm]
        Centre of the resection, LPS.
    radius_mm : float
        Radius of the resection; of a section, the radius in its plane.
    side : str
        Side of the breast, "left" or "right".
    nipple_mm : (3,) array [mm], optional
        Nipple in the image, LPS, if the case gives it.
    notes : tuple of str
        Sentences about the mesh for the manifest.
    """

    intact: Body
    tissue: Tissue
    scar: Tissue
    shares: np.ndarray
    wall: Wall | None
    breast_share: float
    cavity: np.ndarray
    centre_mm: np.ndarray
    radius_mm: float
    side: str
    nipple_mm: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    @property
    def x_imaged(self) -> np.ndarray:
        """Positions as imaged (n_nodes, 3) [mm]."""
        return self.intact.discretization.space.positions

    def gravity(self, position: str) -> np.ndarray:
        """Return the gravitational acceleration in the body's axes for a patient position (3,) [mm/s^2]."""
        return self.from_patient(np.array(down(position, self.side))) * acceleration_mm_s2(STANDARD_GRAVITY_M_S2)

    @property
    @abstractmethod
    def nipple(self) -> int:
        """Index of the skin point that represents the nipple (``nipple_among``)."""

    def nipple_among(self, skin_mm: np.ndarray) -> int:
        """Return the index of the imaged skin point nearest to the nipple, or of the foremost if none is given: (n, 3) LPS [mm].

        Raises
        ------
        InputError
            If no skin point is near the nipple.
        """
        if self.nipple_mm is None:
            return int(np.argmin(skin_mm[:, 1]))
        away = np.linalg.norm(skin_mm - self.nipple_mm, axis=1)
        if away.min() > MAX_NIPPLE_DISTANCE_MM:
            raise InputError(
                f"outcome.nipple_mm must lie on the skin of the body that is meshed; it lies {away.min():.1f} mm from it."
            )
        return int(np.argmin(away))

    @abstractmethod
    def nipple_position(self, x: np.ndarray) -> np.ndarray:
        """Return the nipple's position in a shape (n_nodes, 3) [mm], in the body's axes: (2,) in a section, (3,) in a solid."""

    @abstractmethod
    def to_patient(self, vector: np.ndarray) -> np.ndarray:
        """Convert a vector in the body's axes, (2,) of a section or (3,), to LPS components (3,)."""

    @property
    def slice_mm(self) -> float | None:
        """Position of a section along its normal, LPS [mm]; None for a solid."""
        return None

    @abstractmethod
    def from_patient(self, vectors: np.ndarray) -> np.ndarray:
        """Convert LPS components to the body's axes: (..., 3) -> (..., 3)."""

    def change(self, before: np.ndarray, after: np.ndarray) -> ShapeChange:
        """Measure the change of shape between two loaded shapes (n_nodes, 3) [mm]; of the volume, relative to the breast."""
        found = self._body_change(before, after)
        return replace(found, volume_change_percent=found.volume_change_percent / self.breast_share)

    @abstractmethod
    def _body_change(self, before: np.ndarray, after: np.ndarray) -> ShapeChange:
        """Measure the change of shape of breast and trunk between two loaded shapes (n_nodes, 3) [mm]."""

    @property
    def clipped_share(self) -> float:
        """Share of the resection's disc (section) or ball that the cavity does not have [1]."""
        removed = float(self.intact.volumes(self.x_imaged)[self.cavity].sum())
        n_axes = self.intact.discretization.space.n_axes
        return 1.0 - removed / (np.pi * self.radius_mm**2 * (1.0 if n_axes == 2 else 4.0 / 3.0 * self.radius_mm))

    @abstractmethod
    def margin_mm(self, anatomy: Anatomy) -> float:
        """Compute the smallest distance from the labelled tumour to the edge of the resection [mm]; inf without tumour."""

    @abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays from which the same model can be built again."""

    def common_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of tissue, resection and fascia, which sections and solids both store."""
        resection = {"centre_mm": self.centre_mm, "radius_mm": np.array(self.radius_mm)}
        wall = {} if self.wall is None else self.wall.arrays()
        return {"shares": self.shares, "breast_share": np.array(self.breast_share), **wall, **resection}


def resection_of(case: LumpectomyCase, anatomy: Anatomy) -> np.ndarray:
    """Return the centre of the resection (3,) LPS [mm], as the case gives it, or else the centre of the tumour.

    Raises
    ------
    InputError
        If the case gives no centre and there is no tumour.
    """
    if case.resection.centre_mm is not None:
        return np.asarray(case.resection.centre_mm, float)
    if anatomy.tumour_mm is not None:
        return anatomy.tumour_mm
    tumour = np.argwhere(anatomy.labels.values == Label.TUMOUR)
    if not len(tumour):
        raise InputError("resection.centre_mm is missing and the labels have no tumour: give the centre.")
    return anatomy.labels.position(tumour.mean(axis=0))


def check_flap(depth_mm: float) -> None:
    """Raise an InputError if the resection's centre lies less than the thickness of a skin flap below the surface [mm]."""
    if depth_mm < MIN_SKIN_FLAP_MM:
        raise InputError(
            f"resection.centre_mm must lie at least {MIN_SKIN_FLAP_MM:g} mm inside the breast; "
            f"it lies {depth_mm:.1f} mm inside."
        )


def nipple_of(case: LumpectomyCase) -> np.ndarray | None:
    """Return the nipple that the case gives (3,) LPS [mm], or None."""
    return None if case.outcome.nipple_mm is None else np.asarray(case.outcome.nipple_mm, float)


def scar_of(case: LumpectomyCase) -> Tissue:
    """Return the elastic constants and density of new tissue in the cavity."""
    new = case.tissue.scar
    mu, kappa = moduli_from_young(new.E_kPa, new.nu)
    return Tissue(mu, kappa, np.asarray(new.stiffening), density_kg_mm3(new.density_kg_m3))


def supported(
    case: LumpectomyCase, space: AnySpace, skin: np.ndarray, wall: np.ndarray, rim: np.ndarray
) -> Discretization:
    """Return the discretisation of a body with given facets on skin, chest wall and rim.

    The rim is held. On the wall the body slides, or is held too if the case says so. Without a rim, as where a breast is cut off
    flat at the chest wall, the edge between skin and wall is held in its place.
    """
    if not case.fascia.slides:
        return Discretization(space, skin, np.unique(space.facet_nodes(np.concatenate([wall, rim]))))
    held = np.unique(space.facet_nodes(rim))
    if not len(rim):
        held = np.intersect1d(space.facet_nodes(skin), space.facet_nodes(wall))
    return Discretization(space, skin, held, wall_facets=wall)


def intact_body(case: LumpectomyCase, discretization: Discretization, tissue: Tissue, wall: Wall | None) -> Body:
    """Build the body before surgery from its mesh and tissue, on its chest wall."""
    skin = case.tissue.skin
    natural = np.broadcast_to(np.eye(3), (*tissue.mu.shape, 3, 3))
    return Body(
        discretization,
        law=tissue_law(tissue, np.zeros_like(tissue.mu), natural),
        density=tissue.density,
        fraction=np.ones(discretization.space.n_elements),
        skin=skin_law(skin),
        skin_thickness=np.full(len(discretization.skin_facets), skin.thickness_mm),
        wrinkling_strain=_wrinkling_strain(case, discretization),
        skin_prestretch=skin.prestretch,
        fascia=None if wall is None else wall.fascia(case.fascia),
        contact=_skin_contact(case, discretization),
    )


def _skin_contact(case: LumpectomyCase, discretization: Discretization) -> SkinContact | None:
    """Return the contact of skin with skin; None if the case switches it off, or the library for it is not installed."""
    table = case.skin_contact
    if not table.distance_mm or not is_available():
        return None
    return SkinContact(discretization.space, discretization.skin_facets, table.distance_mm, table.stiffness_kPa)


def skin_law(skin: SkinTable) -> Material:
    """Return the law of the skin; neo-Hookean, which is cheaper, if it does not lock (``stiff_kPa`` = 0)."""
    mu, kappa = moduli_from_young(skin.E_kPa, skin.nu)
    if not skin.stiff_kPa:
        return NeoHookean(mu, kappa)
    return LockingSkin(mu, skin.stiff_kPa, skin.steepness, skin.prestretch * skin.locking_stretch, kappa=kappa)


def _wrinkling_strain(case: LumpectomyCase, discretization: Discretization) -> float:
    """Return the compressive strain at which skin on fat wrinkles, reduced where the mesh would resolve the wrinkles [1]."""
    skin, below = case.tissue.skin, case.tissue.fat.E_kPa
    corners = discretization.space.positions[discretization.skin_nodes[:, : discretization.space.n_axes]]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return meshed_wrinkling_strain(skin.E_kPa, below, skin.thickness_mm, float(edges.min(initial=np.inf)))


def quadrature_points(space: Space | SolidSpace) -> np.ndarray:
    """Return the positions of the quadrature points of a mesh (n_elements, n_qp, 3) [mm], to evaluate tissue there."""
    return np.einsum("qa,eai->eqi", space.table.value, space.positions[space.element_nodes])


def shares_at(anatomy: Anatomy, points: np.ndarray) -> np.ndarray:
    """Return the probability of each tissue at points (..., 3) LPS [mm], in the order of ``TISSUES`` (..., 4) [1]."""
    # in the order in which a checkpoint stores them: products of arrays in another order have other round-off
    shares = np.ascontiguousarray(np.moveaxis(anatomy.probabilities.sample(points), 0, -1))
    shares[..., TISSUES.index(Label.FAT)] += 1e-3  # fat where no tissue has a probability above 0
    return shares


def tissue_of(table: TissueTable, shares: np.ndarray) -> Tissue:
    """Average the constants of the tissues by their probability (..., 4) [1].

    Skin adds density only; its stiffness is that of a membrane on the surface. The bulk modulus of the others is at least
    ``table.least_bulk_modulus_kPa``.
    """
    bearing = np.where(np.array(TISSUES) == Label.SKIN, 0.0, shares)
    elastic = [_elastic(table, label) for label in TISSUES]
    mu, kappa, stiffening = _mean(bearing, np.array(elastic))
    densities = [density_kg_mm3(_of(table, label).density_kg_m3) for label in TISSUES]
    (density,) = _mean(shares, np.array(densities)[:, None])
    return Tissue(mu, kappa, stiffening, density)


def _of(table: TissueTable, label: Label):
    return getattr(table, label.name.lower())


def _elastic(table: TissueTable, label: Label) -> tuple[float, float, float]:
    """Return the shear modulus [kPa], bulk modulus [kPa] and stiffening [1] of a tissue; zeros for skin, a membrane."""
    if label == Label.SKIN:
        return 0.0, 0.0, 0.0
    tissue = _of(table, label)
    mu, kappa = moduli_from_young(tissue.E_kPa, tissue.nu)
    return mu, max(kappa, table.least_bulk_modulus_kPa), tissue.stiffening


def _mean(shares: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Average values of the tissues, weighted by shares: (..., n_tissues), (n_tissues, n) -> (n, ...)."""
    return np.moveaxis(shares @ values / shares.sum(axis=-1, keepdims=True), -1, 0)
