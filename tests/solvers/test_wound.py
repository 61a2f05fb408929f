"""Limits of the continuum model: point model, Fisher's front, conservation, order in time, bits after resuming."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.optimize import fsolve

from cicatrix.biology.adhesion import Adhesion
from cicatrix.biology.bond import Bell
from cicatrix.biology.contraction import ConstantForce
from cicatrix.biology.mechanobiology import MechanobiologyModel
from cicatrix.biology.sensing import Sensing
from cicatrix.biology.signals import LogisticSignal, NoMechanosensing, TractionSignal
from cicatrix.biology.substrate import Column, ExponentialFibre
from cicatrix.biology.turnover import Turnover
from cicatrix.core.errors import ConvergenceError
from cicatrix.geometry.hexgrid import Lattice
from cicatrix.healing.automaton import Automaton, AutomatonRules
from cicatrix.healing.continuum import ContinuumIntegrator, Tolerance
from cicatrix.healing.scarring import CollagenGrowth, Contracture, Local, Scarring
from cicatrix.healing.transport import Flow, Mobility, Transport
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.mechanics.body import Body, Discretization
from cicatrix.mechanics.space import Sheet
from cicatrix.numerics.bdf import formula

pytestmark = pytest.mark.xdist_group("wound")  # compiled once
H = 3600.0
STRESS = {"k_0": 51.1, "k_f": 0.0, "k_2": 1.0, "k_v": 0.0, "t_rho": 5.0, "t_rho_c": 50.0, "K_t": 0.3, "K_t_c": 0.1}
STILL = Mobility(0.0, 0.0)
RATES = "p_f p_f_c p_f_t d_f d_f_rho_c p_rho p_rho_c p_rho_t d_rho x_rho p_c p_c_t d_c x_c"
NOTHING = dict.fromkeys(RATES.split(), 0.0)


def sheet(nx, ny, width=1.0, height=1.0, clamped=True):
    """Return a rectangle of squares whose border is prescribed."""
    x, y = np.linspace(0, width, nx + 1), np.linspace(0, height, ny + 1)
    X = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((nx + 1, ny + 1))], axis=-1).reshape(-1, 3)
    number = np.arange(len(X)).reshape(nx + 1, ny + 1)
    cells = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    space = Sheet(X, cells)
    held = np.unique(space.boundary) if clamped else np.arange(len(X))
    filler, shape = NeoHookean(1.0, 1.0), (len(cells), 4)
    discretization = Discretization(space, np.zeros(0, int), held)
    return Body(discretization, filler, np.full(shape, 1e-6), np.ones(len(cells)), filler, np.zeros(0)), X


def local(body, phi=1.0, signal_state=()):
    shape = body.density.shape
    axes = np.broadcast_to(np.eye(3), (*shape, 3, 3)).copy()
    signal_state = np.broadcast_to(np.array(signal_state, float), (*shape, len(signal_state))).copy()
    return Local(np.broadcast_to(phi, shape).copy(), np.ones((*shape, 2)), np.full(shape, 0.5), axes, signal_state)


def wound(body, X, turnover, mobility=STILL, *, sensing=None, yielding=None, held=(), **how):
    law = Scarring(
        turnover, sensing or Sensing(NoMechanosensing()), yielding or Contracture(0.485), None, **STRESS, is_sheet=True
    )
    transport = Transport(body.discretization.space, X, np.array(held, int))
    tolerance = how.pop("tolerance", Tolerance(1e-4, 1e-9))
    return ContinuumIntegrator(body, X, np.zeros(3), law, mobility, transport, tolerance, **how)


def test_a_homogeneous_sheet_is_the_model_at_a_point():
    """Kind "tissue-cell" with the same steps, solved by SciPy: growth, cells, cytokine, collagen and bonds to 1e-8."""
    turnover = Turnover()
    fibre = Column(ExponentialFibre(70396.5866, 20.818), 0.017, 0.1)
    adhesion = Adhesion(Bell(0.01, 0.012, 4.28317e-3), fibre, ConstantForce(7.0), 400.0)
    signal, stretch, bound = TractionSignal(1.0, 0.3), 1.1, 0.2
    point_model = MechanobiologyModel(adhesion, signal, turnover, 0.8)
    body, X = sheet(2, 2)
    solver = wound(
        *(body, X, turnover),
        sensing=Sensing(signal, adhesion),
        yielding=CollagenGrowth(0.8),
        tolerance=Tolerance(1e-4, 1e-12),
    )
    fields = np.tile([0.7, 0.3], (9, 1))
    integration = solver.start(fields, local(body, 0.9, [bound]), 5.0, prescribed_positions=X * [stretch, stretch, 1.0])
    ys = [np.array([1.0, 0.7, 0.3, 0.9, bound])]
    rate = jax.jit(point_model.rate)
    while integration.n_accepted < 30:
        before, integration = integration, solver.step(integration, 400.0 * H)
        used = formula(integration.last_dt, [before.time - t for t in before.times])
        start, dt = sum(w * y for w, y in zip(used.start, ys)), used.share * integration.last_dt
        y = fsolve(lambda z: z - start - dt * np.asarray(rate(z, stretch)), ys[0], xtol=1e-12)  # noqa: B023
        ys = [y, *ys][:3]
    assert integration.time > 20 * H
    now = integration.now
    found = [
        now.local.stretch[..., 0],
        now.fields[:, 0],
        now.fields[:, 1],
        now.local.phi,
        now.local.signal_state[..., 0],
    ]
    for name, values, expected in zip(point_model.names, found, ys[0]):
        np.testing.assert_allclose(values, expected, rtol=1e-8, err_msg=name)
    assert abs(ys[0][3] - 0.9) > 1e-2  # the state has changed


@pytest.fixture(scope="module")
def speed():
    """Return the speed of a front over sqrt(r D) that is left as t grows, with four elements per sqrt(D/r).

    In these units the front of a sharp start is at 2 t - 3/2 log(t) - 3 sqrt(pi/t) + a constant (Bramson; Ebert and van
    Saarloos); from t = 15 to 30 the next term is below 1 % of the speed.
    """
    r, D, length, n = 0.01 / H, 0.04 / H, 150.0, 300
    turnover = Turnover(**NOTHING | {"p_rho": r}, K_rho_rho=1.0)
    body, X = sheet(n, 1, length, length / n, clamped=False)
    solver = wound(body, X, turnover, Mobility(D, 0.0), is_coupled=False, tolerance=Tolerance(1e-4, 1e-6))
    cells = np.where(X[:, 0] < 5.0, 1.0, 0.0)
    first = solver.start(np.stack([cells, 0.0 * cells], axis=-1), local(body), 0.1 * H)
    line = np.flatnonzero(X[:, 1] == 0.0)
    times, places = [], []
    for integration in solver.integrate(first, 30.0 / r):
        rho = integration.now.fields[line, 0]
        k = np.flatnonzero(rho > 0.5)[-1]
        times.append(integration.time * r)
        places.append((X[line[k], 0] + (rho[k] - 0.5) / (rho[k] - rho[k + 1]) * length / n) / np.sqrt(D / r))
    late = np.array(times) > 15.0
    t, x = np.array(times)[late], np.array(places)[late]
    return np.polyfit(t, x + 1.5 * np.log(t) + 3.0 * np.sqrt(np.pi / t), 1)[0]


def test_a_front_has_fishers_speed(speed):
    assert speed == pytest.approx(2.0, rel=0.02)


def open_sizes(lattice, within, is_open, rules, seed):
    """Return the open area after every step of the automaton, to closure or 400 steps [mm^2]."""
    automaton = Automaton(lattice, within, is_open, rules, seed)
    state, sizes = automaton.initial_state(), []
    while len(sizes) < 400 and (n := np.count_nonzero(within & ~state.occupancy)):
        sizes.append(n * lattice.site_measure)
        state = automaton.advance(state)
    return np.array(sizes)


def test_a_continuum_fitted_to_the_automatons_round_wound_has_its_straight_front(speed):
    """In both models a circular hole closes with speed c + D/R. With D and r = c^2/(4 D) fitted to the automaton (mean of
    four seeds), the straight front of the continuum has the automaton's speed within 6 %; by hand D = p delta^2/2, r = p/2.
    """
    p, delta, pitch, R0 = 0.04, 0.2, 0.01, 2.0
    rules = AutomatonRules(p_edge=0.0, p_layer=p, layer_sites=round(delta / pitch))
    round_, straight = (
        Lattice.covering((-2.4, -2.4), (2.4, 2.4), pitch),
        Lattice.covering((-1.0, 0.0), (3.0, 1.0), pitch),
    )
    away, (x, y) = np.hypot(*np.moveaxis(round_.positions(), -1, 0)), np.moveaxis(straight.positions(), -1, 0)
    strip = (x > -1.0) & (x < 3.0) & (y > 0.0) & (y < 1.0)
    fits, fronts = [], []
    for seed in range(4):
        R = np.sqrt(open_sizes(round_, away < 1.15 * R0, away < R0, rules, seed) / np.pi)
        edges = np.linspace(0.9 * R0, 0.2 * R0, 15)
        v = -np.diff(edges) / np.diff(np.interp(-edges, -R, np.arange(len(R))))
        fits.append(np.polyfit(np.log(edges[:-1] / edges[1:]) / -np.diff(edges), v, 1))  # mean of 1/R between edges
        gone = 3.0 - open_sizes(straight, strip, strip & (x > 0.0), rules, seed)
        late = (gone > 0.5) & (gone < 2.5)
        fronts.append(np.polyfit(np.flatnonzero(late), gone[late], 1)[0])
    D, c = np.mean(fits, axis=0)
    assert p * delta**2 / 2 == pytest.approx(D, rel=0.3)
    assert speed * np.sqrt(c**2 / (4.0 * D) * D) == pytest.approx(np.mean(fronts), rel=0.06)


def test_cells_settle_where_birth_balances_death():
    """The steady state of the logistic law is rho* = K (1 - d/p), approached from below and above."""
    turnover = Turnover(**NOTHING | {"p_rho": 0.034 / H, "d_rho": 0.0068 / H}, K_rho_rho=1.25)
    body, X = sheet(2, 1, clamped=False)
    solver = wound(body, X, turnover, is_coupled=False)
    fields = np.stack([np.linspace(0.2, 2.0, 6), np.zeros(6)], axis=-1)
    *_, integration = solver.integrate(solver.start(fields, local(body), H), 1500 * H)
    np.testing.assert_allclose(integration.now.fields[:, 0], 1.25 * (1 - 0.0068 / 0.034), rtol=1e-6)


def spread(X):
    """Return cells and cytokine that vary in space."""
    x, y = X[:, 0], X[:, 1]
    return np.stack(
        [1.0 + 0.5 * np.sin(3 * x) * np.cos(2 * y), np.exp(-8 * ((x - 0.3) ** 2 + (y - 0.6) ** 2))], axis=-1
    )


def test_without_flux_and_sources_cells_are_kept_on_a_moving_body():
    """With chemotaxis, haptotaxis and uneven traction the totals are constant to round-off, while body and cells move."""
    body, X = sheet(8, 8)
    mobility = Mobility(0.002 / H, 0.001 / H, -0.002 / H, -0.001 / H)
    turnover = Turnover(**NOTHING | {"p_f": 0.02 / H, "d_f": 0.01 / H})
    solver = wound(body, X, turnover, mobility)
    first = solver.start(spread(X), local(body, 0.5), 0.1 * H)
    *_, last = solver.integrate(first, 20 * H)
    for k in range(2):
        total = [solver.transport.total(c.now.fields[:, k]) for c in (first, last)]
        assert total[1] == pytest.approx(total[0], rel=1e-12)
    assert np.abs(last.now.x - first.now.x).max() > 2e-3
    assert np.abs(last.now.fields - first.now.fields).max() > 0.05


def test_what_is_gained_is_what_sources_make_and_what_flows_in():
    """The balance of each step over the free nodes, with sources and a prescribed border, holds to the tolerance."""
    body, X = sheet(6, 6)
    held = np.unique(body.discretization.space.boundary)
    solver = wound(
        body, X, Turnover(), Mobility(0.01 / H, 0.01 / H), held=held, sensing=Sensing(LogisticSignal(1.0, 5.0))
    )
    integration = solver.start(spread(X), local(body), 0.1 * H)
    for _ in range(12):
        before, integration = integration, solver.step(integration, 50 * H)
    used = formula(integration.last_dt, [before.time - t for t in before.times])
    start = sum(w * s.fields for w, s in zip(used.start, before.past))
    now, on = integration.now, solver.transport
    F = body.law_gradient(X, now.x)
    flow = Flow(on, solver.mobility, Turnover(), F, on.at_vertices(solver.signal(now)), np.zeros(on.n))
    gained = on.volumes[:, None] * (now.fields - start) / (used.share * integration.last_dt)
    made = on.volumes[:, None] * flow.sources(*now.fields.T)
    came = -flow.outflux(*now.fields.T)
    scale = np.abs(made).sum(axis=0)
    assert np.all(np.abs((gained - made - came)[on.free].sum(axis=0)) < 1e-8 * scale)
    assert np.all(np.abs(came[held].sum(axis=0) + came[on.free].sum(axis=0)) < 1e-12 * np.abs(came).sum(axis=0))


def test_transport_matrix_is_the_derivative():
    body, X = sheet(3, 3)
    on = Transport(body.discretization.space, X, np.array([0, 5]))
    x = X + 0.05 * np.sin(4 * X[:, [1, 0, 2]]) * [1, 1, 0]
    mobility = Mobility(0.02 / H, 0.01 / H, -0.03 / H, 0.02 / H)
    rng = np.random.default_rng(0)
    fields, start = rng.uniform(0.2, 1, (2, on.n, 2))
    flow = Flow(on, mobility, Turnover(), body.law_gradient(X, x), rng.random(on.n), rng.random(on.n))
    K, step = flow.tangent(fields, H).toarray(), 1e-6
    for number, (node, kind) in enumerate((n, k) for n in on.free for k in range(2)):
        moved = np.zeros_like(fields)
        moved[node, kind] = step
        sides = [flow.residual(fields + sign * moved, start, H)[on.free].ravel() for sign in (1, -1)]
        np.testing.assert_allclose(
            K[:, number], (sides[0] - sides[1]) / (2 * step), rtol=1e-6, atol=1e-9 * abs(K).max()
        )


def round_wound(**how):
    body, X = sheet(10, 10, 40.0, 40.0)
    away = np.linalg.norm(X[:, :2] - 20.0, axis=1)
    healthy = 1.0 / (1.0 + np.exp(-(away - 8.0)))
    points = np.einsum("qa,eai->eqi", body.discretization.space.table.value, X[body.discretization.space.element_nodes])
    phi = 1.0 / (1.0 + np.exp(-(np.linalg.norm(points[..., :2] - 20.0, axis=-1) - 8.0)))
    rates = {
        "p_f": 2e-3,
        "p_f_c": 2e-3,
        "p_f_t": 2e-3,
        "d_f": 1e-3,
        "d_f_rho_c": 5e-4,
        "p_rho": 0.017,
        "p_rho_c": 0.0085,
    }
    rates |= {"p_rho_t": 0.0085, "d_rho": 0.0153, "d_c": 0.01}
    turnover = Turnover(**NOTHING | {name: value / H for name, value in rates.items()}, K_f_rho=1.06, K_rho_rho=10.0)
    held = np.unique(body.discretization.space.boundary)
    mobility = Mobility(0.0833 / H, 0.012 / H)
    solver = wound(body, X, turnover, mobility, held=held, sensing=Sensing(LogisticSignal()), **how)
    return solver, np.stack([healthy, 1 - healthy], axis=-1), local(body, 0.01 + 0.99 * phi)


@pytest.mark.slow
def test_halving_steps_divides_the_error_by_four():
    """Equal steps without error control, compared with sixteen times finer ones."""

    def end(n):
        solver, fields, at = round_wound(tolerance=Tolerance(1e9, 1e-9))
        integration = solver.start(fields, at, 100.0 * H / n)
        while integration.n_accepted < n:
            integration = solver.step(replace(integration, next_dt=100.0 * H / n), 200.0 * H)
        return integration.now

    finest = end(128)

    def error(state):
        return max(np.abs(state.fields - finest.fields).max(), np.abs(state.local.stretch - finest.local.stretch).max())

    order = np.log2(error(end(8)) / error(end(16)))
    assert 1.7 < order < 2.4


def test_the_tolerance_bounds_the_error():
    ends = {}
    for tolerance in (1e-3, 1e-4, 1e-6):
        solver, fields, at = round_wound(tolerance=Tolerance(tolerance, 1e-9))
        *_, last = solver.integrate(solver.start(fields, at, 0.01 * H), 100 * H)
        ends[tolerance] = last.now
    errors = [np.abs(ends[t].fields - ends[1e-6].fields).max() for t in (1e-3, 1e-4)]
    assert errors[0] < 1e-2
    assert errors[1] < 2e-3
    assert errors[1] < 0.5 * errors[0]


def test_it_goes_on_from_a_stored_state_to_the_same_bits():
    solver, fields, at = round_wound()
    integration = solver.start(fields, at, 0.1 * H)
    for _ in range(6):
        integration = solver.step(integration, 100 * H)
    solver.reset()
    kept = integration
    for _ in range(4):
        integration = solver.step(integration, 100 * H)
    again, _, _ = round_wound()
    other = kept
    for _ in range(4):
        other = again.step(other, 100 * H)
    assert other.times == integration.times
    for one, two in zip(jax.tree.leaves(integration.past), jax.tree.leaves(other.past)):
        np.testing.assert_array_equal(one, two)


def test_one_way_the_body_stays():
    solver, fields, at = round_wound(is_coupled=False)
    first = solver.start(fields, at, 0.1 * H)
    *_, last = solver.integrate(first, 50 * H)
    np.testing.assert_array_equal(last.now.x, first.now.x)
    assert np.abs(last.now.fields - first.now.fields).max() > 0.1


def test_steps_that_become_too_short_end_in_a_sentence():
    """The error says when, why, and where tissue is most compressed."""
    solver, fields, at = round_wound(tolerance=Tolerance(1e-9, 1e-11, 0.05 * H))
    with pytest.raises(
        ConvergenceError, match=r"stopped at 0\.1 h: .*its error was too large.*; the tissue is most compressed near"
    ):
        for _ in solver.integrate(solver.start(fields, at, 0.1 * H), 400 * H):
            pass
