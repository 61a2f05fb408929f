"""Anderson acceleration compared with plain iteration, and on linear maps, where it is a Krylov method."""

import numpy as np

from cicatrix.numerics.anderson import Anderson


def test_a_linear_map_of_three_rates_is_done_in_five_steps():
    """GMRES finds the fixed point of a map with three eigenvalues in three steps; two more steps only evaluate the map."""
    rng = np.random.default_rng(0)
    Q, _ = np.linalg.qr(rng.standard_normal((12, 12)))
    A, b = Q @ np.diag([0.9, 0.5, -0.4] * 4) @ Q.T, rng.standard_normal(12)
    exact, x, mixing = np.linalg.solve(np.eye(12) - A, b), np.zeros(12), Anderson()
    for _ in range(5):
        x = mixing.mixed(x, A @ x + b)
    assert np.abs(x - exact).max() < 1e-9


def test_a_slow_map_is_found_sooner():
    def image(x):
        return np.array([0.9 * np.cos(x[0]) + 0.05 * x[1], 0.8 * np.sin(x[1]) + 0.3])

    def steps(next_of):
        x = np.zeros(2)
        for n in range(200):
            if np.abs(image(x) - x).max() < 1e-10:
                return n
            x = next_of(x)
        return 200

    mixing = Anderson()
    assert 2 * steps(lambda x: mixing.mixed(x, image(x))) < steps(image)
