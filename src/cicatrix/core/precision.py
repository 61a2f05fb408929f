"""Switch of JAX to 64-bit numbers, which only this module sets.

JAX has one precision switch for the whole process, which affects arrays created after it is set. It is therefore set when a
module that computes with JAX is imported (:mod:`.law`, :mod:`..numerics.tensors`, :mod:`..numerics.ode`), so that even a law
imported by itself does not round its parameters to single precision. Setting it does not initialise a JAX backend. A program
that imports laws and needs single precision in its own code must request it with ``dtype``.
"""

from __future__ import annotations

import jax


def use_double_precision() -> None:
    """Switch JAX to 64-bit numbers in this process."""
    jax.config.update("jax_enable_x64", True)
