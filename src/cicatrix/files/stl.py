"""Writing of surfaces for 3-D printing and planning software: binary STL files in millimetres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..geometry.tetrahedra import area_vectors
from .atomic import write_bytes

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def write_stl(path: Path, points: np.ndarray, triangles: np.ndarray) -> None:
    """Write triangles (k, 3), counter-clockwise from outside, with points (n, 3) [mm], as an STL file, atomically."""
    normals = area_vectors(points, triangles)
    facets = np.zeros(len(triangles), FACET)
    facets["normal"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    facets["corners"] = points[triangles]
    header = b"cicatrix surface, millimetres".ljust(80)
    write_bytes(path, header + np.array(len(facets), "<u4").tobytes() + facets.tobytes())
