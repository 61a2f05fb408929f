"""Laws written in plain NumPy, with their own tangents, and the same laws in JAX."""

import numpy as np
from maxwell_fibre import MaxwellFibre

from cicatrix.materials.compose import Sum
from cicatrix.materials.external import Answer, ExternalMaterial
from cicatrix.materials.neo_hookean import NeoHookean

UNIT = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))


def neo_hookean(F, state, dt, mu, kappa):
    """mu/2 (J^(-2/3) I1 - 3) + kappa/2 (J - 1)^2, with d(F^-T)_iJ / dF_kL = -H_iL H_kJ, H = F^-T."""
    J, H = np.linalg.det(F), np.linalg.inv(F).swapaxes(1, 2)
    I1, g = np.einsum("nij,nij->n", F, F), mu * J ** (-2 / 3)
    energy = 0.5 * (g * I1 - 3 * mu) + 0.5 * kappa * (J - 1) ** 2
    factor = kappa * (J - 1) * J - g * I1 / 3  # P = g F + factor H
    P = np.einsum("n,nij->nij", g, F) + np.einsum("n,nij->nij", factor, H)
    HH, HF = np.einsum("nij,nkl->nijkl", H, H), np.einsum("nij,nkl->nijkl", H, F)
    by_J = kappa * (2 * J - 1) * J + 2 / 9 * g * I1
    A = np.einsum("n,ijkl->nijkl", g, UNIT) + np.einsum("n,nijkl->nijkl", by_J, HH)
    A -= 2 / 3 * np.einsum("n,nijkl->nijkl", g, HF + HF.transpose(0, 3, 4, 1, 2))
    A -= np.einsum("n,nil,nkj->nijkl", factor, H, H)
    return Answer(energy, P, A)


def standard_solid(F, state, dt, mu, kappa, E, tau):
    """The law above and a Maxwell fibre along x: E/2 (e - v)^2, e = ln |F e_x|, v' = (e - v) / tau by backward Euler."""
    ground, f = neo_hookean(F, state, dt, mu, kappa), F[:, :, 0]
    C, before, a = np.einsum("ni,ni->n", f, f), state[:, 0], dt / tau
    e = 0.5 * np.log(C)
    after = (before + a * e) / (1 + a)
    pull = E * (e - after)
    P, A = ground.P.copy(), ground.A.copy()
    P[:, :, 0] += (pull / C)[:, None] * f
    A[:, :, 0, :, 0] += np.einsum("n,ni,nk->nik", (E / (1 + a) - 2 * pull) / C**2, f, f)
    A[:, :, 0, :, 0] += np.einsum("n,ik->nik", pull / C, np.eye(3))
    energy = ground.energy + 0.5 * E * (e - after) ** 2
    return Answer(energy, P, A, after[:, None], pull * (after - before))


MU, KAPPA, E, TAU = 2.0, 20.0, 3.0, 2.0  # kPa, kPa, kPa, s
ELASTIC = ExternalMaterial(neo_hookean, (MU, KAPPA))
VISCOUS = ExternalMaterial(standard_solid, (MU, KAPPA, E, TAU), initial_history=(0.0,))
IN_JAX = {"elastic": NeoHookean(MU, KAPPA), "viscous": Sum((NeoHookean(MU, KAPPA), MaxwellFibre(E, TAU)))}
OUTSIDE = {"elastic": ELASTIC, "viscous": VISCOUS}
