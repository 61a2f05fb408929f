"""The mechanical signal of a cell, Eq. (19) of the review."""

import numpy as np
import pytest

from cicatrix.biology.moreo import Moreo
from cicatrix.core.errors import InputError

CELL = Moreo(K_pass=2.0, K_act=10.0, p_max=3.0, theta_1=0.1, theta_2=0.7)


def printed(theta):
    """Return Eq. (19) as printed, branch by branch; theta* = 3 / 10."""
    if not 0.1 < theta < 0.7:
        return 2.0 * theta
    end = 0.1 if theta <= 0.3 else 0.7
    return 10.0 * 3.0 / (10.0 * end - 3.0) * (end - theta) + 2.0 * theta


@pytest.mark.parametrize("theta", [-0.2, 0.0, 0.1, 0.15, 0.2999, 0.3, 0.3001, 0.5, 0.7, 1.0])
def test_as_printed(theta):
    assert float(CELL.signal(theta)) == pytest.approx(printed(theta), abs=1e-12)


def test_most_at_the_peak():
    """The maximum is p_max + K_pass theta*."""
    assert float(CELL.signal(0.3)) == pytest.approx(3.0 + 0.6)
    np.testing.assert_allclose(CELL.signal(np.array([0.1, 0.7])), [0.2, 1.4], atol=1e-15)


def test_the_violated_inequality_is_named():
    with pytest.raises(InputError, match=r"theta_1 < p_max / K_act must hold; got 0.4 and 0.3"):
        Moreo(2.0, 10.0, 3.0, 0.4, 0.7)
    with pytest.raises(InputError, match=r"p_max / K_act < theta_2 must hold; got 0.3 and 0.2"):
        Moreo(2.0, 10.0, 3.0, 0.1, 0.2)
