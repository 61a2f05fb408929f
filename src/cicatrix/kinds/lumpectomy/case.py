"""Tables of a case of kind "lumpectomy", frozen and checked; the names of their fields are the keys of the case file.

A case is plain data. It holds no arrays and no callables, so two cases are equal when their files say the same.
Lengths are in mm, stiffness in kPa, where a key's name does not say otherwise. The sources of default values
are in :mod:`cicatrix.kinds.lumpectomy.sources`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, StrictBool, model_validator

from ...cases.bounds import (
    Ascending,
    Integer,
    NotNegative,
    Number,
    PoissonRatio,
    Positive,
    Probability,
    Rule,
    Vector,
    bounds,
    fault,
)
from ...cases.continuum import AnySensing, LogisticTable, ParametersTable, TimeTolerance, check_continuum
from ...cases.table import Case, Table
from ...core.errors import InputError
from ...core.positions import POSITIONS
from ...core.units import days_from_hours
from ...geometry.volume import AXES
from ...healing.rates import (
    HOURS_PER_STEP,
    LAYER_UM,
    MOTILITY_SUBSTEPS,
    P_EDGE,
    P_LAYER,
    hours_per_step_at_pitch,
    rules_at_pitch,
)
from ...healing.rules import AutomatonRules
from ...image.phantom import LARGEST_SIZE_MM, LEAST_SIZE_MM, SIZE_MM
from .sites import box_around, too_many
from .sources import sources_of

Position: Any = Literal[tuple(POSITIONS)]
Tissue = Literal["air", "fat", "gland", "skin", "tumour", "chest"]
# keys of `healing` that belong to one model alone, by the name of the model
MODEL_KEYS: dict[str, tuple[str, ...]] = {
    "automaton": (
        *("contraction_kPa", "hours_per_step", "p_edge", "p_layer", "layer_um", "contact_inhibition"),
        *("motility_substeps", "redistribution", "feedback"),
    ),
    "fields": ("mechanosensing", "parameters", "time_tolerance"),
}
MODEL_WORDS = {"automaton": "cellular automaton", "fields": "continuum: cells, cytokine and collagen"}  # for a menu
ModelName: Any = Literal[tuple(MODEL_KEYS)]
SOLID_EDGES_MM = {"edge_mm": 5.0, "cavity_edge_mm": 2.0}  # defaults of a mesh in three dimensions


PhantomSize = Annotated[
    tuple[Annotated[Number, bounds(least=LEAST_SIZE_MM, most=LARGEST_SIZE_MM)], ...],
    AfterValidator(Rule("must be a list of 3 numbers", lambda sizes: len(sizes) == 3)),
]


class ChestWallTable(Table):
    """Chest wall behind the breast, if it is not to be found automatically.

    Either a plane by ``point_mm`` and ``normal``, or a surface through ``points_mm``; image coordinates (LPS).
    """

    point_mm: Vector | None = None  # a point of the plane
    normal: Vector | None = None  # normal of the plane, from the chest wall to the nipple, of any length
    points_mm: tuple[Vector, ...] | None = None  # at least four points of the surface

    @model_validator(mode="after")
    def _plane_or_points(self) -> ChestWallTable:
        plane = self.point_mm is not None or self.normal is not None
        if plane == (self.points_mm is not None):
            raise fault("points_mm", "must be given without point_mm and normal, or those two without it")
        if plane and (self.point_mm is None or self.normal is None):
            raise fault("normal", "and point_mm belong together: a plane needs both")
        if self.normal is not None and not any(self.normal):
            raise fault("normal", "must not be zero: it is the direction from the chest wall to the nipple")
        if self.points_mm is not None and len(self.points_mm) < 4:
            raise fault("points_mm", f"must hold at least 4 points, for a surface; got {len(self.points_mm)}")
        return self


class ImageTable(Table):
    """Image of the breast, and the position of the patient in it."""

    path: Path | None = None  # an image file, or a folder with one DICOM series; see docs/images.md
    phantom: Literal["half-ellipsoid"] | None = None  # a synthetic breast instead of an image
    voxel_mm: Annotated[Positive, bounds(most=20.0)] = 1.0  # voxel size of the phantom
    phantom_size_mm: PhantomSize = SIZE_MM  # width, depth and height of the phantom's breast
    weighting: Literal["t1", "t1-fatsat"] = "t1"  # contrast of the MR image: T1, without or with fat suppression
    # position of the patient in the image
    position: Position = "prone"  # pyright: ignore[reportInvalidTypeForm]
    side: Literal["left", "right"] = "left"  # the breast that is operated on
    axes: str | None = (
        None  # patient directions of the file's x, y, z, such as "RIA", if its header lacks them or is wrong
    )
    plane: Literal["axial", "sagittal"] = "axial"  # plane of the section; for dimension = 2
    slice_mm: Number | None = None  # place of the section along its normal, LPS; default: the resection's centre
    labels: Path | None = None  # label map of the tissues, used instead of the automatic segmentation
    # tissue by the name of a segment in `labels`, or by a value of a label map, where it is not known: "FGT left" = "gland"
    label_names: dict[str, Tissue] = Field(default_factory=dict)
    chest_wall: ChestWallTable | None = None  # found automatically by default

    @model_validator(mode="after")
    def _one_origin(self) -> ImageTable:
        if self.path is not None and self.phantom is not None:
            raise fault("phantom", "and path exclude each other: give one of the two")
        if self.axes is not None and self.axes not in AXES:
            words = "must be the directions of x, y and z, one each of L or R, A or P, S or I, without mirroring"
            raise fault("axes", f'{words}; got "{self.axes}"')
        if self.phantom is None and "phantom_size_mm" in self.model_fields_set:
            raise fault("phantom_size_mm", "belongs to image.phantom, which is left out")
        if self.phantom is not None and self.labels is not None:
            raise fault("labels", "and phantom exclude each other: the phantom has its own labels")
        if self.label_names and self.labels is None:
            raise fault("label_names", "belongs to image.labels, which is left out")
        if self.path is None and self.phantom is None and self.labels is None:
            raise fault(
                "path", 'is missing: name an image, or a label map by labels, or set phantom = "half-ellipsoid"'
            )
        return self


class TrunkTable(Table):
    """Trunk around the breast that moves with it: skin and fat in front of the chest wall, held at its outer border.

    The margins are measured from the base of the breast; all 0 is the breast alone. The trunk ends at the midline if the image
    shows both breasts, because the sternum holds the skin there, and where the image ends. A label map has no trunk.
    """

    medial_mm: NotNegative = 60.0  # margin towards the midline
    lateral_mm: NotNegative = 80.0  # margin towards the armpit
    above_mm: NotNegative = 40.0  # margin above the breast
    below_mm: NotNegative = 60.0  # margin below the breast


FAT_KPA = 0.3  # Young's modulus of fat, to which those of the other tissues are related
STIFFENING = 2.0  # exponent b of the exponential law
Stiffening = Annotated[NotNegative, bounds(most=100.0)]


class FasciaTable(Table):
    """Deep fascia between the breast and the chest wall: the breast slides there, held back by springs, and does not lift off."""

    slides: StrictBool = True  # false: the breast is fixed to the chest wall
    stiffness_kPa_per_mm: NotNegative = 0.01  # traction along the wall per displacement
    fold_factor: Annotated[Number, bounds(least=1.0)] = 20.0  # how much stiffer it is along the inframammary fold


class FatTable(Table):
    """Adipose tissue."""

    E_kPa: Positive = FAT_KPA  # Young's modulus at small strain
    nu: PoissonRatio = 0.495  # Poisson's ratio at small strain
    stiffening: Stiffening = STIFFENING  # exponent b of the law `exponential`; 0: neo-Hookean
    density_kg_m3: Positive = 930.0  # mass density


class GlandTable(Table):
    """Fibroglandular tissue."""

    E_kPa: Positive = 1.2 * FAT_KPA  # Young's modulus at small strain
    nu: PoissonRatio = 0.495  # Poisson's ratio at small strain
    stiffening: Stiffening = STIFFENING  # exponent b of the law `exponential`; 0: neo-Hookean
    density_kg_m3: Positive = 1040.0  # mass density


class SkinTable(Table):
    """Skin, a layer on the outer surface: soft up to a stretch, stiff beyond it."""

    E_kPa: Positive = 4.0  # Young's modulus at small strain
    nu: PoissonRatio = 0.495  # Poisson's ratio at small strain
    density_kg_m3: Positive = 1090.0  # mass density
    thickness_mm: Positive = 1.45  # thickness of the layer
    prestretch: Annotated[Positive, bounds(most=2.0)] = 1.1  # in-plane stretch of the skin in the body without gravity
    # further stretch, beyond the prestretch, from which skin stiffens steeply
    locking_stretch: Annotated[Number, bounds(least=1.0, most=10.0)] = 1.25
    # stress beyond that stretch is stiff_kPa (exp(steepness (stretch - locking stretch)) - 1)
    stiff_kPa: NotNegative = 43.0
    steepness: Annotated[Number, bounds(least=0.01, most=200.0)] = 8.0  # growth of that stress with stretch


class TumourTable(Table):
    """Tumour, which is removed."""

    E_kPa: Positive = 6 * 1.2 * FAT_KPA  # Young's modulus at small strain
    nu: PoissonRatio = 0.495  # Poisson's ratio at small strain
    stiffening: Stiffening = STIFFENING  # exponent b of the law `exponential`; 0: neo-Hookean
    density_kg_m3: Positive = 1040.0  # mass density


class ScarTable(Table):
    """New tissue in the cavity."""

    E_kPa: Positive = FAT_KPA * 29 / 15  # Young's modulus at small strain
    nu: PoissonRatio = 0.495  # Poisson's ratio at small strain
    stiffening: Stiffening = STIFFENING  # exponent b of the law `exponential`; 0: neo-Hookean
    density_kg_m3: Positive = 1040.0  # mass density


class LigamentsTable(Table):
    """Suspensory ligaments of Cooper: fibres from the chest wall to the skin, slack up to a stretch."""

    share: Annotated[NotNegative, bounds(most=0.02)] = 0.01  # share of the volume of the tissue; 0: none
    stiffness_kPa: NotNegative = 40.0  # a third of the modulus of a ligament that has just become straight
    slack_stretch: Annotated[Number, bounds(least=1.0, most=10.0)] = 1.225  # stretch up to which they carry no load


class TissueTable(Table):
    """Stiffness, compressibility and density of each tissue."""

    fat: FatTable = FatTable()
    gland: GlandTable = GlandTable()
    skin: SkinTable = SkinTable()
    tumour: TumourTable = TumourTable()
    scar: ScarTable = ScarTable()
    ligaments: LigamentsTable = LigamentsTable()
    least_bulk_modulus_kPa: NotNegative = 10.0  # least bulk modulus of fat, gland and tumour, which are mostly water


class ResectionTable(Table):
    """Ball of tissue that the surgeon removes.

    The manifest has a note if the margin around a labelled tumour is less than ``margin_mm``.
    """

    centre_mm: Vector | None = None  # centre of the ball, LPS; default: the centroid of the tumour
    radius_mm: Positive = 12.0  # radius of the ball
    margin_mm: NotNegative = 5.0  # required distance from the tumour to the surface of the ball


class HealingTable(Table):
    """Model of the healing cavity, a cellular automaton or a continuum model, and deposition of new tissue.

    The keys from ``hours_per_step`` to ``feedback`` and ``contraction_kPa`` belong to the automaton, those after ``feedback`` to
    the continuum model ``"fields"``: the mechanical signal that cells sense, values in place of the defaults, and the accuracy of
    time steps. Probabilities hold for a lattice of 10 um, one cell per site, and are converted to other pitches.
    """

    # cellular automaton, or continuum model
    model: ModelName = "automaton"  # pyright: ignore[reportInvalidTypeForm]
    deposition: Literal["unloaded", "loaded"] = "unloaded"  # configuration in which new tissue is free of stress
    deposition_prestretch: Positive = 1.0  # in-plane stretch of new tissue as it is deposited; for "loaded"
    contraction_kPa: NotNegative = 0.0  # active tension of new tissue, equal in all directions
    pitch_um: Annotated[Positive, bounds(least=0.1)] = 10.0  # distance between neighbouring sites of the lattice
    hours_per_step: Positive = HOURS_PER_STEP  # cell cycle: duration of a step at a pitch of 10 um
    p_edge: Probability = P_EDGE  # probability per cell cycle that a cell at the edge divides into a free site
    p_layer: Probability = P_LAYER  # probability per cell cycle that a cell of the active layer divides
    layer_um: Annotated[Positive, bounds(most=1e5)] = (
        LAYER_UM  # thickness of the active layer of dividing cells along the wound's edge
    )
    contact_inhibition: Annotated[Integer, bounds(least=0, most=6)] = 1  # free neighbours a dividing edge cell needs
    motility_substeps: Annotated[Integer, bounds(least=0, most=64)] = MOTILITY_SUBSTEPS  # diffusion steps per cycle
    redistribution: Literal["route", "level-set"] = "route"  # daughters follow shortest paths, or a level set
    feedback: NotNegative = 1.0  # p_layer is multiplied by 1 + feedback W / W_ref, W the strain energy density
    # mechanical signal that the cells sense; one of the tables below
    mechanosensing: AnySensing = LogisticTable(type="logistic")  # pyright: ignore[reportInvalidTypeForm]
    parameters: ParametersTable = ParametersTable()
    time_tolerance: TimeTolerance = 1e-3  # largest error of densities and permanent stretches in a time step

    @model_validator(mode="after")
    def _knows_its_keys(self) -> HealingTable:
        """Raise an error for keys that only another model uses."""
        for model, keys in MODEL_KEYS.items():
            for key in keys:
                if model != self.model and key in self.model_fields_set:
                    raise fault(key, f'belongs to healing.model = "{model}"; leave it out')
        check_continuum(self.parameters.model_dump(), self.mechanosensing, is_sheet=False)
        return self

    @model_validator(mode="after")
    def _layer_holds_a_site(self) -> HealingTable:
        if self.layer_um < self.pitch_um:
            raise fault("layer_um", f"must be at least pitch_um ({self.pitch_um:g}); got {self.layer_um:g}")
        return self


class CouplingTable(Table):
    """Coupling of mechanics and healing."""

    mode: Literal["one-way", "two-way"] = "two-way"  # "one-way": deformation does not influence the cells
    days_per_cycle: Positive = 7.0  # time between two solutions of mechanical equilibrium
    # position of the patient while the wound heals
    healing_position: Position = "upright"  # pyright: ignore[reportInvalidTypeForm]


class OutcomeTable(Table):
    """Positions and visits for which the shape is reported."""

    # positions of the patient
    positions: tuple[Position, ...] = ("upright", "supine")  # pyright: ignore[reportInvalidTypeForm]
    visits_weeks: Ascending = (2.0, 6.0, 10.0, 26.0)  # times after surgery
    nipple_mm: Vector | None = None  # nipple in the image, LPS; default: the foremost point of the skin
    # nipple lying supine, LPS, after aligning the ribs with the image: fits the stiffness of tissue and fascia
    supine_nipple_mm: Vector | None = None

    @model_validator(mode="after")
    def _reports_something(self) -> OutcomeTable:
        if not self.positions:
            raise fault("positions", "must name at least one of " + ", ".join(f'"{name}"' for name in POSITIONS))
        return self


class MeshTable(Table):
    """Target edge lengths of the mesh; in three dimensions the defaults are 5 and 2 mm."""

    edge_mm: Positive = 3.0  # edge length far from the cavity
    cavity_edge_mm: Positive = 1.0  # edge length at the cavity, at most edge_mm

    @model_validator(mode="after")
    def _finer_at_the_cavity(self) -> MeshTable:
        if self.cavity_edge_mm > self.edge_mm:
            raise fault("cavity_edge_mm", f"must be at most edge_mm ({self.edge_mm:g}); got {self.cavity_edge_mm:g}")
        return self


class SkinContactTable(Table):
    """Contact of skin with skin, where a soft breast folds."""

    distance_mm: Annotated[NotNegative, bounds(most=10.0)] = 0.5  # distance below which skin repels skin; 0: no contact
    stiffness_kPa: Positive = 1.0  # scale of the pressure: that of a gap of about three quarters of this distance


class LumpectomySolverTable(Table):
    """Convergence criterion of Newton's method."""

    relative_tolerance: Annotated[Number, bounds(above=0.0, most=0.01)] = (
        1e-8  # residual over load where iterations end
    )


class LumpectomyRunTable(Table):
    """Seed of the random numbers, and the longest time that is simulated."""

    seed: Annotated[Integer, bounds(least=0, below=2**63)] = 1  # equal seeds give equal random numbers
    max_weeks: Positive = 52.0  # the run ends here if the wound is still open


class LumpectomyCase(Case):
    """Lumpectomy: from an image of the breast and a planned resection to the healed shape."""

    files: ClassVar[tuple[str, ...]] = (
        *("image.path", "image.labels"),
        *("healing.mechanosensing.species", "healing.mechanosensing.reactions"),
    )
    kind: Literal["lumpectomy"] = "lumpectomy"  # kind of the case
    dimension: Literal[2, 3] = 2  # 2: a plane section of the breast; 3: the whole breast
    image: ImageTable
    trunk: TrunkTable = TrunkTable()
    fascia: FasciaTable = FasciaTable()
    tissue: TissueTable = TissueTable()
    resection: ResectionTable = ResectionTable()
    healing: HealingTable = HealingTable()
    coupling: CouplingTable = CouplingTable()
    outcome: OutcomeTable = OutcomeTable()
    mesh: MeshTable = MeshTable()
    skin_contact: SkinContactTable = SkinContactTable()
    solver: LumpectomySolverTable = LumpectomySolverTable()
    run: LumpectomyRunTable = LumpectomyRunTable()

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return self.run.seed

    def sources(self) -> dict[str, str]:
        """Return the source of each tissue and healing parameter, by dotted key."""
        return sources_of(self, LumpectomyCase(image=self.image))

    @property
    def days_per_step(self) -> float:
        """Duration of one automaton step at the lattice pitch of the case [days]."""
        h = self.healing
        hours = hours_per_step_at_pitch(
            h.pitch_um, h.hours_per_step, self.dimension, p_layer=h.p_layer, layer_um=h.layer_um
        )
        return days_from_hours(hours)

    def rules(self) -> AutomatonRules:
        """Build the rules of the automaton, with probabilities converted to the lattice pitch of the case.

        Raises
        ------
        InputError
            If a rate gives no valid probability at the lattice pitch of the case.
        """
        h = self.healing
        return rules_at_pitch(
            h.pitch_um,
            self.dimension,
            p_edge=h.p_edge,
            p_layer=h.p_layer,
            layer_um=h.layer_um,
            motility_substeps=h.motility_substeps,
            redistribution=h.redistribution,
            feedback=h.feedback if self.coupling.mode == "two-way" else 0.0,
            min_free_neighbours=max(1, h.contact_inhibition),
        )

    @model_validator(mode="after")
    def _sites_fit_into_memory(self) -> LumpectomyCase:
        """Refuse a pitch at which the lattice over the undeformed ball of the resection would not fit into memory."""
        pitch_um = self.healing.pitch_um
        ball = self.resection.radius_mm * np.array([[-1.0] * self.dimension, [1.0] * self.dimension])
        try:
            reason = too_many(box_around(ball, self.rules(), pitch_um), pitch_um)
        except InputError:
            return self  # the run reports this error, with the reason
        if reason:
            raise fault("healing.pitch_um", reason)
        return self

    @model_validator(mode="before")
    @classmethod
    def _edges_of_a_solid(cls, tables: Any) -> Any:
        """Fill in the default edge lengths of a mesh in three dimensions."""
        if isinstance(tables, Mapping) and tables.get("dimension") == 3:
            given = tables.get("mesh", {})
            if isinstance(given, Mapping):
                return {**tables, "mesh": {**SOLID_EDGES_MM, **given}}
        return tables

    @model_validator(mode="after")
    def _fits_what_slides(self) -> LumpectomyCase:
        if self.outcome.supine_nipple_mm is None:
            return self
        if not self.fascia.slides:
            raise fault(
                "outcome.supine_nipple_mm", "needs fascia.slides = true: it fits the stiffness of the fascia too"
            )
        if self.image.position.startswith("supine"):
            raise fault(
                "outcome.supine_nipple_mm", "belongs to an image in another position; this one is supine already"
            )
        return self

    @model_validator(mode="after")
    def _a_solid_has_no_plane(self) -> LumpectomyCase:
        for key in ("plane", "slice_mm"):
            if self.dimension == 3 and key in self.image.model_fields_set:
                raise fault(f"image.{key}", "belongs to dimension = 2, where a section is cut; leave it out")
        return self

    @model_validator(mode="after")
    def _cycle_holds_a_step(self) -> LumpectomyCase:
        step, cycle = self.days_per_step, self.coupling.days_per_cycle
        if cycle < step:
            sentence = f"must hold at least one automaton step ({step:g} days at this pitch); got {cycle:g}"
            raise fault("coupling.days_per_cycle", sentence)
        return self
