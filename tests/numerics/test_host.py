"""Python functions called back from compiled code: several threads, exceptions, a quiet end of the process."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import pytest

from cicatrix.numerics.host import call_back, own_exceptions


def squares(x):
    if x.size and x.flat[0] < 0.0:
        raise KeyError("negative")
    return [x * x]


squared = jax.jit(lambda x: call_back(squares, [x.shape], x)[0])


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_do_not_wait_for_each_other(threads):
    """A million numbers each: where the callback makes JAX arrays of its arguments, two threads never come back."""
    given = [np.full(1_000_000, float(k)) for k in range(8)]
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(3):
            answers = list(pool.map(lambda x: jax.block_until_ready(squared(x)), given))
    assert all((answer == k * k).all() for k, answer in enumerate(answers))


def test_vmap_calls_once():
    x = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(jax.vmap(squared)(x), x * x)


@pytest.mark.parametrize("n", [1, 1_000_000])
def test_an_exception_comes_out_as_it_was_raised(n):
    with pytest.raises(KeyError, match="negative") as found, own_exceptions():
        np.asarray(squared(-np.ones(n)))
    assert found.traceback[-1].name == "squares"


def test_an_exception_comes_out_of_a_thread():
    with pytest.raises(KeyError, match="negative"), own_exceptions(), ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda x: jax.block_until_ready(squared(x)), [-np.ones(10), -np.ones(1000), np.ones(10)]))


def test_other_exceptions_pass():
    with pytest.raises(ZeroDivisionError), own_exceptions():
        1 / 0  # noqa: B018


SCRIPT = """
import jax, numpy as np
from cicatrix.numerics.host import call_back, own_exceptions
jax.config.update("jax_enable_x64", True)
def stopped(x):
    raise KeyboardInterrupt
for n in (1, 300_000):
    try:
        with own_exceptions():
            np.asarray(jax.jit(lambda x: call_back(stopped, [x.shape], x)[0])(np.ones(n)))
    except KeyboardInterrupt:
        print("stopped")
"""


def test_a_process_ends_quietly_after_a_failure():
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=100)
    assert done.stdout.split() == ["stopped"] * 2
    assert done.stderr == ""
