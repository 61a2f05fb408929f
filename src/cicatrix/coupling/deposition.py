"""How new tissue is laid down: in which state it is free of stress."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ..numerics.tensors import inv


@dataclass(frozen=True)
class Deposition:
    """Stress-free state of new tissue.

    Parameters
    ----------
    loaded : bool
        False: new tissue is stress-free in the unloaded reference (Garbey et al., section 3). True: it is stress-free as
        it is laid down, in the loaded body, with a deposition stretch (Guo, Mofrad & Buganza Tepole, Eq. 11); this is what
        lets a scar hold the shape it was born in.
    prestretch : float [1]
        In-plane stretch g of new tissue at deposition, G = diag(g, g, 1/g^2); 1 is none. Only for ``loaded``.
    """

    loaded: bool
    prestretch: float = 1.0

    def natural(self, old: np.ndarray, filled_before: np.ndarray, filled: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Natural configuration after a deposit, the mean over what an element holds, by mass.

        old, F (n_elements, n_qp, 3, 3) [1], filled_before, filled (n_elements,) [1] -> (n_elements, n_qp, 3, 3).
        An element is a homogenised mixture of what was laid down in it at different times; cells that come back into
        an element lay down nothing new.
        """
        if not self.loaded:
            return old
        g = self.prestretch
        born = np.asarray(inv(jnp.diag(jnp.array([g, g, g**-2])))) @ F
        share = np.where(filled > filled_before, (filled - filled_before) / np.maximum(filled, 1e-12), 0.0)[
            :, None, None, None
        ]
        return (1.0 - share) * old + share * born
