"""Carry a deformation into the open cavity, where there is no tissue to compute it."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import splu

from ..materials.neo_hookean import NeoHookean
from .body import Body, Frame


class Extension:
    """Smooth continuation of displacements into elements that no tissue fills.

    A compressible linear elastic filling of the open elements follows the tissue and never acts on it: its nodes are
    solved for afterwards, with the tissue's nodes given. It gives new tissue the deformation that it is born with, and
    pictures the shape of the cavity.

    Parameters
    ----------
    frame : Frame
        Space and supports.
    X : (n_nodes, 3) array [mm]
        Unloaded positions.
    """

    def __init__(self, frame: Frame, X: np.ndarray) -> None:
        filling = Body(
            frame,
            law=NeoHookean(1.0, 1.0),
            density=np.zeros((frame.space.n_elements, frame.space.table.weight.size)),
            fraction=np.ones(frame.space.n_elements),
            skin=NeoHookean(0.0, 0.0),
            skin_thickness=np.zeros(len(frame.skin_facets)),
        )
        self._frame, self._X, self._filling = frame, X, filling

    def fill(self, x: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """Positions with the open nodes moved along: x (n_nodes, 3) [mm], fraction (n_elements,) -> (n_nodes, 3) [mm]."""
        nodes = self._frame.space.element_nodes
        held = np.zeros(self._frame.space.n_nodes, bool)
        held[nodes[fraction > 0.0]] = True
        if held.all():
            return x
        filling = self._filling.with_tissue(self._filling.law, self._filling.density, (fraction == 0.0).astype(float))
        free, _ = self._frame.solved(False)
        K = filling.tangent(self._X, self._X, np.zeros(3), by="x", in_plane=False)
        open_dofs = ~np.repeat(held, 3)[free]
        u = (x - self._X).reshape(-1)[free]
        u[open_dofs] = splu(K[open_dofs][:, open_dofs].tocsc()).solve(-K[open_dofs][:, ~open_dofs] @ u[~open_dofs])
        out = x.copy()
        out.reshape(-1)[free] = self._X.reshape(-1)[free] + u
        return out
