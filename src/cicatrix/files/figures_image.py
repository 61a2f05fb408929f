"""Figure of a segmentation: slices of the image with the outlines of its labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..geometry.labels import Label
from ..geometry.volume import Volume

# Okabe-Ito colours, which are safe for colour-blind readers
COLOURS = {Label.GLAND: "#E69F00", Label.SKIN: "#56B4E9", Label.TUMOUR: "#D55E00", Label.CHEST: "#009E73"}
N_AXIAL = 5


def draw_preview(path: str | Path, image: Volume, labels: Volume) -> None:
    """Draw five axial slices and one sagittal slice of the breast into a PNG file, axes in mm: volumes (nz, ny, nx)."""
    breast = (labels.values > Label.AIR) & (labels.values < Label.CHEST)
    figure = Figure(figsize=(15, 8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 3).ravel()
    hit = np.flatnonzero(breast.any(axis=(1, 2)))
    for panel, share in zip(panels, np.linspace(0.15, 0.85, N_AXIAL)):
        k = int(hit[int(share * (len(hit) - 1))])
        _panel(panel, image, labels, 0, k)
    _panel(panels[-1], image, labels, 2, int(np.argmax(breast.sum(axis=(0, 1)))))
    handles = [panels[0].plot([], [], color=c, label=label.name.lower())[0] for label, c in COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _panel(axes, image: Volume, labels: Volume, axis: int, index: int) -> None:
    """Draw one slice, axial (axis 0) or sagittal (axis 2), with the outline of each label."""
    values, tissue = image.values.take(index, axis), labels.values.take(index, axis)
    horizontal, vertical = ("x", "y") if axis == 0 else ("y", "z")
    h, v = (_edges(image, "xyz".index(name)) for name in (horizontal, vertical))
    extent = (h[0], h[-1], v[-1], v[0])
    top = np.percentile(image.values[labels.values > 0], 99)
    axes.imshow(values, cmap="gray", vmin=0, vmax=top, extent=extent, aspect="equal", interpolation="nearest")
    h_mid, v_mid = 0.5 * (h[1:] + h[:-1]), 0.5 * (v[1:] + v[:-1])
    for label, colour in COLOURS.items():
        if (tissue == label).any():
            axes.contour(h_mid, v_mid, (tissue == label).astype(float), levels=[0.5], colors=[colour], linewidths=0.8)
    if vertical == "z":
        axes.invert_yaxis()
    where = image.origin_mm[2 - axis] + index * image.spacing_mm[2 - axis]
    axes.set(xlabel=f"{horizontal} [mm]", ylabel=f"{vertical} [mm]", title=f"{'zyx'[axis]} = {where:.1f} mm")


def _edges(volume: Volume, xyz: int) -> np.ndarray:
    """Return the positions of voxel edges along x, y or z [mm]."""
    n = volume.shape[2 - xyz]
    return volume.origin_mm[xyz] + (np.arange(n + 1) - 0.5) * volume.spacing_mm[xyz]
