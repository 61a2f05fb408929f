"""Growth around a law, compared with closed-form solutions in one direction."""

import numpy as np
import pytest
from quick import compiled
from scipy.optimize import brentq

from cicatrix.core.errors import InputError
from cicatrix.materials.growing import AreaGrowth, FibreGrowth, Growing, VolumeGrowth
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.materials.orientation import Single, VonMises

pytestmark = pytest.mark.xdist_group("growing")  # compiled once

TISSUE = NeoHookean(2.0, 30.0)
advance = compiled(lambda law, F, state, dt: law.advance(F, state, dt))


def grown(law, F, dt, n):
    """Return the growth tensor after n equal steps at constant F."""
    state = law.initial_state(())
    for _ in range(n):
        state = advance(law, F, state, dt)
    return np.asarray(state[0]), np.asarray(law.growth_tensor(state))


def test_the_growth_tensor_starts_at_the_identity():
    for growth in (FibreGrowth(1.0, None, VonMises(3.0)), AreaGrowth(1.0), VolumeGrowth(1.0)):
        law = Growing(TISSUE, growth)
        np.testing.assert_allclose(law.growth_tensor(law.initial_state(())), np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("growth", "F"),
    [
        (FibreGrowth(10.0, None, Single(0.0)), np.diag([1.5, 1.0, 1.0])),
        (AreaGrowth(10.0), np.diag([1.5, 1.0, 1.0])),
        (VolumeGrowth(10.0), np.diag([1.5, 1.0, 1.0])),
    ],
)
def test_growth_at_fixed_stretch(growth, F):
    """g' = (1.5 / g - 1) / tau for all three laws: t / tau = 1 - g - 1.5 ln((1.5 - g) / 0.5), to first order in the step."""
    law = Growing(TISSUE, growth)
    errors = []
    for n in (10, 20, 40):
        g = grown(law, F, 10.0 / n, n)[0][0]
        errors.append(1 - g - 1.5 * np.log((1.5 - g) / 0.5) - 1.0)
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.1)
    assert abs(errors[2]) < 0.03
    assert grown(law, F, 1e9, 3)[0][0] == pytest.approx(1.5, rel=1e-7)  # any step is stable, and ends unstrained


def test_fibres_in_all_directions_grow_as_an_area_does():
    """With c = 0 and equibiaxial stretch l all fibres grow alike: F_g = (1 + (g - 1) / 2) I in the plane, by Eq. (14)."""
    g, F_g = grown(Growing(TISSUE, FibreGrowth(10.0, None, VonMises(0.0))), np.diag([1.3, 1.3, 1.0]), 2.0, 5)
    np.testing.assert_allclose(g, g[0], rtol=1e-12)
    np.testing.assert_allclose(np.diag(F_g), [0.5 * (1 + g[0]), 0.5 * (1 + g[0]), 1.0], rtol=1e-12)


def test_growth_at_constant_elastic_stretch_goes_on_evenly():
    """With F = 1.2 F_g in every step, lambda_g = 1 + 0.2 t / tau is exact."""
    law = Growing(TISSUE, FibreGrowth(10.0, None, Single(0.0)))
    state = law.initial_state(())
    for k in range(1, 6):
        F = np.diag([1.2 * (1 + 0.2 * k * 3.0 / 10.0), 1.0, 1.0])
        state = advance(law, F, state, 3.0)
        assert float(state[0][0]) == pytest.approx(1 + 0.06 * k, rel=1e-12)


def homeostatic_stretch(normal):
    """Return the stretch, with fixed sides, at which the Cauchy stress minus a fraction of the normal stress is 0.5 kPa."""

    def excess(stretch):
        F = np.diag([stretch, 1.0, 1.0])
        sigma = np.diag(np.asarray(TISSUE.stress(F)) @ F.T / stretch)
        return normal(sigma) - 0.5

    return brentq(excess, 1.0001, 2.0)


@pytest.mark.parametrize(
    ("growth", "normal"),
    [
        (FibreGrowth(10.0, 0.5, Single(0.0)), lambda s: s[0] - s[2]),
        (AreaGrowth(10.0, 0.5), lambda s: 0.5 * (s[0] + s[1]) - s[2]),
        (VolumeGrowth(10.0, 0.5), lambda s: s.mean()),
    ],
)
def test_stress_at_home_does_not_grow(growth, normal):
    law, home = Growing(TISSUE, growth), homeostatic_stretch(normal)
    assert grown(law, np.diag([home, 1.0, 1.0]), 100.0, 3)[0][0] == pytest.approx(1.0, abs=1e-9)
    assert grown(law, np.diag([home + 0.05, 1.0, 1.0]), 1.0, 1)[0][0] > 1.0
    assert grown(law, np.diag([home - 0.02, 1.0, 1.0]), 1.0, 1)[0][0] < 1.0


def test_grown_tissue_is_free_of_stress_in_its_grown_shape():
    law = Growing(TISSUE, AreaGrowth(10.0))
    state = law.initial_state(())
    state = advance(law, np.diag([1.3, 1.2, 1.0]), state, 20.0)
    F_g = np.asarray(law.growth_tensor(state))
    assert F_g[0, 0] > 1.05
    np.testing.assert_allclose(law.stress(F_g, state), 0.0, atol=1e-12)


def test_bad_parameters_are_named():
    with pytest.raises(InputError, match=r"AreaGrowth.tau \(tau_g\) must lie in"):
        AreaGrowth(0.0)
    with pytest.raises(InputError, match=r"VolumeGrowth.homeostatic \(sigma_h\) must lie in"):
        VolumeGrowth(1.0, -1.0)
