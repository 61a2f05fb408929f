"""Write biaxial.csv: synthetic biaxial measurements, with noise, of a tissue with known parameters.

Three ramps, equal stretch, more along x and more along y, each up to 1.25; noise of 0.05 kPa, seed 1.
"""

import csv
from pathlib import Path

import jax
import numpy as np

from cicatrix.materials.holzapfel import HolzapfelGasserOgden
from cicatrix.mechanics.point import Instant, control, history

LAW = HolzapfelGasserOgden(mu=2.0, k1=3.0, k2=1.5, angle=np.deg2rad(30.0))
NOISE_KPA = 0.05
RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
LARGEST = 0.25  # largest strain
ROWS = 16  # rows per ramp


def stretches() -> np.ndarray:
    """Return stretches along x and y (n, 2), one ramp after the other."""
    ramp = LARGEST * np.arange(1, ROWS + 1) / ROWS
    return 1.0 + np.concatenate([ramp[:, None] * ratio for ratio in RATIOS])


def measured(noise_kPa: float = NOISE_KPA, seed: int = 1) -> dict[str, np.ndarray]:
    """Return the columns, named as in the history.csv of a run."""
    xy = stretches()
    time_h = 0.01 * np.arange(len(xy))
    asked = Instant(3600.0 * time_h, np.column_stack([xy, np.zeros(len(xy))]), np.zeros(len(xy)))
    stress = np.asarray(jax.jit(history)(LAW, control(), asked).stress)
    noise = noise_kPa * np.random.Generator(np.random.Philox(seed)).standard_normal((2, len(xy)))
    return {
        "time_h": time_h,
        "lambda_x": xy[:, 0],
        "lambda_y": xy[:, 1],
        "sigma_x_kPa": stress[:, 0, 0] + noise[0],
        "sigma_y_kPa": stress[:, 1, 1] + noise[1],
    }


if __name__ == "__main__":
    table = measured()
    with Path(__file__).with_name("biaxial.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(table)
        writer.writerows([[f"{cell:.6g}" for cell in row] for row in zip(*table.values())])
