"""The image and the plan on it, as volumes that a page can slice."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..files.images import read_image, read_labels, write_volume
from ..files.pictures import picture
from ..geometry.labels import Label
from ..geometry.volume import Volume
from .account import Account
from .packing import encoded

EXCISED, MARGIN = 1, 2  # in the volume of zones


def slices_of(account: Account) -> tuple[dict[str, Any] | None, list[str]]:
    """Picture, labels and resection of a lumpectomy, and what is missing of them."""
    if account.kind != "lumpectomy":
        return None, []
    shown, missing = _volumes(account.folder)
    if not shown:
        return None, missing
    centre = account.manifest.get("found", {}).get("resection_centre_mm") or account.asked("resection", "centre_mm")
    radius, margin = (account.asked("resection", f"{name}_mm", default=0.0) for name in ("radius", "margin"))
    if centre is None or not radius:
        missing.append("The run does not tell where the resection lies, so it is not drawn on the slices.")
    else:
        grid = next(iter(shown.values()))
        shown["zones"] = zones(grid, np.array(centre, float), radius, margin)
    return {
        "volumes": {name: encoded(nifti(volume)) for name, volume in shown.items()},
        "labels": [label.name.lower() for label in Label],
        "centre": centre,
        "radius": radius,
        "margin": margin,
        "hasPicture": "picture" in shown,
    }, missing


def _volumes(folder: Path) -> tuple[dict[str, Volume], list[str]]:
    shown, missing = {}, []
    for name, read, lack in (
        ("picture", read_image, "the slices show labels alone"),
        ("labels", read_labels, "the slices show no labels"),
    ):
        path = folder / f"{name}.nii.gz"
        try:
            shown[name] = read(path)
        except InputError as error:
            missing.append(
                f"{lack[0].upper()}{lack[1:]}: {error}" if path.exists() else f"{name}.nii.gz is not there; {lack}."
            )
    if "picture" in shown:
        shown["picture"] = shown["picture"].with_values(shown["picture"].values.astype(np.uint8))
    if "labels" in shown:
        shown["labels"] = thin_labels(shown["labels"])
    return shown, missing


def thin_labels(labels: Volume) -> Volume:
    """Labels on the grid that a picture of them has."""
    grid, _ = picture(labels)
    steps = tuple(round(a / b) for a, b in zip(grid.spacing_mm[::-1], labels.spacing_mm[::-1]))
    return labels.every((steps[0], steps[1], steps[2]))


def zones(grid: Volume, centre: np.ndarray, radius: float, margin: float) -> Volume:
    """Which voxels are taken out, and which of these are the margin that the tumour should keep clear (nz, ny, nx) uint8."""
    z, y, x = (grid.axis(number) for number in range(3))
    away = np.sqrt((z[:, None, None] - centre[2]) ** 2 + (y[:, None] - centre[1]) ** 2 + (x - centre[0]) ** 2)
    out = np.where(away <= radius, np.where(away > radius - margin, MARGIN, EXCISED), 0)
    return grid.with_values(out.astype(np.uint8))


def nifti(volume: Volume) -> bytes:
    """A volume as the bytes of a NIfTI file; its header holds geometry alone."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "volume.nii.gz"
        write_volume(path, volume)
        return path.read_bytes()
