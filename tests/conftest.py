"""Fixtures that several groups of tests share: case files, and small bodies on small meshes."""

import ctypes
import gc
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import skfem

from cicatrix.geometry.labels import TISSUES, Label
from cicatrix.geometry.volume import Volume
from cicatrix.kinds.lumpectomy.body import Anatomy
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.mechanics.body import Body, Discretization
from cicatrix.mechanics.space import Space

gc.set_threshold(
    50_000, 20, 50
)  # objects that JAX traces stay alive; frequent garbage collection takes a seventh of the time
MAX_RESIDENT_BYTES = 1_500_000_000  # resident in one process, after which it forgets what it compiled


@pytest.fixture(scope="module", autouse=True)
def _forget_compiled():
    """Give memory back after a module: JAX keeps everything that it has traced and compiled, some 10 MB per test second."""
    yield
    if sys.platform != "linux":
        return
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * 4096
    if resident > MAX_RESIDENT_BYTES:
        jax.clear_caches()
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)  # glibc keeps what is freed


@pytest.fixture(scope="session")
def rectangle():
    """Return irregular triangles on a rectangle: (width, height, nx, ny) [mm] -> mesh; inner vertices are moved by up to 15 %."""

    def make(width, height, nx, ny):
        mesh = skfem.MeshTri.init_tensor(np.linspace(0, width, nx + 1), np.linspace(0, height, ny + 1))
        p = mesh.p.copy()
        inner = mesh.interior_nodes()
        cell = np.array([[width / nx], [height / ny]])
        p[:, inner] += 0.15 * cell * np.random.default_rng(3).uniform(-1, 1, (2, inner.size))
        return skfem.MeshTri(p, mesh.t)

    return make


@pytest.fixture(scope="session")
def body_on():
    """Return a body on a mesh, fixed where ``is_fixed`` is true for edge midpoints (2, n), with skin on every outer edge."""

    def make(mesh, law, is_fixed, *, density=1e-6, fraction=None, skin=1.0, thickness=0.0):
        space = Space(mesh)
        facets = mesh.boundary_facets()
        held = facets[is_fixed(mesh.p[:, mesh.facets[:, facets]].mean(axis=1))]
        discretization = Discretization(space, facets, np.unique(space.facet_nodes(held)))
        return Body(
            discretization,
            law=law,
            density=np.full((space.n_elements, space.table.weight.size), density),
            fraction=np.ones(space.n_elements) if fraction is None else fraction,
            skin=NeoHookean(skin, 1.0),
            skin_thickness=np.full(len(facets), thickness),
        )

    return make


@pytest.fixture(scope="session")
def slope():
    """Return the fourth-order finite difference at 0 of a function of one number: (function, h) -> value or array."""

    def make(function, h):
        values = [function(k * h) for k in (-2, -1, 1, 2)]
        return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)

    return make


@pytest.fixture(scope="session")
def rates_along(slope):
    """Return a body's matrix times a random direction of its free dofs, and the difference of its residual along it.

    (body, X, x, gravity, unknown, rng, in_plane) -> two (n_free,) arrays; ``unknown`` is "loaded" or "unloaded".
    """

    def make(body, X, x, gravity, unknown, rng, *, in_plane=False):
        J, free = body.volume_ratio(X, x), body.discretization.solved(in_plane)[0]
        if unknown == "loaded":
            matrix, _ = body.linearised(X, x, J, in_plane=in_plane)
        else:
            matrix, _ = body.linearised_reference(X, x, J, gravity, in_plane=in_plane)
        direction = np.zeros(x.size)
        direction[free] = rng.standard_normal(free.size)
        d = direction.reshape(x.shape)
        dX, dx = (0, d) if unknown == "loaded" else (d, 0)
        difference = slope(lambda t: body.residual(X + t * dX, x + t * dx, gravity).ravel()[free], 1e-4)
        return matrix @ direction[free], difference

    return make


@pytest.fixture
def case_file(tmp_path):
    """Write a case file to a folder of its own: text -> path."""

    def write(text, name="case.toml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@pytest.fixture(scope="session")
def half_disc():
    """Return a half-disc breast of fat (y < 0) on a flat chest, with a small tumour."""

    def make(radius_mm=30.0, tumour=True, chest=True):
        z, y, x = np.meshgrid(
            np.arange(-4.0, 5.0, 2.0), np.arange(-39.0, 12.0, 2.0), np.arange(-40.0, 41.0, 2.0), indexing="ij"
        )
        labels = np.where((x**2 + y**2 < radius_mm**2) & (y < 0), Label.FAT, Label.AIR).astype(np.uint8)
        if tumour:
            labels[x**2 + (y + 13.0) ** 2 + z**2 < 3.5**2] = Label.TUMOUR
        if chest:
            labels[y > 0] = Label.CHEST
        volume = Volume(labels, (2.0, 2.0, 2.0), (-40.0, -39.0, -4.0))
        shares = np.stack([labels == label for label in TISSUES]).astype(float)
        return Anatomy(None, volume, volume.with_values(shares))

    return make
