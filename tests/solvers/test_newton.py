"""Load stepping on a scripted problem: which steps are tried, and when it gives up."""

import numpy as np
import pytest

from cicatrix.core.errors import ConvergenceError
from cicatrix.numerics.newton import NewtonReport, newton, ramp


def advancing(limit: float, report: NewtonReport):
    """Return an ``advance`` that fails for steps above a limit, and the list of tried steps."""
    tried, reached = [], [0.0]

    def advance(x, factor):
        tried.append((reached[0], factor))
        report.count(1.0)
        if factor - reached[0] > limit:
            raise ConvergenceError("no", ["too far"])
        reached[0] = factor
        return x + 1

    return advance, tried


def test_a_ramp_ends_at_one_and_never_tries_the_same_step_twice():
    report = NewtonReport()
    advance, tried = advancing(0.3, report)
    steps = ramp(advance, np.zeros(1), report)
    assert tried[-1][1] == 1.0
    assert steps[0] == report.load_steps
    assert len(tried) == len(set(tried))


def test_a_ramp_gives_up_when_the_iterations_run_out():
    report = NewtonReport()
    advance, tried = advancing(0.01, report)
    with pytest.raises(ConvergenceError, match="No equilibrium found beyond load factor") as caught:
        ramp(advance, np.zeros(1), report, max_iterations=10)
    assert len(tried) <= 20
    assert len(caught.value.history) == len(tried)


def test_each_iteration_is_told():
    heard = []
    report = NewtonReport(tell=heard.append)
    x = newton(lambda x: x**2 - 2, lambda x, r: -r / (2 * x), np.array([1.0]), tolerance=1e-12, report=report)
    assert x[0] == pytest.approx(np.sqrt(2), abs=1e-12)
    assert len(heard) == report.iterations > 3


def test_a_failure_without_a_history_is_told_in_its_own_words():
    """Such as one that a material raises."""
    report = NewtonReport()

    def advance(x, factor):
        if factor > 0.3 + x[0]:
            raise ConvergenceError("no stress at point 3")
        return np.array([factor])

    assert ramp(advance, np.zeros(1), report)[0] == 1.0
    assert any("no stress at point 3" in line for line in report.history)
