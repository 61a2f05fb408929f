"""Program for the ranks of test_petsc.py, started by mpiexec or alone; the first rank writes the results to a file."""

import sys

import numpy as np
import scipy.sparse as sp
import skfem

from cicatrix.core.errors import ConvergenceError
from cicatrix.core.ranks import world
from cicatrix.geometry.tetrahedra import oriented, used_only
from cicatrix.mechanics.division import layout_of, shared
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.solids import solid_body
from cicatrix.numerics.krylov import Layout, PetscEngine
from cicatrix.numerics.linear import LinearSolver

SEMI_AXES = np.array([65.0, 65.0, 50.0])  # mm
GRAVITY = np.array([0.0, -9810.0, 0.0])  # mm/s^2
DENSITY = 1e-6  # kg/mm^3
TOLERANCE = 1e-10
METHODS = ("mumps", "gamg")
N = 30  # blocks of the matrices


def breast(nu=0.49):
    """Return a breast of 256 tetrahedra on its base, one half stiffer."""
    ball = skfem.MeshTet.init_ball(2)
    points, tetrahedra = used_only(ball.p.T * SEMI_AXES, ball.t.T[ball.p[2][ball.t].mean(axis=0) > 0])
    tetrahedra = oriented(points, tetrahedra)
    E = np.where(points[tetrahedra].mean(axis=1)[:, 0] > 0, 3.0, 1.0)
    same = np.ones(len(E))
    return solid_body(points, tetrahedra, np.abs(points[:, 2]) < 1e-9, E, nu * same, DENSITY * same)


def shapes(body, on=None):
    """Return loaded and unloaded positions, and the energies of the loaded shape."""
    X, solver = body.discretization.space.positions, Equilibrium(TOLERANCE, on=on)
    x, _ = solver.loaded(body, X, GRAVITY)
    up, _ = solver.unloaded(body, X, 0.25 * GRAVITY)
    return {"loaded": x, "unloaded": up, "energy": body.strain_energy(X, x), "potential": body.potential(X, x, GRAVITY)}


def shared_shapes():
    out = {}
    for method in METHODS:
        part = shared(breast(), world())
        found = shapes(part, PetscEngine(layout_of(part.discretization), method))
        out |= {f"{method} {name}": value for name, value in found.items()}
    return out


def downhill():
    """Test the fallback, damped Newton from the unloaded shape, with an element without tissue."""
    whole = breast()
    fraction = whole.fraction.copy()
    fraction[::50] = 0.0
    body = shared(whole.with_tissue(whole.law, whole.density, fraction), world())
    found = Downhill(1e-8, on=PetscEngine(layout_of(body.discretization))).loaded(
        body, body.discretization.space.positions, 0.3 * GRAVITY
    )[0]
    return {"found": found}


class Downhill(Equilibrium):
    """Equilibrium that uses only the last fallback."""

    def _newton(self, problem, report):
        raise ConvergenceError("not tried", ["not tried"])


def matrices():
    """Return matrices that are definite, indefinite, unsymmetric and singular; the last gets a NaN (90, 90)."""
    rng = np.random.default_rng(0)
    A = sp.random(3 * N, 3 * N, 0.1, random_state=1).toarray()
    definite = A @ A.T + 0.5 * np.eye(3 * N)
    singular = definite.copy()
    singular[5], singular[:, 5] = 0.0, 0.0
    return {
        "definite": definite,
        "indefinite": definite - 2.0 * np.eye(3 * N),
        "general": definite + 0.1 * np.triu(rng.standard_normal((3 * N, 3 * N))),
        "singular": singular,
        "not finite": definite,
    }


def blocks(matrix):
    """Return the blocks of this rank; all ranks have the whole pattern."""
    ranks = world()
    share = (ranks.rank + 1) / sum(range(1, ranks.size + 1))
    data = (share * matrix).reshape(N, 3, N, 3).transpose(0, 2, 1, 3).reshape(-1, 3, 3).copy()
    return sp.bsr_array((data, np.tile(np.arange(N), N), N * np.arange(N + 1)), shape=matrix.shape)


def systems():
    """Return for each matrix and method the solution, whether it was found definite, and what was refused."""
    ranks, rhs, out = world(), np.linspace(-1.0, 1.0, 3 * N), {}
    positions = np.random.default_rng(2).standard_normal((N, 3))
    layout = Layout(ranks, np.random.default_rng(1).integers(0, ranks.size, N), positions)
    for method in METHODS:
        for name, matrix in matrices().items():
            solver, whole = LinearSolver(on=PetscEngine(layout, method)), blocks(matrix)
            near = (lambda: blocks(0.5 * (matrix + matrix.T))) if name == "general" else None  # noqa: B023
            if name == "not finite" and ranks.rank == ranks.size - 1:
                whole.data[0, 0, 0] = np.nan  # only one rank knows
            try:
                out[f"{method} {name}"] = solver.solve(whole, rhs, 1e-12, near)
            except FloatingPointError as error:
                out[f"{method} {name}"] = str(error)
                continue
            out[f"{method} {name} is definite"] = name != "general" and solver.is_definite(whole)
            other = LinearSolver(on=PetscEngine(layout, method))
            other.restore(whole, solver.state_arrays())
            other_matrix = blocks(1.01 * matrix)
            again = [which.solve(other_matrix, rhs, 1e-12, near) for which in (solver, other)]
            out[f"{method} {name} again"], out[f"{method} {name} restored"] = again
            for which in (solver, other):
                which.reset()
    return out


if __name__ == "__main__":
    found = {"shapes": shared_shapes, "systems": systems, "downhill": downhill}[sys.argv[1]]()
    alike = set(world().gather(repr({name: np.asarray(value).tobytes() for name, value in found.items()}).encode()))
    assert len(alike) == 1  # to the bit
    if world().is_first:
        np.savez(sys.argv[2], **found)
