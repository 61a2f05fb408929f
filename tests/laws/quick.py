"""Compiler options for tests of laws at a few points: compilation takes a third of the time, and the code is slow."""

from functools import partial

import jax

from cicatrix.numerics.compiler import COMPILER

compiled = partial(jax.jit, compiler_options={**COMPILER, "xla_backend_optimization_level": 0})
