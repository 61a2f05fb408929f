"""Measures that compare the healed shape with the shape before surgery."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ShapeChange:
    """Differences between a healed outline or surface and that before surgery, in the same patient position."""

    volume_change_percent: float
    """Change of the volume (in a section, the area) enclosed by skin and chest wall [%]."""
    nipple_displacement_mm: float
    """Magnitude of the nipple's displacement, all three components [mm]."""
    surface_retraction_max_mm: float
    """Largest inward displacement of the skin, measured from its outline or surface before surgery [mm]."""
    surface_retraction_rms_mm: float
    """Root mean square distance of the skin from the skin before surgery, either way, weighted by length or area [mm]."""
    concavity_depth_mm: float
    """Increase of the depth below the convex hull [mm]: of the greatest depth in a section; largest on the skin of a solid."""
