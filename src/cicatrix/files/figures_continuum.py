"""Maps of the fields of the continuum healing model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import CenteredNorm
from matplotlib.figure import Figure

from ..geometry.cuts import plane_cut
from ..healing.continuum import WoundState
from ..healing.transport import Transport

MAPS = {"cells": "viridis", "cytokine": "magma", "collagen": "cividis", "permanent stretch": "coolwarm"}


VIEW_MM = 25.0  # half width of the region of a sheet that is drawn


class View(NamedTuple):
    """Plane and limits of a map of fields: the plane of a sheet, or a plane normal to one axis of a solid."""

    labels: tuple[str, str]
    axis: int = 2
    at_mm: float = 0.0
    window: np.ndarray | None = None
    """Lower and upper corner of the region that is drawn (2, 2) [mm]; None draws the whole body."""
    is_downward: bool = False
    """Whether the vertical axis points down."""


def fields_figure(transport: Transport, state: WoundState, x: np.ndarray, days: float, view: View) -> Figure:
    """Draw maps of cells, cytokine, collagen and permanent stretch on the body deformed to node positions x (n_nodes, 3) [mm]."""
    values = {
        "cells": state.fields[:, 0],
        "cytokine": state.fields[:, 1],
        "collagen": transport.at_vertices(state.local.phi),
        "permanent stretch": transport.at_vertices(np.prod(state.local.stretch, axis=-1)),
    }
    figure = Figure(figsize=(15, 4.0), layout="constrained")
    figure.suptitle(f"after {days:.4g} days, on the deformed body", fontsize=11)
    for ax, (name, field) in zip(figure.subplots(1, 4), values.items()):
        polygons, shown = _polygons(x[transport.vertex_nodes], transport, field, view)
        norm = CenteredNorm(1.0) if name == "permanent stretch" else None  # white: no permanent stretch
        drawn = PolyCollection(
            list(polygons), array=shown, cmap=MAPS[name], norm=norm, edgecolors="face", linewidths=0.2
        )
        drawn.set_rasterized(True)
        ax.add_collection(drawn)
        figure.colorbar(drawn, ax=ax, shrink=0.8)
        ax.set_title(f"{name} [1]", fontsize=10)
        ax.set_aspect("equal")
        ax.set_xlabel(view.labels[0])
        ax.autoscale_view()
        if view.window is not None:
            ax.set_xlim(*view.window[:, 0])
            ax.set_ylim(*view.window[:, 1])
        if view.is_downward:
            ax.invert_yaxis()
    figure.axes[0].set_ylabel(view.labels[1])
    return figure


def _polygons(x: np.ndarray, transport: Transport, field: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Return polygons (n, a, 2) [mm] and the mean of the field in each (n,)."""
    vertices = transport.element_vertices
    if transport.space.n_axes == 2:
        return _parts(x[vertices][..., :2], field[vertices])
    polygons, owner = plane_cut(x, vertices, view.axis, view.at_mm)
    kept = [k for k in range(3) if k != view.axis]
    return polygons[..., kept], field[vertices[owner]].mean(axis=1)


def _parts(corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split plane elements (n, a, 2) into one polygon for each corner; return the polygons and the field's value in each."""
    pieces, shown = [], []
    for k in range(corners.shape[1]):
        ring = [np.roll(part, -k, axis=1) for part in (corners, values)]
        for part, out in zip(ring, (pieces, shown)):
            mid = 0.5 * (part[:, 0] + part[:, 1]), part.mean(axis=1), 0.5 * (part[:, 0] + part[:, -1])
            out.append(np.stack([part[:, 0], *mid], axis=1))
    return np.concatenate(pieces), np.concatenate(shown).mean(axis=1)
