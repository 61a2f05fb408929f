"""Deposition of new tissue: the configuration in which it is free of stress."""

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
        False: new tissue is stress-free in the unloaded reference (Garbey et al., section 3). True: it is deposited in the
        loaded body with the in-plane stretch ``prestretch`` (Guo, Mofrad & Buganza Tepole, Eq. 11), so that a scar tends to
        retain the shape in which it formed.
    prestretch : float [1]
        In-plane stretch g of new tissue at deposition, G = diag(g, g, 1/g^2); 1: stress-free. Used only if ``loaded``.
    """

    loaded: bool
    prestretch: float = 1.0

    def natural(self, old: np.ndarray, filled_before: np.ndarray, filled: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Return the natural configuration after deposition: the mean of existing and new tissue in each element, by mass.

        Natural configuration ``old`` before, deformation gradient F (n_elements, n_qp, 3, 3) [1]; filled fractions before and
        after (n_elements,) [1] -> (n_elements, n_qp, 3, 3).
        An element is a homogenised mixture of tissue deposited at different times. An element whose filled fraction
        does not increase receives no new tissue.
        """
        if not self.loaded:
            return old
        g = self.prestretch
        born = np.asarray(inv(jnp.diag(jnp.array([g, g, g**-2])))) @ F
        share = np.where(filled > filled_before, (filled - filled_before) / np.maximum(filled, 1e-12), 0.0)[
            :, None, None, None
        ]
        return (1.0 - share) * old + share * born
