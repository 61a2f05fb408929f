"""Numbers of threads that change the bits of a result: those of mechanics, of MKL and of NumPy's linear algebra.

``CICATRIX_THREADS`` counts for MKL too, unless it is not set and ``MKL_NUM_THREADS`` is.
"""

from __future__ import annotations

import os

from .native import threads

THREADS, MKL_THREADS = "CICATRIX_THREADS", "MKL_NUM_THREADS"
OF_NUMPY = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


def mkl_threads() -> str:
    """Return the number of threads of MKL, as its environment variable gives it."""
    return os.environ.get(THREADS) or os.environ.get(MKL_THREADS) or "1"


def threads_of_libraries() -> dict[str, str]:
    """Return the number of threads by the environment variable that sets it.

    Raises
    ------
    InputError
        If ``CICATRIX_THREADS`` is no number of threads.
    """
    of_numpy = {name: os.environ.get(name, "not set") for name in OF_NUMPY}
    return {THREADS: str(threads()), MKL_THREADS: mkl_threads()} | of_numpy
