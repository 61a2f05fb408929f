"""Measuring lattice of a wound, the same for every healing model: a lattice over the cavity, and the element of each site."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.hexgrid import Lattice
from ..geometry.transfer import SiteMap, linear_fit
from ..mechanics.body import Body

WELL_FILLED = 0.5  # elements with a smaller share of tissue are too soft to represent the strain that cells sense


@dataclass(frozen=True, eq=False)
class Ruler:
    """Lattice over the cavity in the unloaded reference, which measures how far the wound is filled.

    Parameters
    ----------
    lattice : Lattice
        Positions of the sites.
    sites : SiteMap
        Element of each site.
    fillable : bool array of the lattice's shape
        Sites that lie in the body.
    open0 : bool array of the lattice's shape
        Sites of the fresh wound.
    """

    lattice: Lattice
    sites: SiteMap
    fillable: np.ndarray
    open0: np.ndarray

    def occupancy(self, is_filled: np.ndarray) -> np.ndarray:
        """Return all tissue sites when the wound is filled at the sites ``is_filled``: bool arrays of the lattice's shape."""
        return self.fillable & (is_filled | ~self.open0)

    @property
    def fresh(self) -> np.ndarray:
        """Sites that are tissue when the whole wound is open: bool array of the lattice's shape."""
        return self.fillable & ~self.open0

    def open_sites(self, occupancy: np.ndarray) -> np.ndarray:
        """Return the sites in the body that are not tissue, given those that are: bool arrays of the lattice's shape."""
        return self.fillable & ~occupancy

    def edge_sites(self, occupancy: np.ndarray) -> np.ndarray:
        """Return the tissue sites that have an open neighbour, given all tissue sites: bool arrays of the lattice's shape."""
        return self.lattice.beside(self.open_sites(occupancy)) & occupancy

    def filled(self, occupancy: np.ndarray) -> np.ndarray:
        """Return the filled fraction of each element's sites (n_elements,) [1]; each site counts in exactly one element."""
        total = self.sites.count(self.fillable.ravel())
        return 1.0 - self.sites.count(self.open_sites(occupancy).ravel()) / np.maximum(total, 1)

    def at_sites(self, coefficients: np.ndarray) -> np.ndarray:
        """Evaluate a field, linear in each element, at the sites: (n_elements, 3 or 4) -> array of the lattice's shape."""
        return self.sites.evaluate(coefficients).reshape(self.lattice.shape)

    def energy(self, body: Body, X: np.ndarray, x: np.ndarray, filled: np.ndarray) -> np.ndarray:
        """Return the strain energy density of the tissue at the sites in the reference: array of the lattice's shape [kPa].

        Unloaded and loaded positions X, x (n_nodes, 3) [mm], filled fractions (n_elements,) [1]. Sites in an element filled below
        ``WELL_FILLED`` take the value of the nearest element above this limit: the real tissue of a thinly filled element
        lies along the wall of the cavity, but the homogenised element is so soft that it is strained like a void.
        """
        space = body.discretization.space
        coefficients = linear_fit(body.energy_density(X, x), body.volumes(X), space.table.points)
        held = (body.fraction >= WELL_FILLED) & (filled >= WELL_FILLED)
        centres = X[space.element_nodes[:, : space.n_axes + 1], : space.n_axes].mean(axis=1)
        nearest = np.flatnonzero(held)[cKDTree(centres[held]).query(centres[~held])[1]]
        coefficients[~held] = coefficients[nearest] * np.eye(1, space.n_axes + 1)
        return np.maximum(self.at_sites(coefficients), 0.0)

    def edge_energy(self, body: Body, X: np.ndarray, x: np.ndarray, filled: np.ndarray, occupancy: np.ndarray) -> float:
        """Return the mean of ``energy`` over the edge of the open wound [kPa]; 0 when the wound is closed."""
        edge = self.edge_sites(occupancy)
        return float(self.energy(body, X, x, filled)[edge].mean()) if edge.any() else 0.0
