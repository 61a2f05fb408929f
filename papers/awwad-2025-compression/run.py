"""Compare a breast between two plates with the published explicit solution: prints claim | measured | holds (see README.md)."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import meshio
import mmgpy
import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.spatial import cKDTree
from skfem.quadrature import get_quadrature

from cicatrix.cases.paths import data_folder
from cicatrix.geometry.tetrahedra import EDGES, boundary, neighbours, oriented, volumes, with_middles
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.mechanics.body import Body, Discretization
from cicatrix.mechanics.contact import Contact, Plate
from cicatrix.mechanics.space import SolidSpace, tabulate
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
FOLDER = "fe_reference_breastct3"
# values of the published input
MU = np.array([1.4876584389593062, 5.036691127418278, 6.6711140760507])  # fat, gland, skin [kPa]
KAPPA = np.array([743.3333333333327, 2516.6666666666642, 3333.3333333333303])  # [kPa]
DENSITY, GRAVITY = 1e-6, np.array([0.0, 4905.0, 0.0])  # kg/mm^3, mm/s^2
BOTTOM, TOP, WAYS = 39.952, 166.66, (46.638, -15.0)  # initial y of the two plates and their displacements [mm]
DT, DAMPING = 1e-5, 0.065  # s, 1/s
UP = np.array([0.0, 1.0, 0.0])
PLATES = [Plate(BOTTOM * UP, UP, WAYS[0] * UP), Plate(TOP * UP, -UP, WAYS[1] * UP)]
ON_PLATE = 2e-3  # mm; the published displacements have six digits
SLICE_MM = 3.0  # half the thickness of the slice in the figure
FIDELITY = 0.05  # largest distance of an edge from the published surface, relative to its length
TOLERANCE = 1e-6
COMPILE = ("g++", "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math")
RELAXED = (30.0, 50_000, 85_000)  # damping [1/s], steps of the load ramp, and all steps of the relaxed solution
NEAR = 40  # number of candidate tetrahedra in the search for the one that contains a point


# ---- the published data ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Reference:
    """Published mesh and its displacements."""

    points: np.ndarray
    """(n, 3) [mm]"""
    tetrahedra: np.ndarray
    """(m, 4)"""
    tissue: np.ndarray
    """(m,) 0 fat, 1 gland, 2 skin"""
    is_chest: np.ndarray
    """(n,) bool: z does not move"""
    displacement: np.ndarray
    """(n, 3) [mm]"""

    @classmethod
    def read(cls) -> Reference:
        """Read the published data, with the rounded coordinates of the solver instead of those of the mesh."""
        folder = data_folder() / FOLDER
        mesh, solved = meshio.read(folder / "volmesh3.vtu"), meshio.read(folder / "volmesh3_niftysim.vtu")
        return cls(
            np.round(solved.points.astype(float), 3),
            solved.cells_dict["tetra"].astype(int),
            np.asarray(mesh.cell_data["materials"][0]).ravel().astype(int) - 1,
            np.asarray(mesh.point_data["boundaryConditions"]).ravel() > 0,
            solved.point_data["displacements"].astype(float),
        )

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volumes of the tetrahedra (m,) [mm^3]."""
        return volumes(self.points, self.tetrahedra)

    @cached_property
    def mass(self) -> np.ndarray:
        """Nodal masses, a quarter of the mass of each adjacent tetrahedron (n,) [kg]."""
        shares = np.repeat(DENSITY * self.volumes / 4, 4)
        return np.bincount(self.tetrahedra.ravel(), shares, len(self.points))

    @cached_property
    def is_free(self) -> np.ndarray:
        """Displacement components that neither the chest nor a plate constrains (n, 3) bool."""
        y = self.points[:, 1] + self.displacement[:, 1]
        out = np.ones(self.points.shape, bool)
        out[self.is_chest, 2] = False
        out[(y < BOTTOM + WAYS[0] + ON_PLATE) | (y > TOP + WAYS[1] - ON_PLATE), 1] = False
        return out


# ---- the effect of single precision ---------------------------------------------------------------------------------------


def single_mass(reference: Reference) -> np.ndarray:
    """Return nodal masses (n,) [kg] as NiftySim sums them: in single precision, one tissue after the other."""
    single = reference.points.astype(np.float32).astype(float)
    shares = (volumes(single, reference.tetrahedra) * float(np.float32(DENSITY)) / 4).astype(np.float32)
    order = np.argsort(reference.tissue, kind="stable")
    mass = np.zeros(len(single), np.float32)
    np.add.at(mass, reference.tetrahedra[order].ravel(), np.repeat(shares[order], 4))
    return mass


def coefficients(mass: np.ndarray, damping: float = DAMPING) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, C of a time step u' = A f + B u + C u_before, in the precision of the masses (n,) and NiftySim's order."""
    one = mass.dtype.type
    dt, alpha, two = one(DT), one(damping), one(2)
    A = one(1) / (mass / dt / dt + alpha * mass / two / dt)
    B = two * mass * A / dt / dt
    return A, B, alpha * mass * A / two / dt - B / two


def tether(mass: np.ndarray) -> np.ndarray:
    """Return the spring per mass to the initial position (n,) [1/s^2] that results from B + C not being 1."""
    _, B, C = (c.astype(float) for c in coefficients(mass))
    return (1.0 - B - C) / DT**2


def out_of_balance(reference: Reference) -> np.ndarray:
    """Return the residual of the published field as accelerations (n, 3) [mm/s^2]: -(internal force - weight) / mass."""
    body = linear_body(reference, 0.0)
    X = body.discretization.space.positions
    return -body.residual(X, X + reference.displacement, GRAVITY) / reference.mass[:, None]


def slope(reference: Reference, a: np.ndarray, by: np.ndarray) -> tuple[float, float]:
    """Return the slope of a regression of accelerations a (n, 3) on ``by`` (n, 3) and its standard error.

    Only free components are used, weighted by mass.
    """
    free = reference.is_free
    w = np.broadcast_to(reference.mass[:, None], free.shape)[free]
    x, y = by[free], a[free]
    found = (w * x * y).sum() / (w * x * x).sum()
    return found, float(np.sqrt((w * (y - found * x) ** 2).mean() / (w * x * x).sum()))


# ---- bodies ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Tethered(Body):
    """Body with springs to the initial positions: force = spring [1/s^2] times mass times displacement."""

    spring: float = 0.0

    def residual(self, X, x, gravity, J_bar=None):  # noqa: D102
        value, space = self.discretization.space.table.value, self.discretization.space
        way = np.einsum("qa,eai->eqi", value, (x - X)[space.element_nodes])
        force = np.einsum("eq,qa,eqi->eai", self.spring * self.density * self.volumes(X), value, way)
        no_skin = np.zeros((*self.discretization.skin_nodes.shape, 3))
        return super().residual(X, x, gravity, J_bar) + self.discretization.scatter([force, no_skin])

    def linearised(self, X, x, J_bar, *, in_plane, damping=0.0):  # noqa: D102
        matrix, rates = super().linearised(X, x, J_bar, in_plane=in_plane, damping=damping)
        if self.spring:
            matrix.data[...] += self._spring_blocks
        return matrix, rates

    @cached_property
    def _spring_blocks(self) -> np.ndarray:
        """Blocks of the mass matrix times the spring constant."""
        space, (_, pattern) = self.discretization.space, self.discretization.solved(False)
        value, mass = space.table.value, self.spring * self.density * self.volumes(space.positions)
        data = pattern.zeros()
        for k in range(0, space.n_elements, 2048):
            m = np.einsum("eq,qa,qb->eab", mass[k : k + 2048], value, value)
            pattern.add(data, 0, k, np.einsum("eab,ij->eaibj", m, np.eye(3)).reshape(len(m), *2 * [3 * m.shape[1]]))
        return data


@dataclass(frozen=True, eq=False)
class LinearSpace(SolidSpace):
    """Linear tetrahedra with one quadrature point, as in the published solution."""

    quadrature_order: int = 1

    @property
    def kind(self) -> tuple:  # noqa: D102
        return "linear solid", self.quadrature_order

    @cached_property
    def table(self):  # noqa: D102
        return LINEAR

    @cached_property
    def facet_table(self):  # noqa: D102
        return tabulate(skfem.ElementTriP1(), *get_quadrature(skfem.MeshTri.elem, 1))


LINEAR = tabulate(skfem.ElementTetP1(), *get_quadrature(skfem.MeshTet.elem, 1))


def body_of(space: SolidSpace, is_chest: np.ndarray, tissue: np.ndarray, spring: float) -> Tethered:
    """Build a body whose chest nodes (n,) bool slide, with tissue (n_elements, n_qp).

    Without springs, x of one node is fixed.
    """
    nodes = np.flatnonzero(is_chest)
    normals = np.tile([0.0, 0.0, 1.0], (len(nodes), 1))
    if not spring:
        centre = np.argmin(np.linalg.norm(space.positions - space.positions.mean(axis=0), axis=1))
        nodes, normals = np.append(nodes, centre), np.vstack([normals, [1.0, 0.0, 0.0]])
    none = np.zeros(0, int)
    return Tethered(
        Discretization(space, none, none, nodes, normals),
        NeoHookean(MU[tissue], KAPPA[tissue]),
        np.full(tissue.shape, DENSITY),
        np.ones(space.n_elements),
        NeoHookean(1.0, 1.0),
        np.zeros(0),
        spring=spring,
    )


def linear_body(reference: Reference, spring: float) -> Tethered:
    """Return a body on the published mesh."""
    space = LinearSpace(reference.points, reference.tetrahedra)
    return body_of(space, reference.is_chest, reference.tissue[:, None], spring)


def quadratic_body(reference: Reference, edge_mm: float, spring: float) -> Tethered:
    """Return a body of quadratic tetrahedra with another edge length inside the published surface.

    The tissue at each quadrature point is that of the published mesh there.
    """
    points, tetrahedra, is_chest = remeshed(reference, edge_mm)
    space = SolidSpace(*with_middles(points, tetrahedra))
    at = np.einsum("qa,eai->eqi", space.table.value, space.positions[space.element_nodes])
    tissue = reference.tissue[located(reference.points, reference.tetrahedra, at.reshape(-1, 3))[0]]
    is_chest = np.append(is_chest, np.zeros(space.n_nodes - len(points), bool))
    one, other, middle = boundary(space.element_nodes)[:, [[0, 1, 3], [1, 2, 4], [0, 2, 5]]].reshape(-1, 3).T
    is_chest[middle[is_chest[one] & is_chest[other]]] = True
    return body_of(space, is_chest, tissue.reshape(at.shape[:2]), spring)


def remeshed(reference: Reference, edge_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Remesh with MMG to edges of about ``edge_mm``; return points, tetrahedra and chest nodes (n,) bool."""
    faces = boundary(reference.tetrahedra)
    marks = np.where(reference.is_chest[faces].all(axis=1), 22, 21).astype(np.int32)
    mesh = mmgpy.MmgMesh3D()
    mesh.set_mesh_size(vertices=len(reference.points), tetrahedra=len(reference.tetrahedra), triangles=len(faces))
    mesh.set_vertices(reference.points)
    mesh.set_tetrahedra(reference.tetrahedra.astype(np.int32), np.ones(len(reference.tetrahedra), np.int32))
    mesh.set_triangles(faces.astype(np.int32), marks)
    mesh.remesh(verbose=-1, hausd=FIDELITY * edge_mm, hmin=0.5 * edge_mm, hmax=edge_mm, hgrad=1.5)
    points, tetrahedra = mesh.get_vertices(), mesh.get_tetrahedra()
    triangles, marks = mesh.get_triangles_with_refs()
    is_chest = np.zeros(len(points), bool)
    is_chest[triangles[marks == 22]] = True
    return points, oriented(points, tetrahedra), is_chest


def located(points: np.ndarray, tetrahedra: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the tetrahedra that contain points (k, 3), or the nearest ones, (k,), and barycentric coordinates (k, 4)."""
    corners = points[tetrahedra[:, :4]]
    inverse = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))
    _, candidates = cKDTree(corners.mean(axis=1)).query(at, k=NEAR)
    best, least, shares = candidates[:, 0], np.full(len(at), -np.inf), np.zeros((len(at), 4))
    for cell in candidates.T:
        local = np.einsum("nij,nj->ni", inverse[cell], at - corners[cell, 0])
        all_four = np.column_stack([1.0 - local.sum(axis=1), local])
        better = all_four.min(axis=1) > least
        best = np.where(better, cell, best)
        shares[better], least[better] = all_four[better], all_four[better].min(axis=1)
    return best, shares


def interpolated(space: SolidSpace, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate a field of quadratic tetrahedra (n_nodes, 3) to points (k, 3) -> (k, 3)."""
    cell, L = located(space.positions, space.element_nodes, at)
    middles = [4.0 * L[:, i] * L[:, j] for i, j in EDGES]
    N = np.column_stack([L * (2.0 * L - 1.0), *middles])
    return np.einsum("na,nai->ni", N, values[space.element_nodes[cell]])


# ---- the comparison -------------------------------------------------------------------------------------------------------


def quadratic(reference: Reference, edge_mm: float, share: float) -> np.ndarray:
    """Return displacements of quadratic tetrahedra at the published nodes (n, 3) [mm].

    The springs act, and plates and gravity have a fraction ``share`` of their final values.
    """
    springs = tether(single_mass(reference))
    body = quadratic_body(reference, edge_mm, float(np.average(springs, weights=reference.mass)))
    space = body.discretization.space
    plates = [Plate(p.point, p.normal, share * p.displacement) for p in PLATES]
    solution = Contact(TOLERANCE).solve(body, space.positions, share * GRAVITY, plates)
    return interpolated(space, solution.x - space.positions, reference.points)


def error(reference: Reference, u: np.ndarray) -> np.ndarray:
    """Return the error of displacements at the published nodes (n, 3) [mm].

    The shift of the centre of mass along x, which nothing constrains, is subtracted.
    """
    off = u - reference.displacement
    return off - [np.average(off[:, 0], weights=reference.mass), 0.0, 0.0]


def rms(vectors: np.ndarray) -> float:
    """Return the root mean square of the lengths of vectors (n, 3) [mm]."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def without_rigid(reference: Reference, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (n, 3) [mm] after subtracting the best rigid-body motion, and its rotation (3,) [degrees]."""
    at = reference.points + reference.displacement
    arm = at - np.average(at, axis=0, weights=reference.mass)
    turns = np.cross(np.eye(3)[:, None], arm).transpose(1, 2, 0)
    columns = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2)
    found = np.linalg.lstsq(columns.reshape(-1, 6), off.ravel())[0]
    return off - columns @ found, np.degrees(found[3:])


def fluctuation(reference: Reference, u: np.ndarray) -> tuple[float, float]:
    """Return the standard deviation of pressure in tetrahedra of fat [kPa] and its correlation across common faces."""
    pressure = KAPPA[0] * (volumes(reference.points + u, reference.tetrahedra) / reference.volumes - 1.0)
    one, other = neighbours(reference.tetrahedra)
    both = (reference.tissue[one] == 0) & (reference.tissue[other] == 0)
    return float(pressure[reference.tissue == 0].std()), float(
        np.corrcoef(pressure[one[both]], pressure[other[both]])[0, 1]
    )


# ---- the explicit solution repeated ---------------------------------------------------------------------------------------


def explicit(reference: Reference, kind: str, share: float = 1.0) -> np.ndarray:
    """Compute displacements of linear tetrahedra (n, 3) [mm] with the explicit method of explicit.cpp.

    ``single``: with the round-off of NiftySim's coefficients; ``double``: without; ``relaxed``: without, but with springs of
    the same stiffness and damped until it is static, after a fraction ``share`` of plates and gravity.
    """
    mass = single_mass(reference)
    tied = tether(mass) * mass
    damping, n_ramp, n_steps = RELAXED if kind == "relaxed" else (DAMPING, 100_000, 100_000)
    A, B, C = coefficients(mass if kind == "single" else mass.astype(float), damping)
    nodes, cells = _order(reference)
    scalars = [len(nodes), len(cells), kind == "single", n_steps, n_ramp]
    scalars += [share * GRAVITY[1], BOTTOM, share * WAYS[0], TOP, share * WAYS[1]]
    tissue = reference.tissue[cells]
    number = np.argsort(nodes)
    floats = [scalars, reference.points[nodes], MU[tissue], KAPPA[tissue], *(a[nodes] for a in (A, B, C, mass))]
    floats.append((tied if kind == "relaxed" else 0.0 * tied)[nodes])
    wholes = [number[reference.tetrahedra[cells]], reference.is_chest[nodes]]
    with tempfile.TemporaryDirectory() as folder:
        program, model, result = (Path(folder) / name for name in ("explicit", "model", "result"))
        subprocess.run([*COMPILE, HERE / "explicit.cpp", "-o", program], check=True)
        with model.open("wb") as file:
            for array in [np.asarray(f, float) for f in floats] + [np.asarray(w, np.int32) for w in wholes]:
                file.write(array.tobytes())
        subprocess.run([program, model, result], check=True)
        return np.fromfile(result).reshape(-1, 3)[number]


def _order(reference: Reference) -> tuple[np.ndarray, np.ndarray]:
    """Return an order of nodes and of tetrahedra in which neighbours are close in memory."""
    n, cells = len(reference.points), reference.tetrahedra
    places = np.repeat(cells, 4, axis=1).ravel(), np.tile(cells, (1, 4)).ravel()
    nodes = reverse_cuthill_mckee(sp.coo_array((np.ones(places[0].size), places), shape=(n, n)).tocsr())
    return nodes, np.argsort(np.argsort(nodes)[cells].min(axis=1), kind="stable")


# ---- the claims -----------------------------------------------------------------------------------------------------------


def measure() -> dict[str, float]:
    """Return the quantities that take seconds to compute, by name."""
    reference = Reference.read()
    springs = tether(single_mass(reference))
    out = {"tether": float(np.average(springs, weights=reference.mass))}
    lacking = out_of_balance(reference)
    out["slope"], out["slope_error"] = slope(reference, lacking, springs[:, None] * reference.displacement)
    out["spread_kPa"], out["correlation"] = fluctuation(reference, reference.displacement)
    return out


def measure_explicit(fields: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the relative RMS errors of the three explicit solutions (n, 3) [mm]; computing these takes half an hour."""
    reference = Reference.read()
    out = {kind: rms(error(reference, u)) / rms(reference.displacement) for kind, u in fields.items()}
    ratios, again = (
        (volumes(reference.points + u, reference.tetrahedra) / reference.volumes)[reference.tissue == 0]
        for u in (reference.displacement, fields["relaxed"])
    )
    return out | {"same_ratios": float(np.corrcoef(ratios, again)[0, 1])}


def table(m: dict[str, float]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table that take seconds to compute: claim, measured value, whether it holds."""
    return [
        (
            "in single precision, B + C of a time step acts like springs to the initial positions of 370 to 400 /s2 on average",
            f"{m['tether']:.0f} /s2",
            370 < m["tether"] < 400,
        ),
        (
            "the residual of the published field is this force, node by node: slope within three standard errors of 1",
            f"{m['slope']:.2f} +- {m['slope_error']:.2f}",
            abs(m["slope"] - 1.0) < 3.0 * m["slope_error"] < 0.3,
        ),
        (
            "pressure in the published linear tetrahedra of fat is noise: spread above 5 kPa and no correlation across faces",
            f"{m['spread_kPa']:.1f} kPa, correlation {m['correlation']:.3f}",
            m["spread_kPa"] > 5.0 and abs(m["correlation"]) < 0.05,
        ),
    ]


def table_explicit(m: dict[str, float]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table for the explicit solutions: claim, measured value, whether it holds."""
    return [
        (
            "the explicit method repeated in single precision is within 2 % RMS of the published solution",
            f"{100 * m['single']:.2f} %",
            m["single"] < 0.02,
        ),
        (
            "the explicit method in double precision is within 2 % RMS of it",
            f"{100 * m['double']:.0f} %",
            m["double"] < 0.02,
        ),
        (
            "the static solution of linear tetrahedra with these springs is within 4 % RMS of it",
            f"{100 * m['relaxed']:.1f} %",
            m["relaxed"] < 0.04,
        ),
        (
            "and has the same volume ratios in fat, tetrahedron by tetrahedron (correlation above 0.98)",
            f"{m['same_ratios']:.3f}",
            m["same_ratios"] > 0.98,
        ),
    ]


def draw(fields: dict[str, np.ndarray]) -> None:
    """Draw the error of the explicit solutions in a slice across the chest, on the published shape."""
    reference = Reference.read()
    at = reference.points + reference.displacement
    middle = np.abs(at[:, 0] - np.average(at[:, 0], weights=reference.mass)) < SLICE_MM
    words = {
        "single": "explicit, single precision",
        "relaxed": "with springs, static",
        "double": "explicit, double precision",
    }
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained", sharey=True)
    for ax, (kind, title) in zip(axes, words.items()):
        off = np.linalg.norm(error(reference, fields[kind]), axis=1)
        dots = ax.scatter(at[middle, 2], at[middle, 1], c=off[middle], s=14, cmap="viridis", vmin=0)
        for y in (BOTTOM + WAYS[0], TOP + WAYS[1]):
            ax.axhline(y, color="#888888", linewidth=0.8)
        ax.set_title(f"{title}: {rms(error(reference, fields[kind])):.2f} mm RMS", fontsize=9)
        ax.set_xlabel("z, from the chest [mm]")
        ax.set_aspect("equal")
        figure.colorbar(dots, ax=ax, label="difference from the published field [mm]", shrink=0.8)
    axes[0].set_ylabel("y, across the plates [mm]")
    figure.savefig(HERE / "error.png", dpi=110)


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    fields = {kind: explicit(Reference.read(), kind) for kind in ("single", "double", "relaxed")}
    draw(fields)
    return print_claims(HERE, table(measure()) + table_explicit(measure_explicit(fields)))


if __name__ == "__main__":
    sys.exit(main())
