"""How uncertain the defaults are: a distribution of each number over women, and draws from all of them together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats


@dataclass(frozen=True)
class Prior:
    """Distribution of a number, or of its ratio to another one.

    Parameters
    ----------
    kind : str
        "lognormal": of median ``first``, with standard deviation ``second`` of the natural logarithm; "normal": of mean
        ``first`` and standard deviation ``second``; "uniform": from ``first`` to ``second``; "fixed": always ``first``.
    first, second : float
        Numbers of the distribution.
    times : str, optional
        Key of another number: the distribution is that of the ratio to it.
    """

    kind: Literal["lognormal", "normal", "uniform", "fixed"]
    first: float
    second: float = 0.0
    times: str | None = None

    def at(self, share: np.ndarray) -> np.ndarray:
        """Return the quantiles of shares between 0 and 1 (n,) -> (n,), in the unit of the key, or as ratio."""
        if self.kind == "lognormal":
            return stats.lognorm.ppf(share, s=self.second, scale=self.first)
        if self.kind == "normal":
            return stats.norm.ppf(share, loc=self.first, scale=self.second)
        if self.kind == "uniform":
            return stats.uniform.ppf(share, loc=self.first, scale=self.second - self.first)
        return np.full_like(share, self.first)

    @property
    def median(self) -> float:
        """Median, in the unit of the key, or as ratio."""
        return float(self.at(np.array([0.5]))[0])

    def __str__(self) -> str:
        """Return the distribution in words, such as "log-normal, median 0.3, sigma 0.6"."""
        words = {
            "lognormal": f"log-normal, median {self.first:g}, sigma {self.second:g}",
            "normal": f"normal, mean {self.first:g}, sd {self.second:g}",
            "uniform": f"uniform, {self.first:g} to {self.second:g}",
            "fixed": f"{self.first:g}",
        }[self.kind]
        return words if self.times is None else f"{words} times {self.times}"


PRIORS: dict[str, Prior] = {
    "tissue.fat.E_kPa": Prior("lognormal", 0.3, 0.6),
    "tissue.fat.stiffening": Prior("lognormal", 2.0, 0.7),
    "tissue.gland.E_kPa": Prior("lognormal", 1.2, 0.5, "tissue.fat.E_kPa"),
    "tissue.gland.stiffening": Prior("fixed", 1.0, times="tissue.fat.stiffening"),
    "tissue.tumour.E_kPa": Prior("lognormal", 6.0, 0.45, "tissue.gland.E_kPa"),
    "tissue.tumour.stiffening": Prior("fixed", 1.0, times="tissue.fat.stiffening"),
    "tissue.scar.E_kPa": Prior("lognormal", 29.0 / 15.0, 0.83, "tissue.fat.E_kPa"),
    "tissue.scar.stiffening": Prior("fixed", 1.0, times="tissue.fat.stiffening"),
    "tissue.skin.E_kPa": Prior("lognormal", 4.0, 0.7),
    "tissue.skin.thickness_mm": Prior("normal", 1.45, 0.25),
    "tissue.skin.prestretch": Prior("normal", 1.1, 0.05),
    "tissue.skin.locking_stretch": Prior("uniform", 1.1, 1.4),
    "tissue.skin.stiff_kPa": Prior("lognormal", 43.0, 1.0),
    "tissue.skin.steepness": Prior("lognormal", 8.0, 0.5),
    "tissue.ligaments.share": Prior("uniform", 0.0, 0.02),
    "tissue.ligaments.stiffness_kPa": Prior("lognormal", 40.0, 1.0),
    "tissue.ligaments.slack_stretch": Prior("uniform", 1.05, 1.4),
    "fascia.stiffness_kPa_per_mm": Prior("lognormal", 0.01, 0.7),
}
"""Prior of each uncertain number by key; the default of the key is its median. A number comes after the one it is a ratio to."""


def draws(n: int, seed: int) -> dict[str, np.ndarray]:
    """Draw n sets of the uncertain numbers, a Latin hypercube over all priors: key -> values (n,), the same for the same seed.

    Every number is stratified: one value in each n-th part of its distribution. The priors are independent, but for the ratios.
    """
    random = np.random.default_rng(seed)
    parts = random.permuted(np.tile(np.arange(n), (len(PRIORS), 1)), axis=1)
    shares = (parts + random.random(parts.shape)) / n
    drawn: dict[str, np.ndarray] = {}
    for share, (key, prior) in zip(shares, PRIORS.items(), strict=True):
        drawn[key] = prior.at(share) * (1.0 if prior.times is None else drawn[prior.times])
    return drawn
