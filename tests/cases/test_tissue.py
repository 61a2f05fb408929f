"""Tissue of a lumpectomy: from tables to laws at points, ligaments and their direction, positions, priors of the defaults."""

import dataclasses

import jax
import numpy as np
import pytest
import skfem
from coarse_lumpectomy import stiff_tissue

from cicatrix.core.positions import POSITIONS, down
from cicatrix.coupling.cavity import Cavity
from cicatrix.geometry.tetrahedra import with_middles
from cicatrix.kinds.lumpectomy.body import skin_law
from cicatrix.kinds.lumpectomy.build import breast_model, breast_model_from_arrays
from cicatrix.kinds.lumpectomy.case import (
    ImageTable,
    LigamentsTable,
    LumpectomyCase,
    MeshTable,
    ResectionTable,
    TissueTable,
)
from cicatrix.kinds.lumpectomy.ligaments import direction
from cicatrix.kinds.lumpectomy.priors import PRIORS, Prior, draws
from cicatrix.kinds.lumpectomy.sources import value_at
from cicatrix.materials.exponential import Exponential
from cicatrix.materials.ligaments import Ligaments
from cicatrix.materials.locking_skin import LockingSkin
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.mechanics.space import SolidSpace, Space

CASE = LumpectomyCase(image=ImageTable(phantom="half-ellipsoid"))


def case_of(tissue, side="left"):
    return LumpectomyCase(
        image=ImageTable(labels="not-read.nii", side=side),
        tissue=tissue,
        resection=ResectionTable(radius_mm=5.0),
        mesh=MeshTable(edge_mm=8.0, cavity_edge_mm=3.0),
    )


@pytest.fixture(scope="module")
def soft(half_disc):
    return breast_model(case_of(TissueTable()), half_disc(20.0))


def test_tables_become_laws_at_points(soft):
    """By hand: mu = 0.3 / (2 * 1.495) in fat; kappa = E / 0.03 = 10.0 in fat, but never below 10, and 72 in the tumour."""
    exponential, ligaments, _ = soft.intact.law.law.parts
    assert isinstance(exponential, Exponential)
    assert isinstance(ligaments, Ligaments)
    least, most = exponential.mu.min(), exponential.mu.max()
    assert least == pytest.approx(0.3 / 2.99, rel=1e-12)
    assert 0.3 / 2.99 < most <= 2.16 / 2.99
    assert exponential.kappa.min() == pytest.approx(10.0, rel=1e-12)
    assert (exponential.b == 2.0).all()
    assert isinstance(soft.intact.skin, LockingSkin)
    assert soft.intact.skin_prestretch == 1.1


def test_tissue_is_never_more_compressible_than_asked(half_disc):
    softer = TissueTable.model_validate({"fat": {"E_kPa": 0.15}, "ligaments": {"share": 0.0}})
    for floor, expected in ((10.0, 10.0), (0.0, 5.0)):
        model = breast_model(case_of(softer.model_copy(update={"least_bulk_modulus_kPa": floor})), half_disc(20.0))
        assert model.tissue.kappa.min() == pytest.approx(expected, rel=1e-12)


def test_without_stiffening_locking_and_ligaments_the_tissue_is_neo_hookean(half_disc):
    """The tissue that earlier results were computed with is still there: 3.25 kPa, neo-Hookean skin of 56 kPa."""
    model = breast_model(case_of(stiff_tissue()), half_disc(20.0))
    exponential, _ = model.intact.law.law.parts
    assert isinstance(model.intact.skin, NeoHookean)
    assert model.intact.skin.mu == pytest.approx(56.0 / 2.99, rel=1e-12)
    assert model.intact.skin_prestretch == 1.0
    assert exponential.mu.min() == pytest.approx(3.25 / 2.99, rel=1e-12)
    F = np.eye(3) + 0.2 * np.random.default_rng(1).uniform(-1, 1, (*exponential.mu.shape, 3, 3))
    old = NeoHookean(exponential.mu, exponential.kappa)
    np.testing.assert_allclose(
        exponential.response(F).A, old.response(F).A, rtol=0, atol=1e-13 * exponential.kappa.max()
    )


def test_skin_in_case_files_is_the_law_of_the_gallery():
    skin = skin_law(TissueTable().skin)
    assert (skin.mu, skin.stiff, skin.steepness) == (4.0 / 2.99, 43.0, 8.0)
    assert (skin.locking_stretch, skin.kappa) == (1.1 * 1.25, pytest.approx(4.0 / 0.03))  # beyond the prestretch


def test_the_cavity_has_no_ligaments_and_the_scar_s_own_stiffening(soft):
    scar = dataclasses.replace(soft.scar, stiffening=np.asarray(0.5))
    cavity = Cavity(soft.intact, soft.x_imaged, soft.cavity, soft.tissue, scar)
    exponential, ligaments, _ = cavity.body(np.ones(len(soft.cavity)), cavity.unstrained).law.law.parts
    assert (ligaments.share == np.where(soft.cavity[:, None], 0.0, 0.01)).all()
    assert (exponential.b == np.where(soft.cavity[:, None], 0.5, 2.0)).all()
    assert exponential.mu[soft.cavity] == pytest.approx(0.58 / 2.99, rel=1e-12)


def test_a_stored_model_has_the_same_law_to_the_bit(soft):
    again = breast_model_from_arrays(case_of(TissueTable()), soft.arrays())
    for a, b in zip(jax.tree.leaves(soft.intact.law), jax.tree.leaves(again.intact.law), strict=True):
        assert np.array_equal(a, b)


def test_ligaments_run_from_wall_to_skin(soft):
    """In a half disc on a flat chest: outwards at the skin, straight forward in the middle, never along the wall."""
    _, ligaments, _ = soft.intact.law.law.parts
    at = soft.intact.discretization.space
    points = np.einsum("qa,eai->eqi", at.table.value, at.positions[at.element_nodes])
    a = np.stack(ligaments.direction, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(a, axis=-1), 1.0, rtol=1e-12)
    forward = soft.from_patient(np.array([0.0, -1.0, 0.0]))
    middle = np.abs(points[..., 0]) < 2.0
    assert (a[middle] @ forward > 0.95).all()
    assert (a @ forward > 0.0).all()


def box(n):
    """Return a section (0..1) x (0..1), with nodes of its lower and its upper side."""
    space = Space(skfem.MeshTri.init_tensor(np.linspace(0, 1, n), np.linspace(0, 1, n)))
    return space, *(np.flatnonzero(space.positions[:, 1] == y) for y in (0.0, 1.0))


def test_direction_across_a_slab_is_exact():
    found = direction(*box(4))
    np.testing.assert_allclose(found, np.broadcast_to([0.0, 1.0, 0.0], found.shape), atol=1e-12)


def test_direction_across_a_slab_of_tetrahedra_is_exact():
    mesh = skfem.MeshTet.init_tensor(*3 * [np.linspace(0.0, 1.0, 3)])
    space = SolidSpace(*with_middles(mesh.p.T, mesh.t.T))
    sides = [np.flatnonzero(space.positions[:, 2] == z) for z in (0.0, 1.0)]
    found = direction(space, *sides)
    np.testing.assert_allclose(found, np.broadcast_to([0.0, 0.0, 1.0], found.shape), atol=1e-12)


def test_direction_between_two_circles_converges_to_the_radius():
    """A quarter ring between radii 1 and 2, whose harmonic function is ln r / ln 2: its gradient is radial."""
    errors = []
    for n in (5, 9, 17):
        mesh = skfem.MeshTri.init_tensor(np.linspace(0, 1, n), np.linspace(0, 1, n))
        r, angle = 1.0 + mesh.p[1], 0.5 * np.pi * mesh.p[0]
        space = Space(skfem.MeshTri(np.stack([r * np.cos(angle), r * np.sin(angle)]), mesh.t))
        corners = np.unique(space.corners)
        radius = np.linalg.norm(space.positions, axis=1)
        inner, outer = (corners[np.isclose(radius[corners], end)] for end in (1.0, 2.0))
        found = direction(space, inner, outer)
        points = np.einsum("qa,eai->eqi", space.table.value, space.positions[space.element_nodes])
        radial = points / np.linalg.norm(points, axis=-1, keepdims=True)
        errors.append(np.abs(np.linalg.norm(np.cross(found, radial), axis=-1)).max())
    assert errors[-1] < 0.05
    assert errors[0] / errors[2] > 3.0  # of first order at the sides without a given value


def test_gravity_in_every_position():
    """LPS: prone to the front (-y), supine to the back, upright to the feet; lying on the other side towards that side."""
    assert {p: down(p, "left") for p in POSITIONS} == {
        "prone": (0, -1, 0),
        "supine": (0, 1, 0),
        "supine-arms-up": (0, 1, 0),
        "upright": (0, 0, -1),
        "lateral": (-1, 0, 0),  # from the left breast to the right
    }
    assert down("lateral", "right") == (1, 0, 0)


def test_lying_on_the_side_pulls_from_the_treated_breast_to_the_other(half_disc):
    for side, sign in (("left", -1.0), ("right", 1.0)):
        model = breast_model(case_of(stiff_tissue(), side), half_disc(20.0))
        expected = sign * 9806.65 * model.from_patient(np.array([1.0, 0.0, 0.0]))
        np.testing.assert_allclose(model.gravity("lateral"), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("prior", "share", "value"),
    [
        (Prior("lognormal", 2.0, 0.7), 0.8413447460685429, 2.0 * np.exp(0.7)),  # one sigma above the median
        (Prior("normal", 1.1, 0.05), 0.15865525393145707, 1.05),
        (Prior("uniform", 1.1, 1.4), 0.25, 1.175),
        (Prior("fixed", 1.0), 0.9, 1.0),
    ],
    ids=lambda one: getattr(one, "kind", ""),
)
def test_quantiles_of_priors_by_hand(prior, share, value):
    assert prior.at(np.array([share]))[0] == pytest.approx(value, rel=1e-9)


def test_defaults_are_the_medians_of_their_priors():
    for key, prior in PRIORS.items():
        if key.startswith("tissue"):
            whole = 1.0 if prior.times is None else value_at(CASE, prior.times)
            assert value_at(CASE, key) == pytest.approx(prior.median * whole, rel=1e-12), key


def test_sources_name_the_prior_beside_the_source():
    said = CASE.sources()
    assert said["tissue.fat.E_kPa"].endswith("; prior: log-normal, median 0.3, sigma 0.6")
    assert said["tissue.skin.locking_stretch"].endswith("; prior: uniform, 1.1 to 1.4")
    assert "log-normal, median 1.2, sigma 0.5 times tissue.fat.E_kPa" in said["tissue.gland.E_kPa"]
    assert "prior" not in said["tissue.fat.nu"]


def test_draws_are_the_same_for_a_seed_stratified_and_fit_for_a_case():
    n = 64
    drawn, again, other = draws(n, 7), draws(n, 7), draws(n, 8)
    assert drawn.keys() == PRIORS.keys()
    assert all(np.array_equal(drawn[key], again[key]) for key in drawn)
    assert not np.array_equal(drawn["tissue.fat.E_kPa"], other["tissue.fat.E_kPa"])
    stratum = np.floor(n * (drawn["tissue.skin.locking_stretch"] - 1.1) / 0.3).astype(int)
    assert sorted(stratum) == list(range(n))
    np.testing.assert_array_equal(drawn["tissue.gland.stiffening"], drawn["tissue.fat.stiffening"])
    ratio = drawn["tissue.gland.E_kPa"] / drawn["tissue.fat.E_kPa"]
    assert np.log(ratio).std() == pytest.approx(0.5, rel=0.05)
    for row in range(n):
        tables: dict = {}
        for key, values in drawn.items():
            table, *rest = key.removeprefix("tissue.").split(".")
            if key.startswith("tissue"):
                tables.setdefault(table, {})[rest[0]] = float(values[row])
        TissueTable.model_validate(tables)


def test_without_a_share_there_are_no_ligaments(half_disc):
    tissue = TissueTable(ligaments=LigamentsTable(share=0.0))
    assert breast_model(case_of(tissue), half_disc(20.0)).tissue.ligaments is None
