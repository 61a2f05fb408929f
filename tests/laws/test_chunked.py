"""Evaluation in chunks gives the same numbers as all points at once; the benchmark covers all laws of case files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick import compiled

from cicatrix.bench import laws as bench_laws
from cicatrix.bench.measurement import printed_on_one_core
from cicatrix.cases.laws import LAWS
from cicatrix.core.errors import CicatrixError, InputError
from cicatrix.materials.chunked import chunked
from cicatrix.materials.fibres import FibreDistribution, FibreViscosity
from cicatrix.materials.material import EnergyMaterial
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.materials.orientation import Single

F = bench_laws.gradients(23)


@pytest.mark.parametrize("size", [1, 5, 100])
def test_chunks_of_any_size_are_the_whole(size):
    law = FibreDistribution(2.0, Single(0.3), None, FibreViscosity(0.5, 10.0))
    points = F, law.initial_state((23,))

    @compiled
    def both(law):
        def work(p):
            return law.response(*p, 2.0)

        return work(points), chunked(work, points, size)

    for whole, parts in zip(*map(jax.tree.leaves, both(law)), strict=True):
        np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-14 * np.abs(whole).max())


def test_parameters_per_point_and_derivatives_go_through():
    mu = np.linspace(1.0, 2.0, 23)

    def total(mu, size):
        return jnp.sum(chunked(lambda p: NeoHookean(p[0], 1.0).energy(p[1]), (mu, F), size))

    np.testing.assert_allclose(jax.grad(total)(mu, 4), jax.grad(total)(mu, 23), rtol=1e-13)


@pytest.mark.parametrize(("points", "size"), [((F, F[:5]), 4), (F, 0)])
def test_what_cannot_be_cut_is_refused(points, size):
    with pytest.raises(InputError, match="chunked"):
        chunked(lambda x: x, points, size)


def test_no_points_are_no_answers():
    assert chunked(lambda x: x, np.zeros((0, 3)), 4).shape == (0, 3)


def test_the_closed_form_beside_the_law_is_the_law():
    P, A = bench_laws.closed_form(F)
    found = NeoHookean(bench_laws.MU, bench_laws.KAPPA).response(F)
    np.testing.assert_allclose(found.P, P, rtol=0, atol=1e-13 * np.abs(P).max())
    np.testing.assert_allclose(found.A, A, rtol=0, atol=1e-13 * np.abs(A).max())


def test_every_law_of_a_case_file_is_measured():
    measured = bench_laws.measured_laws()
    assert all(isinstance(measured[name][0], law) for name, law in LAWS.items())


def test_a_row_is_there_before_the_next_is_measured(tmp_path):
    waits = (
        'import pathlib, time; print(\'["a", NaN, "ns"]\', flush=True)\n'
        f"while not pathlib.Path({str(tmp_path / 'go')!r}).exists(): time.sleep(0.01)\n"
        'print(\'["b", 2.0, "ns", "note"]\'); raise ValueError(\'at fault\')'
    )
    rows = printed_on_one_core("-c", waits)
    assert next(rows).what == "a"
    (tmp_path / "go").touch()
    assert next(rows) == ("b", 2.0, "ns", "note")
    with pytest.raises(CicatrixError, match=r"failed with .*at fault"):
        next(rows)


def test_neo_hookean_by_hand_is_the_derivative_of_its_energy():
    """Compare for scalar parameters and for one value per point."""
    for law in (NeoHookean(1.3, 50.0), NeoHookean(np.linspace(1.0, 2.0, 23), np.linspace(0.0, 50.0, 23))):
        found, reference = law.response(F), EnergyMaterial.response(law, F)
        np.testing.assert_allclose(found.P, reference.P, rtol=1e-12, atol=1e-12 * np.abs(reference.P).max())
        np.testing.assert_allclose(found.A, reference.A, rtol=1e-12, atol=1e-12 * np.abs(reference.A).max())
