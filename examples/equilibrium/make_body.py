"""Write body.vtu: a column of soft tissue, 20 x 20 x 60 mm, that hangs from its upper end, with its tissue."""

from pathlib import Path

import numpy as np
import skfem

from cicatrix.files.vtu import write_vtu
from cicatrix.geometry.tetrahedra import oriented

N_ACROSS, N_ALONG = 3, 9  # elements
mesh = skfem.MeshTet.init_tensor(*[np.linspace(0.0, 20.0, N_ACROSS + 1)] * 2, np.linspace(-60.0, 0.0, N_ALONG + 1))
points, tetrahedra = mesh.p.T.copy(), oriented(mesh.p.T, mesh.t.T)
n = len(tetrahedra)
tissue = {"youngs_modulus_kPa": np.full(n, 3.0), "poisson_ratio": np.full(n, 0.49), "density_kg_m3": np.full(n, 1000.0)}
write_vtu(Path(__file__).parent / "body.vtu", points, tetrahedra, {"fixed": (points[:, 2] > -1e-9).astype(int)}, tissue)
