"""Digital phantom "half-ellipsoid": a synthetic breast MRI with known labels, as patient images cannot be distributed."""

from __future__ import annotations

import numpy as np
from scipy import ndimage as ndi

from ..core.errors import InputError
from ..geometry.labels import Label
from ..geometry.volume import Volume
from .anatomy import MIDLINE_MM, MUSCLE_MM, RIB_MM, WALL_RADIUS_MM, PhantomAnatomy, draw
from .trunk import NO_TRUNK, Trunk

SIZE_MM = (120.0, 75.0, 110.0)  # width, depth and height of the breast
LEAST_SIZE_MM, LARGEST_SIZE_MM = 30.0, 250.0
FLANK_MM = 36.0  # width of chest in the image on both sides of the breast
AIR_MM = 16.0  # depth of air in front of the nipple
ABOVE_MM = 18.0  # height of chest above and below the breast
BEYOND_MM = 12.0  # width of chest beyond a trunk
BEHIND_MM = MUSCLE_MM + RIB_MM + 24.0  # depth of the chest behind the breast's centre
SUBSAMPLE_MM = 0.8  # largest distance of the points over which a voxel is averaged
CHUNK = 16384  # points per batch, so that work arrays fit into the cache
LABEL_OF = np.array([0, 1, 2, 3, 4, 5, 5, 5, 5, 5], np.uint8)  # Part -> Label

# Brightness of each Part in arbitrary scanner units; relative values as in prone T1 TSE and SPAIR images. The tumour in the
# fat-saturated image has the brightness after contrast agent.
BRIGHTNESS = {
    "t1": np.array([0, 900, 300, 360, 250, 900, 360, 270, 520, 40], np.float32),
    "t1-fatsat": np.array([0, 50, 150, 190, 320, 50, 190, 115, 70, 15], np.float32),
}
NOISE = {"t1": 20.0, "t1-fatsat": 5.0}  # standard deviation of each channel of the complex signal


def phantom(
    *,
    spacing_mm: float | tuple[float, float, float] = 1.0,
    seed: int = 0,
    weighting: str = "t1",
    side: str = "left",
    size_mm: tuple[float, float, float] = SIZE_MM,
    trunk: Trunk = NO_TRUNK,
    gland_fraction: float | None = None,
    tumour_diameter_mm: float = 14.0,
    tumour_centre_mm: tuple[float, float, float] | None = None,
    bias: float = 0.25,
    noise: float = 1.0,
) -> tuple[Volume, Volume]:
    """Generate an image of one breast with the surrounding chest, and its true labels.

    The anatomy has skin of 1.45 mm, fat, irregular gland lobes radiating from the nipple, a tumour, pectoral muscle, ribs
    and lung behind a curved wall. Voxels are averages over sub-voxel points (partial volume), multiplied by a smooth bias
    field, with Rician noise. A seed gives the same anatomy at every voxel size, and the same bytes at equal voxel size.

    Parameters
    ----------
    spacing_mm : float or (3,) tuple
        Voxel edge along x, y, z [mm].
    seed : int
        Seed of the anatomy, the bias field and the noise.
    weighting : str
        "t1" (fat bright) or "t1-fatsat" (fat dark, tumour enhanced).
    side : str
        Patient's side, "left" (breast centre at x > 0) or "right".
    size_mm : (3,) tuple
        Width, depth (AP) and height of the breast [mm].
    trunk : Trunk
        Margins of trunk around the breast that the field of view shows at least.
    gland_fraction : float, optional
        Fraction of the breast inside the skin that is gland; default: drawn from 15-25 %.
    tumour_diameter_mm, tumour_centre_mm : float, (3,) tuple, optional
        Mean diameter (0 for none), and centre in image coordinates [mm]; default centre: in the upper outer quadrant.
    bias : float
        Amplitude of the logarithm of the bias field.
    noise : float
        Factor on the standard noise of the weighting.

    Returns
    -------
    image : Volume
        (nz, ny, nx) float32.
    labels : Volume
        (nz, ny, nx) uint8 of `Label`: the label that fills most of the voxel.

    Raises
    ------
    InputError
        If weighting or side is unknown, or size or spacing is out of range.
    """
    spacing = np.broadcast_to(np.asarray(spacing_mm, float), 3)
    _check(spacing, size_mm, weighting, side)
    streams = [np.random.Generator(np.random.Philox(s)) for s in np.random.SeedSequence(seed).spawn(3)]
    medial, shift = _medial(side), _shift(side)
    half_axes = np.array([size_mm[0] / 2, size_mm[1], size_mm[2] / 2])
    anatomy = draw(streams[0], half_axes, medial, gland_fraction, None, tumour_diameter_mm / 2)
    if tumour_centre_mm is not None:
        anatomy = _with_tumour_at(anatomy, np.asarray(tumour_centre_mm, float) - shift)
    grid = phantom_grid(spacing_mm=spacing_mm, side=side, size_mm=size_mm, trunk=trunk)
    clean, labels = _average(anatomy, grid, shift, BRIGHTNESS[weighting])
    image = _scan(clean, grid, bias, noise * NOISE[weighting], streams[1], streams[2])
    return grid.with_values(image), grid.with_values(labels)


def _medial(side: str) -> float:
    """Return the sign of x towards the patient's midline."""
    return -1.0 if side == "left" else 1.0


def _shift(side: str) -> np.ndarray:
    """Return the breast's centre (3,) LPS [mm]; the patient's midline is at x = 0."""
    return np.array([-_medial(side) * MIDLINE_MM, 0.0, 0.0])


def _check(spacing: np.ndarray, size_mm: tuple[float, float, float], weighting: str, side: str) -> None:
    """Check weighting, side, size and spacing."""
    if weighting not in BRIGHTNESS:
        raise InputError(f'phantom: weighting must be "t1" or "t1-fatsat", got "{weighting}".')
    if side not in ("left", "right"):
        raise InputError(f'phantom: side must be "left" or "right", got "{side}".')
    if not (np.all(spacing > 0) and np.all(spacing <= 10)):
        raise InputError(f"phantom: spacing_mm must lie in (0, 10], got {spacing.tolist()}.")
    if min(size_mm) < LEAST_SIZE_MM or max(size_mm) > LARGEST_SIZE_MM:
        least, most = f"{LEAST_SIZE_MM:g}", f"{LARGEST_SIZE_MM:g}"
        raise InputError(f"phantom: size_mm must lie in [{least}, {most}] along each axis, got {list(size_mm)}.")


def _with_tumour_at(anatomy: PhantomAnatomy, point: np.ndarray) -> PhantomAnatomy:
    """Return the anatomy with its tumour moved to a point (3,) in the anatomy's coordinates x, y, z [mm]."""
    height = float(anatomy.height(point[:, None])[0])
    return PhantomAnatomy(**{**vars(anatomy), "tumour_centre_mm": np.array([point[0], height, point[2]])})


def phantom_grid(
    *,
    spacing_mm: float | tuple[float, float, float] = 1.0,
    side: str = "left",
    size_mm: tuple[float, float, float] = SIZE_MM,
    trunk: Trunk = NO_TRUNK,
) -> Volume:
    """Return an empty image volume (nz, ny, nx) float32 of :func:`phantom`'s field of view, with its voxels."""
    spacing = np.broadcast_to(np.asarray(spacing_mm, float), 3)
    low, high = (corner + _shift(side) for corner in _field_of_view(side, size_mm, trunk))
    nx, ny, nz = np.round((high - low) / spacing).astype(int)
    sx, sy, sz = spacing.tolist()
    ox, oy, oz = (low + spacing / 2).tolist()
    return Volume(np.zeros((nz, ny, nx), np.float32), (sx, sy, sz), (ox, oy, oz))


def _field_of_view(side: str, size_mm: tuple[float, float, float], trunk: Trunk) -> tuple[np.ndarray, np.ndarray]:
    """Return the low and the high corner of the field of view, from the breast's centre on the wall: two (3,) [mm].

    It shows the breast with a frame of chest, and more where a trunk needs it; the wall recedes to the lateral side.
    """
    medial, lateral = (max(FLANK_MM, margin + BEYOND_MM) for margin in (trunk.medial_mm, trunk.lateral_mm))
    below, above = (max(ABOVE_MM, margin + BEYOND_MM) for margin in (trunk.below_mm, trunk.above_mm))
    flanks = (medial, lateral) if side == "left" else (lateral, medial)
    half_width, depth, half_height = size_mm[0] / 2, size_mm[1], size_mm[2] / 2
    outermost = MIDLINE_MM + half_width + trunk.lateral_mm
    recedes = (outermost**2 - MIDLINE_MM**2) / (2 * WALL_RADIUS_MM[0]) + BEYOND_MM if trunk.lateral_mm else 0.0
    low = np.array([-half_width - flanks[0], -depth - AIR_MM, -half_height - below])
    high = np.array([half_width + flanks[1], max(BEHIND_MM, recedes), half_height + above])
    return low, high


def _average(
    anatomy: PhantomAnatomy, grid: Volume, shift: np.ndarray, brightness: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean brightness and most frequent label of each voxel: two (nz, ny, nx) arrays, float32 and uint8.

    Only voxels whose tissue at the centre differs from that of one of their 26 neighbours are averaged over sub-voxel points.
    """
    index = np.indices(grid.shape, np.int32).reshape(3, -1)
    part = _parts_at(anatomy, grid, shift, index, np.zeros(3)).reshape(grid.shape)
    clean, labels = brightness[part], LABEL_OF[part]
    mixed = np.flatnonzero(ndi.maximum_filter(part, 3) != ndi.minimum_filter(part, 3))
    counts = np.maximum(np.ceil(np.asarray(grid.spacing_mm) / SUBSAMPLE_MM).astype(int), 2)
    offsets = (np.stack(list(np.ndindex(*counts))) + 0.5) / counts - 0.5
    votes = np.zeros((len(Label), len(mixed)), np.uint16)
    total = np.zeros(len(mixed), np.float32)
    for offset in offsets:
        here = _parts_at(anatomy, grid, shift, index[:, mixed], offset)
        total += brightness[here]
        votes[LABEL_OF[here], np.arange(len(mixed))] += 1
    clean.ravel()[mixed] = total / len(offsets)
    labels.ravel()[mixed] = votes.argmax(axis=0)
    return clean, labels


def _parts_at(
    anatomy: PhantomAnatomy, grid: Volume, shift: np.ndarray, index: np.ndarray, offset: np.ndarray
) -> np.ndarray:
    """Return the tissue at voxels (3, n) z, y, x, shifted by a fraction (3,) x, y, z of a voxel: (n,) uint8 of `Part`."""
    step = np.asarray(grid.spacing_mm)
    low = (np.asarray(grid.origin_mm) - shift + offset * step).astype(np.float32)[:, None]
    scale = step.astype(np.float32)[:, None]
    out = np.empty(index.shape[1], np.uint8)
    for start in range(0, len(out), CHUNK):
        chunk = slice(start, start + CHUNK)
        out[chunk] = anatomy.parts(low + scale * index[::-1, chunk].astype(np.float32))
    return out


def _scan(
    clean: np.ndarray, grid: Volume, bias: float, sigma: float, field_rng: np.random.Generator, rng: np.random.Generator
) -> np.ndarray:
    """Return the image with bias field and Rician noise of standard deviation ``sigma``, from the clean image (nz, ny, nx)."""
    z, y, x = (np.linspace(-1, 1, n, dtype=np.float32) for n in grid.shape)
    basis = [
        x,
        y[:, None],
        z[:, None, None],
        x * y[:, None],
        x**2 - 1 / 3,
        y[:, None] ** 2 - 1 / 3,
        z[:, None, None] * x,
    ]
    weights = field_rng.uniform(-1, 1, len(basis)).astype(np.float32)
    field = sum((w * b for w, b in zip(weights, basis)), np.zeros(grid.shape, np.float32))
    field *= bias / max(float(np.abs(field).max()), 1e-6)
    signal = clean.astype(np.float32) * np.exp(field)
    real = signal + sigma * rng.standard_normal(grid.shape, dtype=np.float32)
    imaginary = sigma * rng.standard_normal(grid.shape, dtype=np.float32)
    return np.hypot(real, imaginary)
