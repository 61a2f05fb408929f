"""Figures of a plane section, in the style of Garbey et al., Figs 2, 5 and 6, in colours safe for colour-blind readers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...coupling.cavity import MIN_FILLED
from ...geometry.hexgrid import Lattice
from ...geometry.labels import Label
from ...mechanics.body import Body
from .body import Anatomy
from .section import SectionModel

BEFORE, HEALED, WOUND = "#000000", "#d62728", "#e69f00"
TISSUE_COLOURS = {Label.FAT: "#f0e442", Label.GLAND: "#0072b2", Label.SKIN: "#cc79a7", Label.TUMOUR: "#d55e00"}

BORDERS = {  # of a section: colour and words
    "skin": (TISSUE_COLOURS[Label.SKIN], "skin"),
    "wall": ("#009e73", "chest wall (fixed)"),
    "rim": ("#000000", "where the body ends (fixed)"),
}


def section_figure(model: SectionModel, anatomy: Anatomy) -> Figure:
    """Draw the section as imaged: image, tissue classes, mesh and cavity."""
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    axes = figure.subplots(1, 2)
    raster = model.section.raster(anatomy.labels, min(*anatomy.labels.spacing_mm, 1.0))
    points = model.section.to_patient(raster.points)
    picture = anatomy.image.sample(points) if anatomy.image is not None else anatomy.labels.sample(points, order=0)
    for ax in axes:
        top = np.percentile(picture, 99.5)
        ax.imshow(picture, extent=raster.extent, cmap="gray", vmin=0, vmax=top)
        _dress(ax, model)
    shares = anatomy.probabilities.sample(points)
    for channel, (label, colour) in enumerate(TISSUE_COLOURS.items()):
        if (shares[channel] > 0.5).any():
            axes[0].contour(
                raster.points[..., 0], raster.points[..., 1], shares[channel], [0.5], colors=[colour], linewidths=0.8
            )
            axes[0].plot([], [], color=colour, label=label.name.lower())
    axes[0].legend(loc="lower right", fontsize=8)
    axes[0].set_title("tissue classes")
    mesh = model.mesh
    axes[1].triplot(*mesh.p, mesh.t.T, color="#56b4e9", linewidth=0.25)
    axes[1].triplot(*mesh.p, mesh.t.T[model.cavity], color=WOUND, linewidth=0.4)
    for name, (colour, words) in BORDERS.items():
        facets = mesh.boundaries[name]
        if len(facets):
            axes[1].plot(*mesh.p[:, mesh.facets[:, facets]], color=colour, linewidth=1.5)
            axes[1].plot([], [], color=colour, label=words)
    axes[1].plot([], [], color=WOUND, label="resection")
    axes[1].legend(loc="lower right", fontsize=8)
    axes[1].set_title(f"mesh, {mesh.nelements} triangles")
    _zoom(axes, mesh.p.T)
    return figure


def energy_figure(model: SectionModel, panels: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    """Map strain energy density on loaded shapes: title -> (positions [mm], energy of elements [kPa], is shown)."""
    figure = Figure(figsize=(5 * len(panels), 5), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)
    top = max(np.percentile(W[shown], 98) for _, W, shown in panels.values())
    triangles = model.intact.discretization.space.element_nodes[:, :3]
    for ax, (title, (x, W, shown)) in zip(axes[0], panels.items()):
        drawn = ax.tripcolor(x[:, 0], x[:, 1], triangles[shown], W[shown], vmin=0, vmax=top, cmap="viridis")
        ax.plot(*_closed(x[model.outline, :2]).T, color=BEFORE, linewidth=0.8)
        ax.set_title(title)
        _dress(ax, model)
    _zoom(axes[0], np.concatenate([x[triangles.ravel(), :2] for x, _, _ in panels.values()]))
    figure.colorbar(drawn, ax=axes, label="strain energy density [kPa]", shrink=0.8)
    return figure


def energy_panel(body: Body, X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the data of a panel of ``energy_figure``: positions x, mean energy density [kPa] and whether there is tissue."""
    return x, body.energy_density(X, x).mean(axis=1), body.fraction >= MIN_FILLED


def edge_figure(profiles: Mapping[str, tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]]) -> Figure:
    """Plot strain energy density W along the cavity's edge: title -> ((angle, W) before surgery, (angle, W) after)."""
    columns = min(3, len(profiles))
    rows = -(-len(profiles) // columns)
    figure = Figure(figsize=(4.2 * columns, 3 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for ax, (name, (before, after)) in zip(axes.flat, profiles.items()):
        ax.plot(*before, color=BEFORE, label="before surgery")
        ax.plot(*after, color=HEALED, label="after surgery")
        ax.set_title(name)
        ax.set_xticks(range(0, 361, 90))
        ax.grid(alpha=0.3)
    for ax in axes.flat[len(profiles) :]:
        ax.remove()
    for ax in axes.flat[max(len(profiles) - columns, 0) : len(profiles)]:
        ax.tick_params(labelbottom=True)
        ax.set_xlabel("angle around the cavity [degrees]")
    for ax in axes[:, 0]:
        ax.set_ylabel("strain energy density [kPa]")
    axes[0, 0].legend()
    return figure


def closure_figure(
    model: SectionModel, lattice: Lattice, fronts: Iterable[np.ndarray], rows: list[dict], title: str
) -> Figure:
    """Draw the wound's outline at the end of each cycle (Garbey et al., Fig. 5), and closure over time."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    positions = lattice.positions()
    fronts = list(fronts)
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, max(len(fronts), 2)))
    for is_open, colour in zip(fronts, colours):
        if is_open.any():
            left.contour(
                positions[..., 0], positions[..., 1], is_open.astype(float), [0.5], colors=[colour], linewidths=1.0
            )
    left.set_title(title)
    _dress(left, model)
    left.autoscale_view()
    closure_curves(right, rows)
    return figure


def closure_curves(right: Axes, rows: list[dict]) -> None:
    """Plot closed fraction, radius of a disc or ball of equal size, and asymmetry over time."""
    days, solid = [r["time_days"] for r in rows], "open_volume_mm3" in rows[0]
    what = "volume" if solid else "area"
    closed = [100 * r["closed_fraction"] for r in rows]
    right.plot(days, closed, "o-", color="#0072b2", label=f"closed [% of the {what}]")
    radius = [np.cbrt(r["open_volume_mm3"]) if solid else np.sqrt(r["open_area_mm2"] / np.pi) for r in rows]
    right.plot(
        days, [100 * q / radius[0] for q in radius], "s--", color=WOUND, label="equivalent radius [% of the first]"
    )
    right.plot(days, [100 * r["wound_asymmetry"] for r in rows], "^:", color="#009e73", label="asymmetry [%]")
    right.set_xlabel("time [days]")
    right.set_ylabel("[%]")
    right.set_ylim(-2, 102)
    right.grid(alpha=0.3)
    right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8, columnspacing=1.0)


def outline_figure(
    model: SectionModel, shapes: Mapping[str, list[tuple[str, np.ndarray]]], cavity: Mapping[str, np.ndarray]
) -> Figure:
    """Draw the outlines of the breast during healing, one panel per patient position (Garbey et al., Fig. 6).

    ``shapes`` has, by patient position, a list of (label, node positions (n_nodes, 3) [mm]), which ends with the healed shape.
    ``cavity`` has, by patient position, the node positions (n_nodes, 3) [mm] from which the edge of the resection is drawn.
    """
    figure = Figure(figsize=(6 * len(shapes), 6), layout="constrained")
    axes = figure.subplots(1, len(shapes), squeeze=False)
    for ax, (position, named) in zip(axes[0], shapes.items()):
        middle = colormaps["viridis"](np.linspace(0.1, 0.9, max(len(named) - 2, 1)))
        for i, (name, x) in enumerate(named):
            first, last = i == 0, i == len(named) - 1
            colour = BEFORE if first else HEALED if last else middle[i - 1]
            width = 2.0 if first or last else 1.0
            ax.plot(
                *_closed(x[model.outline, :2]).T,
                color=colour,
                linewidth=width,
                label=name,
                linestyle="--" if first else "-",
            )
        if position in cavity:
            ends = cavity[position][_cavity_edges(model)]
            ax.plot(ends[..., 0].T, ends[..., 1].T, color=WOUND, linewidth=1.0)
            ax.plot([], [], color=WOUND, label="resection edge, healed")
        ax.set_title(position)
        _dress(ax, model)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=4)
    return figure


def _cavity_edges(model: SectionModel) -> np.ndarray:
    return model.intact.discretization.space.facet_nodes(model.cavity_border)[:, :2]


def _dress(ax: Axes, model: SectionModel) -> None:
    """Set equal scales, axis labels with units, and the orientation of radiology: posterior down, superior up."""
    ax.set_aspect("equal")
    labels = model.section.axis_labels
    ax.set_xlabel(labels[0])
    ax.set_ylabel(labels[1])
    downward = model.section.plane == "axial"
    if ax.yaxis_inverted() != downward:
        ax.invert_yaxis()


def _zoom(axes: Iterable[Axes], points: np.ndarray) -> None:
    low, high = points.min(axis=0) - 5.0, points.max(axis=0) + 5.0
    for ax in axes:
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(*((high[1], low[1]) if ax.yaxis_inverted() else (low[1], high[1])))


def _closed(outline: np.ndarray) -> np.ndarray:
    return np.concatenate([outline, outline[:1]])
