"""Pictures of a solid breast: planes through the image, the shaded surface, energy in planes through the cavity, closure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ...coupling.ruler import Ruler
from ...geometry.cuts import plane_cut
from ...geometry.section import Section
from ...geometry.tetrahedra import area_vectors
from ...geometry.transfer import EIGHTHS
from ...outcome.closure import wound_centre
from .body import Anatomy
from .figures_section import BEFORE, TISSUE_COLOURS, WOUND, closure_curves
from .solid import SolidModel

SKIN = np.array([0.93, 0.78, 0.70])
LIGHT = np.array([-0.35, -0.8, 0.55])  # direction towards the light, LPS
# the planes shown: axis that is constant, horizontal and vertical axis, whether the vertical one points down
SHOWN = {"axial": (2, 0, 1, True), "sagittal": (0, 1, 2, False)}
NAMES = ("left", "posterior", "superior")


def anatomy_figure(model: SolidModel, anatomy: Anatomy) -> Figure:
    """Draw planes through the resection as imaged: the image with tissue classes, and the mesh with the removed tissue."""
    figure = Figure(figsize=(12, 10), layout="constrained")
    axes = figure.subplots(2, 2)
    for column, plane in enumerate(SHOWN):
        for row in range(2):
            _picture(axes[row, column], model, anatomy, plane, tissue=row == 0)
    axes[0, 0].legend(loc="lower right", fontsize=8)
    axes[1, 0].legend(loc="lower right", fontsize=8)
    figure.suptitle(f"{model.space.n_elements} tetrahedra; planes through the centre of the resection")
    return figure


def _picture(ax: Axes, model: SolidModel, anatomy: Anatomy, plane: str, *, tissue: bool) -> None:
    axis, first, second, _ = SHOWN[plane]
    section = Section(plane, float(model.centre_mm[axis]))
    raster = section.raster(anatomy.labels, min(*anatomy.labels.spacing_mm, 1.0))
    points = section.to_patient(raster.points)
    picture = anatomy.image.sample(points) if anatomy.image is not None else anatomy.labels.sample(points, order=0)
    ax.imshow(picture, extent=raster.extent, cmap="gray", vmin=0, vmax=np.percentile(picture, 99.5))
    if tissue:
        shares = anatomy.probabilities.sample(points)
        for share, (label, colour) in zip(shares, TISSUE_COLOURS.items()):
            if (share > 0.5).any():
                ax.contour(*np.moveaxis(raster.points, -1, 0), share, [0.5], colors=[colour], linewidths=0.8)
            ax.plot([], [], color=colour, label=label.name.lower())
    else:
        cut, owner = plane_cut(model.x_imaged, model.space.element_nodes[:, :4], axis, section.position_mm)
        edge = np.where(model.cavity[owner][:, None], _rgb(WOUND), _rgb("#56b4e9"))
        ax.add_collection(PolyCollection(cut[..., [first, second]], facecolors="none", edgecolors=edge, linewidths=0.3))
        ax.plot([], [], color=WOUND, label="resection")
        ax.plot([], [], color="#56b4e9", label="mesh")
    ax.set_title(f"{plane}, {'tissue classes' if tissue else 'mesh'}")
    _dress(ax, plane, model.x_imaged)


def energy_figure(model: SolidModel, panels: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    """Map strain energy density in planes through the cavity: title -> (x [mm], energy (n_elements,) [kPa], is shown)."""
    figure = Figure(figsize=(5 * len(panels), 9.5), layout="constrained")
    axes = figure.subplots(len(SHOWN), len(panels), squeeze=False)
    top = max(np.percentile(W[shown], 98) for _, W, shown in panels.values())
    drawn = ScalarMappable(Normalize(0.0, top), "viridis")
    pieces = model.space.element_nodes[:, EIGHTHS].reshape(-1, 4)
    shapes = np.concatenate([x for x, _, _ in panels.values()])
    for (title, (x, W, shown)), column in zip(panels.items(), axes.T):
        centre = x[np.unique(model.space.element_nodes[model.cavity])].mean(axis=0)
        for ax, (plane, (axis, first, second, _)) in zip(column, SHOWN.items()):
            cut, owner = plane_cut(x, pieces, axis, centre[axis])
            element = owner // len(EIGHTHS)
            kept = shown[element]
            colours = drawn.to_rgba(W[element[kept]])
            ax.add_collection(
                PolyCollection(cut[kept][..., [first, second]], facecolors=colours, edgecolors=colours, linewidths=0.2)
            )
            rim = _cut_lines(x, model.cavity_triangles, axis, centre[axis])
            ax.plot(*np.moveaxis(rim[..., [first, second]], -1, 0).transpose(0, 2, 1), color=WOUND, linewidth=1.0)
            ax.set_title(f"{title}, {plane} at {centre[axis]:.0f} mm")
            _dress(ax, plane, shapes)
    axes[0, 0].plot([], [], color=WOUND, label="edge of the resection")
    axes[0, 0].legend(loc="lower right", fontsize=8)
    figure.colorbar(drawn, ax=axes, label="strain energy density [kPa]", shrink=0.7)
    return figure


def surface_figure(
    model: SolidModel, shapes: Mapping[str, tuple[np.ndarray, np.ndarray]], last: str, side: str
) -> Figure:
    """Draw the skin from the front and the side, by patient position: (before, after surgery) (n_nodes, 3) [mm] each."""
    figure = Figure(figsize=(15, 4.4 * len(shapes)), layout="constrained")
    axes = figure.subplots(len(shapes), 4, squeeze=False)
    retraction = {position: model.retraction(*pair) for position, pair in shapes.items()}
    skin = model.triangles[model.on_skin]
    top = max(max(np.abs(r[skin]).max() for r in retraction.values()), 0.1)
    drawn = ScalarMappable(Normalize(-top, top), "RdBu_r")
    for row, (position, (before, after)) in zip(axes, shapes.items()):
        healed = drawn.to_rgba(retraction[position][skin].mean(axis=1))[:, :3]
        both = np.vstack([before[skin].reshape(-1, 3), after[skin].reshape(-1, 3)])
        for k, view in enumerate(("front", "side")):
            for ax, x, colour, name in ((row[2 * k], before, SKIN, "before"), (row[2 * k + 1], after, healed, last)):
                _shaded(ax, model, x, colour, view, side)
                ax.set_title(f"{position}, {name}, from the {view}")
                _frame(ax, _seen(both, view, side)[..., :2])
    figure.colorbar(drawn, ax=axes, label="skin inward of where it was [mm]", shrink=0.8)
    return figure


def _shaded(ax: Axes, model: SolidModel, x: np.ndarray, colours: np.ndarray, view: str, side: str) -> None:
    """Draw the skin shaded by a light from the upper front, from far to near triangles, and mark nipple and cavity."""
    triangles = model.triangles[model.on_skin]
    normals = area_vectors(x, triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    light = 0.6 + 0.4 * np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    seen = _seen(x, view, side)
    order = np.argsort(seen[triangles, 2].mean(axis=1))
    shown = np.clip(np.broadcast_to(colours, (len(triangles), 3)) * light[:, None], 0.0, 1.0)[order]
    ax.add_collection(PolyCollection(seen[triangles[order], :2], facecolors=shown, edgecolors=shown, linewidths=0.3))
    ax.plot(*seen[model.nipple, :2], "o", color=BEFORE, markersize=4)
    centre = seen[np.unique(model.space.element_nodes[model.cavity])].mean(axis=0)
    ax.plot(*centre[:2], "x", color=WOUND, markersize=9, markeredgewidth=2)


def _seen(x: np.ndarray, view: str, side: str) -> np.ndarray:
    """Convert LPS positions to components to the right, upwards and towards the viewer: (..., 3) [mm] -> (..., 3) [mm]."""
    if view == "front":
        return np.stack([x[..., 0], x[..., 2], -x[..., 1]], axis=-1)
    outward = 1.0 if side == "left" else -1.0
    return np.stack([outward * x[..., 1], x[..., 2], outward * x[..., 0]], axis=-1)


def _frame(ax: Axes, points: np.ndarray) -> None:
    low, high = points.min(axis=0) - 5.0, points.max(axis=0) + 5.0
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[], aspect="equal")
    scale = np.array([low[0] + 3.0, low[0] + 23.0])
    ax.plot(scale, [low[1] + 3.0] * 2, color="black", linewidth=2)
    ax.text(scale.mean(), low[1] + 5.0, "20 mm", ha="center", fontsize=7)


def closure_figure(model: SolidModel, ruler: Ruler, fronts: list[np.ndarray], rows: list[dict], title: str) -> Figure:
    """Draw the wound's outline in an axial layer of sites through its centre, cycle by cycle, and closure over time."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    lattice = ruler.lattice
    layer = int(wound_centre(ruler.open0)[0])
    index = np.stack(np.meshgrid([layer], *map(np.arange, lattice.shape[1:]), indexing="ij"), axis=-1)[0]
    positions = lattice.position(index)
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, max(len(fronts), 2)))
    for is_open, colour in zip(fronts, colours):
        if is_open.any():
            left.contour(
                positions[..., 0], positions[..., 1], is_open.astype(float), [0.5], colors=[colour], linewidths=1
            )
    near = positions[fronts[0]]
    left.set(xlim=(near[:, 0].min() - 3, near[:, 0].max() + 3), ylim=(near[:, 1].min() - 3, near[:, 1].max() + 3))
    left.set_title(f"{title}: axial layer at z = {round(float(positions[0, 0, 2]))} mm, unloaded", fontsize=9)
    _dress(left, "axial", None)
    closure_curves(right, rows)
    return figure


def _cut_lines(points: np.ndarray, triangles: np.ndarray, axis: int, position: float) -> np.ndarray:
    """Intersect triangles with the plane at ``position`` [mm] along ``axis``: end points of the segments (k, 2, 3) [mm]."""
    order = np.argsort(points[triangles, axis], axis=1)
    corners = np.take_along_axis(triangles, order, axis=1)
    height = points[corners, axis] - position
    cut = (height[:, 0] < 0.0) & (height[:, 2] >= 0.0)
    corners, height = corners[cut], height[cut]
    lone = np.where(height[:, 1] < 0.0, 2, 0)
    row = np.arange(len(corners))
    ends = []
    for other in (1, 2 - lone):
        a, b = height[row, lone], height[row, other]
        share = (a / np.where(a == b, 1.0, a - b))[:, None]
        ends.append((1.0 - share) * points[corners[row, lone]] + share * points[corners[row, other]])
    return np.stack(ends, axis=1)


def _dress(ax: Axes, plane: str, points: np.ndarray | None) -> None:
    """Set equal scales and axis labels with units; posterior points down or to the right."""
    _, first, second, downward = SHOWN[plane]
    ax.set(aspect="equal", xlabel=f"{NAMES[first]} [mm]", ylabel=f"{NAMES[second]} [mm]")
    if points is not None:
        low, high = points.min(axis=0) - 5.0, points.max(axis=0) + 5.0
        ax.set(xlim=(low[first], high[first]), ylim=(low[second], high[second]))
    if ax.yaxis_inverted() != downward:
        ax.invert_yaxis()


def _rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
