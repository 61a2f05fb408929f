"""``cicatrix plan``: open a local page to place a resection, save it as a case, run it and watch the run."""

from __future__ import annotations

import argparse
import tempfile
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..files.images import read_thinned
from ..files.pictures import picture
from ..files.segmentations import read_labels
from ..files.segments import names_given
from ..image.phantom import phantom
from ..image.segment import from_labels, segment
from ..kinds.lumpectomy.anatomy import matched
from ..kinds.lumpectomy.case import ImageTable, LumpectomyRunTable
from ..pages.planner import Planner
from ..pages.planning import PlanningTable
from ..pages.server import PlanServer
from ..pages.slices import thin_labels

MAX_VOXELS = 40_000_000  # larger images are subsampled while they are read; planning needs millimetre resolution only


def run(args: argparse.Namespace) -> int:
    """Segment the image and serve the planning page until interrupted."""
    if args.out.is_file():
        raise InputError(f"--out: {args.out} is a file; give a folder")
    table = build_table(
        args.image,
        args.labels,
        names_given(args.label_name),
        weighting=args.weighting,
        side=args.side,
        position=args.position,
        axes=args.axes,
    )
    with tempfile.TemporaryDirectory() as site:
        planner = Planner(table, args.out.resolve(), Path(site))
        try:
            server = PlanServer(planner, args.port)
        except (OSError, OverflowError) as error:
            raise InputError(f"--port: {args.port} cannot be used ({error}); leave it out to use a free port") from None
        print(f"planning page: {server.address}\nPress Ctrl-C to close it", flush=True)
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
    names: Mapping[str, str] | None = None,
    *,
    weighting: str = "t1",
    side: str = "left",
    position: str = "prone",
    axes: str | None = None,
) -> PlanningTable:
    """Read an image and segment it or read its labels; without an image, use the phantom.

    Raises
    ------
    InputError
        If the image cannot be read or shows no breast, or if there are labels but no image, or names but no labels.
    """
    keys: dict[str, Any] = {"side": side, "weighting": weighting, "position": position}
    if names and labels is None:
        raise InputError("--label-name needs --labels as well")
    if image is None:
        if labels is not None:
            raise InputError("--labels needs an IMAGE as well")
        voxel, seed = ImageTable(phantom="half-ellipsoid").voxel_mm, LumpectomyRunTable().seed
        made, truth = phantom(spacing_mm=voxel, seed=seed, weighting=weighting, side=side)
        return PlanningTable(picture(made)[0], thin_labels(truth), {"phantom": "half-ellipsoid", **keys}, ())
    notes: list[str] = []
    volume = read_thinned(image, MAX_VOXELS, note=notes.append, side=side, axes=axes)
    shown, also_thinned = picture(volume)
    keys |= {"path": image.resolve()} | ({} if axes is None else {"axes": axes})
    if labels is not None:
        found = from_labels(read_labels(labels, names, notes.append, axes=axes))
        notes += matched(found.labels, volume)
        keys |= {"labels": labels.resolve()} | ({"label_names": dict(names)} if names else {})
    else:
        print("segmenting ...", flush=True)
        found = segment(volume, weighting=weighting, side=side, position=position)
    notes += [note for note in (also_thinned, *found.notes) if note]
    return PlanningTable(shown, thin_labels(found.labels), keys, tuple(notes))
