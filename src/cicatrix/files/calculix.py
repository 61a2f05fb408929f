"""Write input files for CalculiX, an open-source finite-element solver with which the mechanics is verified; read its results."""

from __future__ import annotations

import numpy as np

from ..mechanics.body import Body


def calculix_deck(body: Body, gravity: np.ndarray, first: float = 1.0) -> str:
    """Write the input file of a static CalculiX step: a solid of neo-Hookean tissue under gravity.

    The law is C10 (I1_bar - 3) + (J - 1)^2 / D1 with C10 = mu / 2 and D1 = 2 / kappa (CalculiX manual, *HYPERELASTIC); the
    element C3D10 is the quadratic tetrahedron with four quadrature points.

    Parameters
    ----------
    body : Body
        Body of tetrahedra without skin; mu, kappa and density are constant in each element.
    gravity : (3,) array [mm/s^2] Gravitational acceleration.
    first : float [1]
        First load increment, as a fraction of the load; CalculiX reduces it if it does not converge, and chooses the next ones.
    """
    space = body.discretization.space
    law = np.stack([np.broadcast_to(v, body.density.shape)[:, 0] for v in (body.law.mu, body.law.kappa, body.density)])
    kinds, kind = np.unique(law, axis=1, return_inverse=True)
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{i}, {x:.12e}, {y:.12e}, {z:.12e}" for i, (x, y, z) in enumerate(space.positions, 1)]
    for k, (mu, kappa, density) in enumerate(kinds.T):
        lines += [f"*ELEMENT, TYPE=C3D10, ELSET=E{k}"]
        lines += [", ".join(map(str, (i + 1, *space.element_nodes[i] + 1))) for i in np.flatnonzero(kind.ravel() == k)]
        lines += [f"*MATERIAL, NAME=M{k}", "*HYPERELASTIC, NEO HOOKE", f"{mu / 2:.12e}, {2 / kappa:.12e}"]
        lines += ["*DENSITY", f"{density:.6e}", f"*SOLID SECTION, ELSET=E{k}, MATERIAL=M{k}"]
    lines += ["*NSET, NSET=HELD", *(f"{i + 1}," for i in body.discretization.fixed_nodes), "*BOUNDARY", "HELD, 1, 3"]
    lines += [
        "*STEP, NLGEOM, INC=1000",
        "*STATIC",
        f"{first:g}, 1.",
        "*CONTROLS, PARAMETERS=FIELD",
        "1.e-9, 1.e-9",
        "*DLOAD",
    ]
    size = float(np.linalg.norm(gravity))
    along = ", ".join(f"{g:.12e}" for g in np.asarray(gravity) / (size or 1.0))
    lines += [f"E{k}, GRAV, {size:.12e}, {along}" for k in range(kinds.shape[1])]
    return "\n".join([*lines, "*NODE PRINT, NSET=ALL", "U", "*END STEP", ""])


HEADING = "for set ALL and time"  # followed by the fraction of the load, and a row for each node


def calculix_displacements(text: str, n_nodes: int) -> np.ndarray:
    """Read displacements (n_nodes, 3) [mm] under the whole load from CalculiX's output; (0, 3) if it did not reach that load.

    The output has a block for each load increment; the last block is read.
    """
    time, *lines = text.rpartition(HEADING)[2].splitlines() or ["0"]
    rows = [[float(value) for value in line.split()[1:]] for line in lines if line.strip()]
    return np.array(rows) if float(time) == 1.0 and len(rows) == n_nodes else np.zeros((0, 3))
