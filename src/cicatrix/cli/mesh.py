"""``cicatrix mesh LABELS --out body.vtu``: tetrahedra of a labelled breast with their tissue."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..core.errors import InputError


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("mesh", help="tetrahedra of a labelled breast, for cases of kind equilibrium")
    parser.add_argument(
        "labels", metavar="LABELS", type=Path, help="label map: 0 air, 1 fat, 2 gland, 3 skin, 4 tumour"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="VTU file to write; must not exist")
    parser.add_argument("--edge-mm", type=float, default=5.0, help="element edge [mm], 5 by default")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Mesh and write; returns the exit code."""
    from ..files.images import read_labels
    from ..files.meshes import write_body
    from ..image.segment import from_labels  # only this verb needs them, and they take a second to load
    from ..kinds.lumpectomy.body import Anatomy
    from ..kinds.lumpectomy.case import Tissue
    from ..kinds.lumpectomy.meshed_labels import meshed_labels

    out: Path = args.out
    if out.suffix != ".vtu":
        raise InputError(f"--out: {out.name} must end in .vtu.")
    if out.exists():
        raise InputError(f"--out: {out.name} is there already; give a new name.")
    found = from_labels(read_labels(args.labels))
    mesh, E, nu, density = meshed_labels(Anatomy(None, found.labels, found.probabilities), args.edge_mm, Tissue())
    write_body(out, mesh, E, nu, density)
    for note in (*found.notes, *mesh.notes):
        print(note)
    quality = mesh.quality
    print(
        f"{len(mesh.tetrahedra)} tetrahedra, {len(mesh.nodes)} nodes; least angle {quality.least_dihedral_deg:.1f} degrees, "
        f"volume off by {100 * quality.volume_error:+.2f} %, skin by {quality.skin_distance:.2f} mm"
    )
    return 0
