"""``cicatrix segment IMAGE --out DIR``: segment one breast; write labels, tissue probabilities and a preview picture."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from ..core.errors import InputError
from ..files.figures_image import draw_preview
from ..files.images import read_image, write_volume
from ..image.segment import Segmentation, segment


def run(args: argparse.Namespace) -> int:
    """Segment the image, write the folder and return the exit code; the folder appears only when it is complete."""
    out: Path = args.out
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"--out: {out.name} is not empty; give a new or empty folder.")
    plane = args.chest_wall_plane
    wall = {"point_mm": plane[:3], "normal": plane[3:]} if plane else None
    centre = tuple(args.resection_centre) if args.resection_centre else None
    image = read_image(args.image, note=print, side=args.side, axes=args.axes)
    found = segment(
        image,
        weighting=args.weighting,
        side=args.side,
        position=args.position,
        chest_wall=wall,
        resection_centre_mm=centre,
        report=lambda stage, fraction: print(f"{100 * fraction:3.0f} %  {stage}", file=sys.stderr),
    )
    _write(out, image, found)
    for note in found.notes:
        print(note)
    return 0


def _write(out: Path, image, found: Segmentation) -> None:
    """Write to a temporary folder next to the target, then rename it."""
    out.parent.mkdir(parents=True, exist_ok=True)
    half = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        write_volume(half / "labels.nii.gz", found.labels)
        write_volume(half / "probabilities.nii.gz", found.probabilities)
        draw_preview(half / "preview.png", image, found.labels)
        half.chmod(0o755)
        if out.exists():
            out.rmdir()
        half.rename(out)
    except BaseException:
        shutil.rmtree(half, ignore_errors=True)
        raise
