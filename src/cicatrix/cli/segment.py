"""``cicatrix segment IMAGE --out DIR``: labels, probabilities and a picture of one breast."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError

if TYPE_CHECKING:
    from ..image.segment import Segmentation


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("segment", help="labels and tissue probabilities of one breast from an MRI")
    parser.add_argument("image", metavar="IMAGE", type=Path, help="NIfTI, NRRD or MHA file, or a DICOM folder")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to write; must not exist or be empty"
    )
    parser.add_argument("--weighting", choices=("t1", "t1-fatsat"), default="t1")
    parser.add_argument("--side", choices=("left", "right"), default="left", help="the patient's side")
    parser.add_argument("--position", choices=("prone", "supine", "upright"), default="prone")
    parser.add_argument(
        "--chest-wall-plane",
        nargs=6,
        type=float,
        metavar=("X", "Y", "Z", "NX", "NY", "NZ"),
        help="a point [mm, LPS] and a normal, instead of the automatic chest wall",
    )
    parser.add_argument(
        "--resection-centre",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="mark a bright mass here as tumour [mm]",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Segment and write; the folder appears only when everything in it is whole. Returns the exit code."""
    from ..files.images import read_image
    from ..image.segment import segment  # only this verb needs them, and they take a second to load

    out: Path = args.out
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"--out: {out.name} already holds something; give a new or empty folder.")
    plane = args.chest_wall_plane
    wall = {"point_mm": plane[:3], "normal": plane[3:]} if plane else None
    centre = tuple(args.resection_centre) if args.resection_centre else None
    image = read_image(args.image)
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
    """Write beside the target, then rename."""
    from ..files.figures_image import draw_preview
    from ..files.images import write_volume

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
