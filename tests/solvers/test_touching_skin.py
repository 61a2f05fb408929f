"""Equilibrium of bodies whose skin touches: blocks under their weight, and a fold, in sections and solids."""

from dataclasses import replace

import numpy as np
import pytest
import skfem

from cicatrix.core.errors import ConvergenceError
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.body import Body, Discretization
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.self_contact import SkinContact
from cicatrix.mechanics.solids import solid_space
from cicatrix.mechanics.space import Space

DENSITY, G = 1e-6, 9806.65  # kg/mm^3, mm/s^2
WIDE, HIGH, GAP = 20.0, 8.0, 2.0


def _body(discretization, E):
    space = discretization.space
    n_qp, n_facets = space.table.weight.size, len(discretization.skin_facets)
    return Body(
        discretization,
        law=NeoHookean(*moduli_from_young(E, 0.49)),
        density=np.full((space.n_elements, n_qp), DENSITY),
        fraction=np.ones(space.n_elements),
        skin=NeoHookean(1.0, 1.0),
        skin_thickness=np.zeros(n_facets),
        contact=SkinContact(space, discretization.skin_facets),
    )


def _blocks(n_axes):
    """Return a block above another one, which lies on the floor; the upper one may only move up and down, by its sides."""
    widths = [WIDE] * (n_axes - 1)
    grids = *(np.linspace(0, width, 3) for width in widths), np.linspace(0, HIGH, 2)
    block = (skfem.MeshTri if n_axes == 2 else skfem.MeshTet).init_tensor(*grids)
    mesh = block + block.translated((*(0.0 for _ in widths), HIGH + GAP))
    if n_axes == 2:
        space, facets = Space(mesh), mesh.boundary_facets()
    else:
        space, _ = solid_space(mesh.p.T, mesh.t.T, np.zeros(mesh.p.shape[1], bool))
        facets = np.arange(len(space.boundary))
    x, across = space.positions, n_axes - 1
    skin = np.unique(space.facet_nodes(facets))
    fixed = skin[x[skin, across] < 1e-9]
    upper = x[:, across] > HIGH + 0.5 * GAP
    sides = [(k, skin[upper[skin] & (x[skin, k] < 1e-9)]) for k in range(across)]
    normals = np.concatenate([np.tile(np.eye(3)[k], (len(nodes), 1)) for k, nodes in sides])
    sliding = np.concatenate([nodes for _, nodes in sides])
    return _body(Discretization(space, facets, fixed, sliding, normals), 5.0), upper


@pytest.mark.parametrize("n_axes", [2, 3])
def test_a_block_lies_on_another_with_its_weight(n_axes):
    """The contact bears the weight of the upper block, density g volume (by hand), and leaves a gap."""
    body, upper = _blocks(n_axes)
    across = n_axes - 1
    X = body.discretization.space.positions.copy()
    X[upper & (X[:, across] != 0.0), across] -= GAP - 0.4
    down = np.zeros(3)
    down[across] = -G
    x, report = Equilibrium(1e-9).loaded(body, X, down)
    weight = DENSITY * G * HIGH * WIDE**across
    force = body.contact.force(x)
    assert -force[upper, across].sum() == pytest.approx(weight, rel=1e-7)
    assert force[~upper, across].sum() == pytest.approx(weight, rel=1e-7)
    assert len(body.contact.crossings(x)) == 0
    assert x[upper, across].min() > 0.0
    assert any("skin touches skin at" in line for line in report.history)


@pytest.fixture(scope="module")
def fold():
    """Return a strip folded on itself in a U, whose lower arm lies on the floor; its inner sides are 4 mm apart."""
    arm, thick, radius, n = 40.0, 6.0, 2.0, 28
    length = 2 * arm + np.pi * (radius + thick / 2)
    mesh = skfem.MeshTri.init_tensor(np.linspace(0, length, n + 1), np.linspace(0, thick, 3))
    along, depth = mesh.p  # the depth is measured from the outer side
    angle = np.clip((along - arm) / (radius + thick / 2), 0.0, np.pi)
    straight = np.where(along < arm, along - arm, np.maximum(along - (length - arm), 0.0))
    away = radius + thick - depth
    p = np.array([np.where(along < arm, straight, -straight) + away * np.sin(angle), -away * np.cos(angle)])
    mesh = skfem.MeshTri(p, mesh.t)
    space, facets = Space(mesh), mesh.boundary_facets()
    fixed = np.unique(space.facet_nodes(facets[mesh.p[1][mesh.facets[:, facets]].max(axis=0) < -radius - thick + 1e-6]))
    return _body(Discretization(space, facets, fixed), 30.0)


def test_a_fold_closes_without_crossing(fold):
    """Under its weight the upper arm falls through the lower one without contact, and rests on it with contact."""
    X, down, contact = fold.discretization.space.positions, np.array([0.0, -G, 0.0]), fold.contact
    solver = Equilibrium(1e-8)
    free, _ = solver.loaded(replace(fold, contact=None), X, down)
    assert len(contact.crossings(free))
    before = solver.state_arrays()
    x, report = solver.loaded(fold, X, down)
    assert len(contact.crossings(x)) == 0
    pressed = contact.force(x)
    assert np.abs(pressed).max() > 0.0
    assert np.abs(pressed.sum(axis=0)).max() < 1e-10 * np.abs(pressed).sum()
    out = fold.residual(X, x, down)[fold.discretization.free_nodes, :2]
    weight = np.linalg.norm(fold.lumped_mass(X)) * G
    assert np.linalg.norm(out) < 1e-8 * weight
    assert any("crosses skin: solved again with contact" in line for line in report.history)
    after = solver.state_arrays()
    assert before.keys() == after.keys()  # the factor with contact is not kept


def test_a_fold_that_rests_is_found_again_from_its_shape(fold):
    """A nearby shape in which skin touches is solved with contact at once, and opened again it is as it was."""
    X, down = fold.discretization.space.positions, np.array([0.0, -G, 0.0])
    x, _ = Equilibrium(1e-8).loaded(fold, X, down)
    again, report = Equilibrium(1e-8).loaded(fold, X, down, x)
    np.testing.assert_allclose(again, x, rtol=0, atol=1e-5)
    assert report.iterations <= 3
    back, _ = Equilibrium(1e-8).unloaded(fold, x, down)
    np.testing.assert_allclose(back, X, rtol=0, atol=1e-6)


def test_skin_that_stays_apart_gives_the_same_bytes(fold):
    X, down = fold.discretization.space.positions, np.array([0.0, -0.01 * G, 0.0])
    shapes = [Equilibrium(1e-8).loaded(body, X, down)[0] for body in (fold, replace(fold, contact=None))]
    assert shapes[0].tobytes() == shapes[1].tobytes()


def test_a_start_that_crosses_itself_is_left(fold):
    """The shape of the mesh is then the nearby shape: the solution is the same."""
    X, down = fold.discretization.space.positions, np.array([0.0, -G, 0.0])
    x, _ = Equilibrium(1e-8).loaded(fold, X, down)
    free, _ = Equilibrium(1e-8).loaded(replace(fold, contact=None), X, down)
    again, _ = Equilibrium(1e-8).loaded(fold, X, down, free)
    np.testing.assert_allclose(again, x, rtol=0, atol=1e-5)


def test_an_unloaded_shape_that_crosses_itself_is_refused(fold):
    """Contact cannot be followed from crossed skin: the sentence says where it crosses."""
    X, down = fold.discretization.space.positions, np.array([0.0, -G, 0.0])
    free, _ = Equilibrium(1e-8).loaded(replace(fold, contact=None), X, down)
    with pytest.raises(ConvergenceError) as error:
        Equilibrium(1e-8)._loaded(fold, free, 1e-3 * down, None, None)
    assert any("skin crosses skin at" in line for line in error.value.history)
