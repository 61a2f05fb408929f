"""Geometry of the digital breast phantom: the tissue at a point, defined by implicit surfaces [mm]."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

SKIN_MM = 1.45  # thickness of the skin
SUBCUTANEOUS_MM = 11.0  # thickness of skin and fat over the chest beside the breast
FILLET_MM = 8.0  # width of the rounding between breast and chest
NIPPLE_MM = 5.0
MUSCLE_MM = 12.0
RIB_MM = 9.0
WALL_RADIUS_MM = (220.0, 700.0)  # radii of curvature of the chest wall across and along the body
MIDLINE_MM = 78.0  # distance of the breast centre from the midline
N_LOBES = 16


class Part(IntEnum):
    """Tissue of the phantom; finer than `Label`, because the tissues of the chest differ in brightness."""

    AIR = 0
    FAT = 1
    GLAND = 2
    SKIN = 3
    TUMOUR = 4
    CHEST_FAT = 5
    CHEST_SKIN = 6
    MUSCLE = 7
    RIB = 8
    LUNG = 9


@dataclass(frozen=True)
class PhantomAnatomy:
    """Half-ellipsoid breast on a curved chest wall; the nipple points to -y, the origin is the breast's centre on the wall.

    Parameters
    ----------
    half_axes_mm : (3,) array
        Half width (x), depth (y) and half height (z) of the breast [mm].
    medial : float
        -1 if the midline lies towards -x (left breast), +1 if towards +x.
    lobe_axes : (n_lobes, 3) array
        Unit vectors from the nipple into the breast.
    waves, phases : (n_waves, 3) array [1/mm], (n_waves,) array
        Wave vectors and phases of random cosines that make the outlines irregular.
    gland_level : float
        Value of ``lobe_score`` above which the tissue is gland [mm].
    tumour_centre_mm : (3,) array
        Centre of the tumour [mm].
    tumour_radius_mm : float
        Mean radius of the tumour [mm]; 0 for none.
    """

    half_axes_mm: np.ndarray
    medial: float
    lobe_axes: np.ndarray
    waves: np.ndarray
    phases: np.ndarray
    gland_level: float
    tumour_centre_mm: np.ndarray
    tumour_radius_mm: float

    def height(self, p: np.ndarray) -> np.ndarray:
        """Return the height of points in front of the chest wall, along y: points (3, n) [mm] -> (n,) [mm]."""
        across, along = WALL_RADIUS_MM
        x = p[0] - self.medial * MIDLINE_MM
        return (x * x - MIDLINE_MM**2) * (0.5 / across) + p[2] * p[2] * (0.5 / along) - p[1]

    def outside(self, q: np.ndarray) -> np.ndarray:
        """Return the signed distance to the outer surface, negative inside: (3, n) x, height, z [mm] -> (n,) [mm]."""
        breast = _ellipsoid(q, self.half_axes_mm)
        torso = 0.95 * (q[1] - SUBCUTANEOUS_MM)
        return _smooth_union(_smooth_union(breast, self._from_nipple(q) - NIPPLE_MM, 2.0), torso, FILLET_MM)

    def lobe_score(self, q: np.ndarray) -> np.ndarray:
        """Return the depth inside a gland lobe: (3, n) x, height, z [mm] -> (n,) [mm]; negative in the fat between lobes."""
        x, y, z = q[0], q[1] - float(self.half_axes_mm[1] - 2.0), q[2]
        r = np.sqrt(x * x + y * y + z * z)
        cosine = (self.lobe_axes.astype(q.dtype) @ np.stack([x, y, z])).max(axis=0) / np.maximum(r, 1e-3)
        off_axis = r * np.arccos(np.clip(cosine, -1, 1))
        score = 2.0 + 0.05 * r - off_axis + 2.5 * self.roughness(q)
        rim = np.minimum(-_ellipsoid(q, 0.86 * self.half_axes_mm), q[1] - float(0.14 * self.half_axes_mm[1]))
        return np.minimum(score, rim - 3.0)

    def roughness(self, q: np.ndarray) -> np.ndarray:
        """Return a smooth random field of unit variance, a sum of cosines, at points: (3, n) [mm] -> (n,) [1]."""
        angles = self.waves.astype(q.dtype) @ q + self.phases.astype(q.dtype)[:, None]
        return np.cos(angles).sum(axis=0) * float(np.sqrt(2 / len(self.phases)))

    def parts(self, p: np.ndarray) -> np.ndarray:
        """Return the tissue at points: (3, n) [mm] -> (n,) uint8 of `Part`."""
        q = np.stack([p[0], self.height(p), p[2]])
        outside = self.outside(q)
        out = np.full(q.shape[1], Part.AIR, np.uint8)
        inside = outside < 0
        breast = inside & self.is_breast(q)
        chest = inside & ~breast
        out[breast] = self._breast(q[:, breast], -outside[breast])
        out[chest] = self._chest(q[:, chest], -outside[chest])
        return out

    def is_breast(self, q: np.ndarray) -> np.ndarray:
        """Check which points lie in front of the wall and within the base of the breast: (3, n) x, height, z -> (n,) bool."""
        across, up = (float(1 / h**2) for h in self.half_axes_mm[[0, 2]])
        return (q[1] > 0) & (q[0] * q[0] * across + q[2] * q[2] * up < 1)

    def _breast(self, q: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return the tissue at points of the breast (fat, gland, skin, tumour): positions (3, n), depths (n,) [mm] -> (n,)."""
        out = np.where(self.lobe_score(q) > self.gland_level, np.uint8(Part.GLAND), np.uint8(Part.FAT))
        out[self._from_nipple(q) < NIPPLE_MM + 1] = Part.GLAND
        if self.tumour_radius_mm > 0:
            r = np.linalg.norm(q - self.tumour_centre_mm.astype(q.dtype)[:, None], axis=0)
            near = np.flatnonzero(r < 2 * self.tumour_radius_mm)
            limit = self.tumour_radius_mm * (1 + 0.12 * self.roughness(1.5 * q[:, near]))
            out[near[r[near] < limit]] = Part.TUMOUR
        out[depth < SKIN_MM] = Part.SKIN
        return out

    def _chest(self, q: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return the tissue at points of the chest (skin, fat, muscle, rib, lung): positions (3, n), depths (n,) [mm] -> (n,).

        Ribs are 26 mm apart.
        """
        a = q[1]
        out = np.where(a > -MUSCLE_MM - RIB_MM - 4, np.uint8(Part.MUSCLE), np.uint8(Part.LUNG))
        centre = -MUSCLE_MM - RIB_MM / 2
        near = np.flatnonzero(np.abs(a - centre) < RIB_MM / 2)
        along = (np.mod(q[2, near], 26.0) - 13.0) / 6.0
        out[near[((a[near] - centre) / (RIB_MM / 2)) ** 2 + along**2 < 1]] = Part.RIB
        out[a > 0] = Part.CHEST_FAT
        out[(a > 0) & (depth < SKIN_MM)] = Part.CHEST_SKIN
        return out

    def _from_nipple(self, q: np.ndarray) -> np.ndarray:
        """Return the distance of points from the nipple's centre: (3, n) [mm] -> (n,) [mm].

        The coordinates of a point are x, height in front of the chest wall, and z.
        """
        y = q[1] - float(self.half_axes_mm[1])
        return np.sqrt(q[0] * q[0] + y * y + q[2] * q[2])


def draw(
    rng: np.random.Generator,
    half_axes_mm: np.ndarray,
    medial: float,
    gland_fraction: float | None,
    tumour_centre_mm: np.ndarray | None,
    tumour_radius_mm: float,
) -> PhantomAnatomy:
    """Draw a random anatomy: lobes, irregular outlines and, if not given, gland fraction (15-25 %) and tumour position."""
    fraction = rng.uniform(0.15, 0.25)
    fraction = fraction if gland_fraction is None else gland_fraction
    waves = rng.normal(size=(12, 3))
    waves *= 2 * np.pi / (rng.uniform(7, 24, size=(12, 1)) * np.linalg.norm(waves, axis=1, keepdims=True))
    phases = rng.uniform(0, 2 * np.pi, 12)
    side, depth, up = rng.uniform(0.15, 0.4), rng.uniform(0.4, 0.6), rng.uniform(0.05, 0.35)
    place = np.array([-medial * side, depth, up]) * half_axes_mm  # upper outer quadrant, the most common site
    centre = place if tumour_centre_mm is None else tumour_centre_mm
    open_level = PhantomAnatomy(
        half_axes_mm, medial, _lobe_axes(rng), waves, phases, 0.0, np.asarray(centre, float), tumour_radius_mm
    )
    level = _level_for(open_level, fraction, rng)
    return PhantomAnatomy(
        half_axes_mm, medial, open_level.lobe_axes, waves, phases, level, open_level.tumour_centre_mm, tumour_radius_mm
    )


def _lobe_axes(rng: np.random.Generator) -> np.ndarray:
    """Return unit vectors (N_LOBES, 3) from the nipple into the breast.

    They are spread over a cone of half-angle 75 degrees around the breast's axis, and randomly perturbed.
    """
    k = np.arange(N_LOBES)
    polar = np.deg2rad(75) * np.sqrt((k + 0.5) / N_LOBES) + rng.normal(0, 0.05, N_LOBES)
    turn = k * np.pi * (3 - np.sqrt(5)) + rng.normal(0, 0.15, N_LOBES)
    return np.stack([np.sin(polar) * np.cos(turn), -np.cos(polar), np.sin(polar) * np.sin(turn)], axis=-1)


def _level_for(anatomy: PhantomAnatomy, fraction: float, rng: np.random.Generator) -> float:
    """Return the value of ``lobe_score`` [mm] that a given fraction of the breast's volume inside the skin exceeds."""
    q = (rng.uniform(-1, 1, size=(60000, 3)) * anatomy.half_axes_mm).T
    q[1] = np.abs(q[1])
    q = q[:, _ellipsoid(q, anatomy.half_axes_mm) < -SKIN_MM]
    return float(np.quantile(anatomy.lobe_score(q), 1 - fraction))


def _ellipsoid(q: np.ndarray, half_axes: np.ndarray) -> np.ndarray:
    """Return the signed distance of points from an ellipsoid around the origin, to first order: (3, n) [mm] -> (n,) [mm]."""
    inverse = (1 / half_axes**2).astype(q.dtype)
    square = q * q
    k0 = np.sqrt(inverse @ square)
    k1 = np.sqrt(inverse**2 @ square)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-6)


def _smooth_union(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Return the polynomial smooth minimum of two signed distances: the union of both shapes, rounded over ``width`` [mm]."""
    h = np.maximum(width - np.abs(a - b), 0.0)
    return np.minimum(a, b) - h * h / (4 * width)
