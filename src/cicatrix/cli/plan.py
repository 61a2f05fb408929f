"""``cicatrix plan``: a local page on which a resection is placed, saved as a case, run and watched."""

from __future__ import annotations

import argparse
import tempfile
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError

if TYPE_CHECKING:
    from ..pages.planning import PlanningTable

MOST_VOXELS = 40_000_000  # a larger image is thinned while it is read: planning needs millimetres


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    words = "a page of this machine alone: move the resection, save the case, run it, watch it"
    parser = verbs.add_parser("plan", help=words, allow_abbrev=False)
    parser.add_argument(
        "image",
        metavar="IMAGE",
        nargs="?",
        type=Path,
        help="NIfTI, NRRD, MHA or a DICOM folder; without it the phantom",
    )
    parser.add_argument("--labels", metavar="FILE", type=Path, help="a label map, instead of segmenting the image")
    parser.add_argument("--weighting", choices=("t1", "t1-fatsat"), default="t1")
    parser.add_argument("--side", choices=("left", "right"), default="left", help="the patient's side")
    parser.add_argument("--position", choices=("prone", "supine", "upright"), default="prone", help="how she lay")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("plan"), help="where cases and runs go (default: plan)"
    )
    parser.add_argument("--port", type=int, default=0, help="of the page's address (default: any that is free)")
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    parser.set_defaults(run=run, after_interruption="; the planning page is closed, a run that worked kept its state")


def run(args: argparse.Namespace) -> int:
    """Segment, serve until interrupted."""
    from ..pages.server import Planner, PlanServer  # only this verb needs them, and they take seconds to load

    if args.out.is_file():
        raise InputError(f"--out: {args.out} is a file; give a folder")
    table = build_table(args.image, args.labels, weighting=args.weighting, side=args.side, position=args.position)
    with tempfile.TemporaryDirectory() as site:
        planner = Planner(table, args.out.resolve(), Path(site))
        try:
            server = PlanServer(planner, args.port)
        except (OSError, OverflowError) as error:
            raise InputError(
                f"--port: {args.port} cannot be had ({error}); leave it out for one that is free"
            ) from None
        print(f"planning page: {server.address}\nCtrl-C closes it", flush=True)
        if not args.no_browser:
            webbrowser.open(server.address)
        try:
            server.serve_forever()
        finally:
            planner.job.stop()
            server.server_close()
    return 0


def build_table(
    image: Path | None,
    labels: Path | None = None,
    *,
    weighting: str = "t1",
    side: str = "left",
    position: str = "prone",
) -> PlanningTable:
    """Read and segment an image, or take its labels as given; without an image, the phantom.

    Raises
    ------
    InputError
        If the image cannot be read or shows no breast.
    """
    from ..files.images import read_labels, read_thinned
    from ..files.pictures import picture
    from ..image.phantom import phantom
    from ..image.segment import from_labels, segment
    from ..kinds.lumpectomy.case import Image, Run
    from ..pages.planning import PlanningTable
    from ..pages.slices import thin_labels

    keys = {"side": side, "weighting": weighting, "position": position}
    if image is None:
        if labels is not None:
            raise InputError("--labels needs an IMAGE beside it")
        voxel, seed = Image(phantom="half-ellipsoid").voxel_mm, Run().seed
        made, truth = phantom(spacing_mm=voxel, seed=seed, weighting=weighting, side=side)
        return PlanningTable(picture(made)[0], thin_labels(truth), {"phantom": "half-ellipsoid", **keys}, ())
    volume, thinned = read_thinned(image, MOST_VOXELS)
    shown, also_thinned = picture(volume)
    keys |= {"path": image.resolve()}
    if labels is not None:
        found = from_labels(read_labels(labels))
        keys |= {"labels": labels.resolve()}
    else:
        print("segmenting ...", flush=True)
        found = segment(volume, weighting=weighting, side=side, position=position)
    notes = [note for note in (thinned, also_thinned, *found.notes) if note]
    return PlanningTable(shown, thin_labels(found.labels), keys, tuple(notes))
