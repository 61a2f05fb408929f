"""``cicatrix mesh LABELS --out body.vtu``: mesh a labelled breast with tetrahedra and give each its tissue."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..core.errors import InputError
from ..files.meshes import write_body
from ..files.segmentations import read_labels
from ..files.segments import names_given
from ..image.segment import from_labels
from ..kinds.lumpectomy.body import Anatomy
from ..kinds.lumpectomy.case import TissueTable
from ..kinds.lumpectomy.meshed_labels import meshed_labels

TISSUE = "tissue: moduli at small strain, the defaults of a lumpectomy; stiffening, ligaments and skin are left out"


def run(args: argparse.Namespace) -> int:
    """Mesh and write; returns the exit code."""
    out: Path = args.out
    if out.suffix != ".vtu":
        raise InputError(f"--out: {out.name} must end in .vtu.")
    if out.exists():
        raise InputError(f"--out: {out.name} already exists; give a new name.")
    notes: list[str] = []
    names = names_given(args.label_name)
    found = from_labels(read_labels(args.labels, names, notes.append, axes=args.axes))
    mesh, E, nu, density = meshed_labels(Anatomy.of(None, found), args.edge_mm, TissueTable())
    write_body(out, mesh, E, nu, density)
    for note in (*notes, *found.notes, TISSUE, *mesh.notes):
        print(note)
    quality = mesh.quality
    print(
        f"{len(mesh.tetrahedra)} tetrahedra, {len(mesh.nodes)} nodes; least dihedral angle {quality.least_dihedral_deg:.1f}°, "
        f"volume error {100 * quality.volume_error:+.2f} %, largest skin distance {quality.skin_distance:.2f} mm"
    )
    return 0
