"""What the surgeon sees: the numbers that compare a healed shape with the one before."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ShapeChange:
    """A healed outline or surface against that before surgery, in the same position."""

    volume_change_percent: float
    """Change of the volume (a section's area) that skin and chest wall enclose [%]."""
    nipple_displacement_mm: float
    """Distance the nipple has moved, all three components [mm]."""
    surface_retraction_max_mm: float
    """Largest inward distance of the skin from the old outline or surface [mm]."""
    surface_retraction_rms_mm: float
    """Root mean square distance of the skin from the old one, in either direction, by length or area [mm]."""
    concavity_depth_mm: float
    """Increase of the deepest dent below the convex hull; of a surface, the largest increase anywhere on the skin [mm]."""
