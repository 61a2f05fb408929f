"""What a case says: numbers, names and paths, frozen and checked; the names are the keys of the case file.

A case is plain data. It holds no arrays and no callables, so two cases are equal when their files say the same.
Lengths are in mm, stiffness in kPa, where a key's name does not say otherwise. Where a default comes from is told
by :mod:`cicatrix.kinds.lumpectomy.sources`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from ...cases.bounds import (
    Ascending,
    Integer,
    NotNegative,
    Number,
    PoissonRatio,
    Positive,
    Probability,
    Vector,
    fault,
    limits,
)
from ...cases.continuum import AnySensing, LogisticTable, ParametersTable, TimeTolerance, check_fields
from ...cases.table import Case, Table
from ...core.errors import InputError
from ...core.units import days_from_hours, mm_from_um
from ...geometry.hexgrid import Lattice
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
from .sites import box_around, too_many
from .sources import sources_of

Position = Literal["prone", "supine", "upright"]
BY_FIELDS = ("mechanosensing", "parameters", "time_tolerance")  # keys of healing that one model has
BY_AUTOMATON = (
    *("contraction_kPa", "hours_per_step", "p_edge", "p_layer", "layer_um", "contact_inhibition"),
    *("motility_substeps", "redistribution", "feedback"),
)
SOLID_EDGES_MM = {"edge_mm": 5.0, "cavity_edge_mm": 2.0}  # what a mesh of three dimensions has by default


class ChestWall(Table):
    """Where the breast ends behind, when it is not to be found automatically.

    Either a plane by ``point_mm`` and ``normal``, or a surface through ``points_mm``; image coordinates (LPS).
    """

    point_mm: Vector | None = None
    normal: Vector | None = None
    points_mm: tuple[Vector, ...] | None = None

    @model_validator(mode="after")
    def _plane_or_points(self) -> ChestWall:
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


class Image(Table):
    """The picture of the breast and how she lay."""

    path: Path | None = None
    phantom: Literal["half-ellipsoid"] | None = None
    voxel_mm: Annotated[Positive, limits(most=20.0)] = 1.0  # of the phantom
    weighting: Literal["t1", "t1-fatsat"] = "t1"
    position: Position = "prone"
    side: Literal["left", "right"] = "left"
    axes: str | None = None  # where the file's x, y, z lead, such as "RIA", if it says so wrongly
    plane: Literal["axial", "sagittal"] = "axial"
    slice_mm: Number | None = None
    labels: Path | None = None
    chest_wall: ChestWall | None = None

    @model_validator(mode="after")
    def _one_origin(self) -> Image:
        if self.path is not None and self.phantom is not None:
            raise fault("phantom", "and path exclude each other: give one of the two")
        if self.axes is not None and self.axes not in AXES:
            words = "must be three letters of L or R, A or P, S or I, where x, y and z lead, and no mirror image"
            raise fault("axes", f'{words}; got "{self.axes}"')
        if self.phantom is not None and self.labels is not None:
            raise fault("labels", "and phantom exclude each other: the phantom knows its own labels")
        if self.path is None and self.phantom is None and self.labels is None:
            raise fault(
                "path", 'is missing: name an image, or a label map by labels, or set phantom = "half-ellipsoid"'
            )
        return self


class Fat(Table):
    """Adipose tissue."""

    E_kPa: Positive = 3.25
    nu: PoissonRatio = 0.495
    density_kg_m3: Positive = 930.0


class Gland(Table):
    """Fibroglandular tissue."""

    E_kPa: Positive = 3.24
    nu: PoissonRatio = 0.495
    density_kg_m3: Positive = 1040.0


class Skin(Table):
    """Skin, a layer on the outer surface."""

    E_kPa: Positive = 56.0
    nu: PoissonRatio = 0.495
    density_kg_m3: Positive = 1090.0
    thickness_mm: Positive = 1.45


class Tumour(Table):
    """The mass that is taken out."""

    E_kPa: Positive = 6 * 3.24
    nu: PoissonRatio = 0.495
    density_kg_m3: Positive = 1040.0


class Scar(Table):
    """New tissue in the cavity."""

    E_kPa: Positive = 3.25 * 29 / 15
    nu: PoissonRatio = 0.495
    density_kg_m3: Positive = 1040.0


class Tissue(Table):
    """Small-strain stiffness, compressibility and density of each tissue."""

    fat: Fat = Fat()
    gland: Gland = Gland()
    skin: Skin = Skin()
    tumour: Tumour = Tumour()
    scar: Scar = Scar()


class Resection(Table):
    """What the surgeon removes: a ball; its centre left out is the tumour's centroid.

    A labelled tumour of which it leaves less than ``margin_mm`` around is noted in the manifest.
    """

    centre_mm: Vector | None = None
    radius_mm: Positive = 12.0
    margin_mm: NotNegative = 5.0


class Healing(Table):
    """How the cavity heals, by the automaton or by fields, and the tissue that is laid down."""

    model: Literal["automaton", "fields"] = "automaton"
    deposition: Literal["unloaded", "loaded"] = "unloaded"
    deposition_prestretch: Positive = 1.0
    contraction_kPa: NotNegative = 0.0
    pitch_um: Positive = 10.0
    hours_per_step: Positive = HOURS_PER_STEP
    p_edge: Probability = P_EDGE
    p_layer: Probability = P_LAYER
    layer_um: Positive = LAYER_UM
    contact_inhibition: Annotated[Integer, limits(least=0, most=6)] = 1
    motility_substeps: Annotated[Integer, limits(least=0, most=64)] = MOTILITY_SUBSTEPS
    redistribution: Literal["route", "level-set"] = "route"
    feedback: NotNegative = 1.0
    mechanosensing: AnySensing = LogisticTable(type="logistic")  # pyright: ignore[reportInvalidTypeForm]
    parameters: ParametersTable = ParametersTable()
    time_tolerance: TimeTolerance = 1e-3

    @model_validator(mode="after")
    def _knows_its_keys(self) -> Healing:
        """Refuse what the other model would read."""
        other = BY_AUTOMATON if self.model == "fields" else BY_FIELDS
        for key in other:
            if key in self.model_fields_set:
                which = "automaton" if self.model == "fields" else "fields"
                raise fault(key, f'belongs to healing.model = "{which}"; leave it out')
        check_fields(self.parameters.model_dump(), self.mechanosensing, is_sheet=False)
        return self

    @model_validator(mode="after")
    def _layer_holds_a_site(self) -> Healing:
        if self.layer_um < self.pitch_um:
            raise fault("layer_um", f"must be at least pitch_um ({self.pitch_um:g}); got {self.layer_um:g}")
        return self


class Coupling(Table):
    """How often, and in which direction, mechanics and healing talk."""

    mode: Literal["one-way", "two-way"] = "two-way"
    days_per_cycle: Positive = 7.0
    healing_position: Position = "upright"


class Outcome(Table):
    """For which positions and visits the shape is reported."""

    positions: tuple[Position, ...] = ("upright", "supine")
    visits_weeks: Ascending = (2.0, 6.0, 10.0, 26.0)
    nipple_mm: Vector | None = None  # in the image, LPS; the foremost point of the skin unless given

    @model_validator(mode="after")
    def _reports_something(self) -> Outcome:
        if not self.positions:
            raise fault("positions", 'must name at least one of "upright", "supine", "prone"')
        return self


class Mesh(Table):
    """Target edge lengths of the mesh: far from the cavity and at it; in three dimensions 5 and 2 mm by default."""

    edge_mm: Positive = 3.0
    cavity_edge_mm: Positive = 1.0

    @model_validator(mode="after")
    def _finer_at_the_cavity(self) -> Mesh:
        if self.cavity_edge_mm > self.edge_mm:
            raise fault("cavity_edge_mm", f"must be at most edge_mm ({self.edge_mm:g}); got {self.cavity_edge_mm:g}")
        return self


class Solver(Table):
    """When Newton's method is done: residual over load."""

    relative_tolerance: Annotated[Number, limits(above=0.0, most=0.01)] = 1e-8


class Run(Table):
    """Seed of the random numbers and the last week."""

    seed: Annotated[Integer, limits(least=0, below=2**63)] = 1
    max_weeks: Positive = 52.0


class LumpectomyCase(Case):
    """The main job: from an image and a planned lumpectomy to the healed shape."""

    files: ClassVar[tuple[str, ...]] = (
        *("image.path", "image.labels"),
        *("healing.mechanosensing.species", "healing.mechanosensing.reactions"),
    )
    kind: Literal["lumpectomy"] = "lumpectomy"
    dimension: Literal[2, 3] = 2
    image: Image
    tissue: Tissue = Tissue()
    resection: Resection = Resection()
    healing: Healing = Healing()
    coupling: Coupling = Coupling()
    outcome: Outcome = Outcome()
    mesh: Mesh = Mesh()
    solver: Solver = Solver()
    run: Run = Run()

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return self.run.seed

    def sources(self) -> dict[str, str]:
        """Return where the numbers of tissue and healing come from, by dotted key."""
        return sources_of(self, LumpectomyCase(image=self.image))

    @property
    def days_per_step(self) -> float:
        """Length of one automaton step at this pitch [days]."""
        h = self.healing
        hours = hours_per_step_at_pitch(
            h.pitch_um, h.hours_per_step, self.dimension, p_layer=h.p_layer, layer_um=h.layer_um
        )
        return days_from_hours(hours)

    def rules(self) -> AutomatonRules:
        """What a cell does in one step, at this pitch.

        Raises
        ------
        InputError
            If the rates make no rules at this pitch.
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
        """Refuse at once what the lattice over the resection's ball, not yet deformed, would need."""
        if self.dimension == 2:
            return self
        pitch_um, ball = self.healing.pitch_um, self.resection.radius_mm * np.array([[-1.0] * 3, [1.0] * 3])
        try:
            box = box_around(ball, self.rules(), pitch_um)
            reason = too_many(Lattice.covering(box[0], box[1], mm_from_um(pitch_um)), pitch_um)
        except InputError:
            return self  # told when it is run, with the reason
        if reason:
            raise fault("healing.pitch_um", reason)
        return self

    @model_validator(mode="before")
    @classmethod
    def _edges_of_a_solid(cls, tables: Any) -> Any:
        """Fill in what a mesh of three dimensions has by default."""
        if isinstance(tables, Mapping) and tables.get("dimension") == 3:
            given = tables.get("mesh", {})
            if isinstance(given, Mapping):
                return {**tables, "mesh": {**SOLID_EDGES_MM, **given}}
        return tables

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
