"""Cavity that surgery leaves in a body, and the body with a given amount of new tissue in that cavity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ..materials.active import Contraction
from ..materials.compose import Sum
from ..materials.exponential import Exponential
from ..materials.growth import NaturalConfiguration
from ..materials.ligaments import Ligaments
from ..mechanics.body import Body, deformation_gradients

MIN_FILLED = 0.05  # elements with a smaller share of tissue are left out of the mechanics


@dataclass(frozen=True, eq=False)
class Tissue:
    """Elastic constants and density of a tissue at quadrature points, each a number or an (n_elements, n_qp) array.

    The law is :class:`..materials.exponential.Exponential`, in parallel with ligaments if there are any.
    """

    mu: np.ndarray
    """Shear modulus [kPa]."""
    kappa: np.ndarray
    """Bulk modulus [kPa]."""
    stiffening: np.ndarray
    """Exponent b of the exponential law [1]; 0 is neo-Hookean."""
    density: np.ndarray
    """Mass per reference volume [kg/mm^3]."""
    ligaments: Ligaments | None = None
    """Ligaments, with a share of the volume per quadrature point; None without."""


@dataclass(frozen=True, eq=False)
class Cavity:
    """The body before surgery, the elements that surgery removes, and the constants of the tissue that replaces them.

    Parameters
    ----------
    intact : Body
        The body before surgery.
    X : (n_nodes, 3) array [mm]
        Unloaded shape of the body: the reference of the mechanics and of the lattice.
    elements : (n_elements,) bool array
        Elements that surgery removes.
    tissue, scar : Tissue
        Tissue before surgery, and the tissue that grows in the cavity.
    contraction : float [kPa]
        Active tension of new tissue.
    contents : float [1]
        What fills the empty cavity: stiffness and weight of its elements without tissue, relative to scar. 0: a void, whose
        walls may pass through each other.
    """

    intact: Body
    X: np.ndarray
    elements: np.ndarray
    tissue: Tissue
    scar: Tissue
    contraction: float = 0.0
    contents: float = 0.0

    @cached_property
    def density(self) -> np.ndarray:
        """Mass per reference volume, with scar instead of the removed tissue in the cavity (n_elements, n_qp) [kg/mm^3]."""
        return np.where(self.elements[:, None], self.scar.density, self.tissue.density)

    @property
    def unstrained(self) -> np.ndarray:
        """Natural configuration of tissue that is stress-free in the unloaded shape (n_elements, n_qp, 3, 3) [1]."""
        space = self.intact.discretization.space
        return np.broadcast_to(np.eye(3), (space.n_elements, space.table.weight.size, 3, 3))

    def body(self, filled: np.ndarray, natural: np.ndarray) -> Body:
        """Return the body with a given fraction of tissue in each element.

        Tissue fractions ``filled`` (n_elements,) [1], natural configuration (n_elements, n_qp, 3, 3) [1]. Stiffness and weight
        of an element are scaled by its tissue fraction. Elements below ``MIN_FILLED`` are left out, and so is an element that
        touches the rest at a corner only, because it could rotate freely; with ``contents``, these have that fraction instead.
        """
        fraction = np.where(self._supported(filled >= MIN_FILLED), filled, np.where(self.elements, self.contents, 0.0))
        is_new = self.elements[:, None]
        tension = np.where(is_new, self.contraction, 0.0) * np.ones_like(self.tissue.mu)
        return self.intact.with_tissue(tissue_law(self.present, tension, natural), self.density, fraction)

    @cached_property
    def present(self) -> Tissue:
        """Tissue of the body after surgery: new tissue, which has no ligaments, in the cavity, the old tissue elsewhere."""
        is_new, old, new = self.elements[:, None], self.tissue, self.scar
        mu, kappa, stiffening = (
            np.where(is_new, getattr(new, name), getattr(old, name)) for name in ("mu", "kappa", "stiffening")
        )
        ligaments = old.ligaments
        if ligaments is not None:
            ligaments = replace(ligaments, share=np.where(is_new, 0.0, ligaments.share))
        return Tissue(mu, kappa, stiffening, self.density, ligaments)

    def _supported(self, chosen: np.ndarray) -> np.ndarray:
        """Return the chosen elements that are connected through shared sides to tissue outside the cavity (n_elements,) bool."""
        inner, outer = self.intact.discretization.space.neighbours
        sides = chosen[inner] & chosen[outer]
        n = chosen.size
        graph = sp.coo_array((np.ones(np.count_nonzero(sides)), (inner[sides], outer[sides])), shape=(n, n))
        _, part = connected_components(graph, directed=False)
        return chosen & np.isin(part, part[~self.elements & chosen])

    def deformation(self, x: np.ndarray) -> np.ndarray:
        """Return the deformation gradient F, scaled so that det F is the body's volume ratio, which is linear in each element.

        Positions x (n_nodes, 3) [mm] -> (n_elements, n_qp, 3, 3) [1].
        """
        F = deformation_gradients(self.intact.discretization.space, self.X, x)
        return np.cbrt(self.intact.volume_ratio(self.X, x) / np.linalg.det(F))[..., None, None] * F


def tissue_law(tissue: Tissue, contraction: np.ndarray, natural: np.ndarray) -> NaturalConfiguration:
    """Return the constitutive law of existing and new tissue; one form for both avoids recompilation as tissue grows.

    Active tension ``contraction`` (n_elements, n_qp) [kPa], natural configuration (n_elements, n_qp, 3, 3) [1].
    """
    passive = Exponential(tissue.mu, tissue.stiffening, tissue.kappa)
    ligaments = () if tissue.ligaments is None else (tissue.ligaments,)
    return NaturalConfiguration(Sum((passive, *ligaments, Contraction(contraction))), natural)
