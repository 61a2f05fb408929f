"""Turnover of cells, cytokine and collagen at a point: their rates of change."""

from __future__ import annotations

from typing import NamedTuple

from jax import Array

from ..core.law import Law, param


class Turnover(Law):
    r"""Rates of cells, cytokine (TGF-beta) and collagen that a mechanical signal H in [0, 1] raises.

    .. math::
        \dot m_f &= \left( p_f + p_{f,c} \frac{c}{K_{f,c} + c} + p_{f,t} H \right) \frac{\rho}{K_{f,\rho} + m_f}
                    - (d_f + d_{f,\rho c} \, \rho \, c) \, m_f \\
        \dot \rho &= \left( p_\rho + p_{\rho,c} \frac{c}{K_{\rho,c} + c} + p_{\rho,t} H \right)
                    \left( 1 - \frac{\rho}{K_{\rho,\rho}} \right) \rho - d_\rho \, \rho + x_\rho \, (1 - \rho) \\
        \dot c &= (p_c \, c + p_{c,t} H) \frac{\rho}{K_{c,c} + c} - d_c \, c + x_c \, (c_{phys} - c)

    Source: Guo, Mofrad & Buganza Tepole, Eqs (28)-(30). Interpretation: cells and collagen are relative to healthy tissue,
    cytokine to a maximum amount, so every rate is per time; the constants :math:`p_{\cdot,t^a}`, which stand alone in print,
    multiply the signal; the printed :math:`D_{\rho,\rho}` and :math:`D_{c,c}` are the rates of exchange :math:`x_\rho, x_c` with
    the surroundings. Defaults are those of the wound models of Buganza Tepole's group, with three exceptions: those models have
    no exchange, so its two rates are chosen here; and :math:`K_{\rho,\rho}` is 1.25 instead of 1, so that the cells of healthy
    tissue are in equilibrium, :math:`K_{\rho,\rho} (1 - d_\rho / p_\rho) = 1`. With their :math:`K_{f,\rho}`
    healthy collagen is in equilibrium too.

    Parameters
    ----------
    p_f : float or (...) array [1/s]
        Production of collagen without cytokine and signal.
    p_f_c : float or (...) array [1/s]
        Largest additional production of collagen by cytokine.
    p_f_t : float or (...) array [1/s]
        Additional production of collagen at a signal of 1.
    d_f : float or (...) array [1/s]
        Decay of collagen.
    d_f_rho_c : float or (...) array [1/s]
        Decay of collagen by cells under cytokine.
    K_f_c : float or (...) array [1]
        Cytokine at which its effect on collagen is one half.
    K_f_rho : float or (...) array [1]
        Collagen at which its production saturates.
    p_rho : float or (...) array [1/s]
        Proliferation of cells without cytokine and signal.
    p_rho_c : float or (...) array [1/s]
        Largest additional proliferation by cytokine.
    p_rho_t : float or (...) array [1/s]
        Additional proliferation at a signal of 1.
    d_rho : float or (...) array [1/s]
        Death of cells.
    x_rho : float or (...) array [1/s]
        Exchange of cells with healthy tissue.
    K_rho_c : float or (...) array [1]
        Cytokine at which its effect on proliferation is one half.
    K_rho_rho : float or (...) array [1]
        Cell density at which proliferation stops.
    p_c : float or (...) array [1/s]
        Production of cytokine by cells under cytokine.
    p_c_t : float or (...) array [1/s]
        Production of cytokine by cells at a signal of 1.
    d_c : float or (...) array [1/s]
        Decay of cytokine.
    x_c : float or (...) array [1/s]
        Exchange of cytokine with the surroundings.
    K_c_c : float or (...) array [1]
        Cytokine at which its production saturates.
    c_phys : float or (...) array [1]
        Cytokine of the surroundings.
    """

    p_f: float | Array = param("1/s", "p_f", low=0.0, default=0.002 / 3600, typed="1/h")
    p_f_c: float | Array = param("1/s", "p_f,c", low=0.0, default=0.002 / 3600, typed="1/h")
    p_f_t: float | Array = param("1/s", "p_f,t", low=0.0, default=0.002 / 3600, typed="1/h")
    d_f: float | Array = param("1/s", "d_f", low=0.0, default=0.00097 / 3600, typed="1/h")
    d_f_rho_c: float | Array = param("1/s", "d_f,rho", low=0.0, default=0.5 * 0.00097 / 3600, typed="1/h")
    K_f_c: float | Array = param("1", "K_f,c", above=0.0, default=1.0)
    K_f_rho: float | Array = param("1", "K_f,rho", above=0.0, default=0.002 / 0.00097 - 1.0)
    p_rho: float | Array = param("1/s", "p_rho", low=0.0, default=0.034 / 3600, typed="1/h")
    p_rho_c: float | Array = param("1/s", "p_rho,c", low=0.0, default=0.034 / 3600, typed="1/h")
    p_rho_t: float | Array = param("1/s", "p_rho,t", low=0.0, default=0.034 / 3600, typed="1/h")
    d_rho: float | Array = param("1/s", "d_rho", low=0.0, default=0.2 * 0.034 / 3600, typed="1/h")
    x_rho: float | Array = param("1/s", "D_rho,rho", low=0.0, default=0.034 / 3600, typed="1/h")
    K_rho_c: float | Array = param("1", "K_rho,c", above=0.0, default=0.1)
    K_rho_rho: float | Array = param("1", "K_rho,rho", above=0.0, default=1.25)
    p_c: float | Array = param("1/s", "p_c,c", low=0.0, default=90e-16 / 1e-4 / 3600, typed="1/h")
    p_c_t: float | Array = param("1/s", "p_c,t", low=0.0, default=300e-16 / 1e-4**2 / 3600, typed="1/h")
    d_c: float | Array = param("1/s", "d_c", low=0.0, default=0.01 / 3600, typed="1/h")
    x_c: float | Array = param("1/s", "D_c,c", low=0.0, default=0.01 / 3600, typed="1/h")
    K_c_c: float | Array = param("1", "K_c,c", above=0.0, default=1.0)
    c_phys: float | Array = param("1", "c_phys", low=0.0, default=0.0)

    def rates(self, has: Densities, signal: Array) -> Densities:
        """Return the rates [1/s] of cells, cytokine and collagen (...) [1] under a signal H (...) [1]; differentiable."""
        rho, c, m_f = has
        dividing = self.p_rho + self.p_rho_c * c / (self.K_rho_c + c) + self.p_rho_t * signal
        return Densities(
            rho=dividing * (1.0 - rho / self.K_rho_rho) * rho - self.d_rho * rho + self.x_rho * (1.0 - rho),
            c=(self.p_c * c + self.p_c_t * signal) * rho / (self.K_c_c + c)
            - self.d_c * c
            + self.x_c * (self.c_phys - c),
            m_f=self.deposition(has, signal) - (self.d_f + self.d_f_rho_c * rho * c) * m_f,
        )

    def deposition(self, has: Densities, signal: Array) -> Array:
        """Return the production rate of collagen, without decay (...) [1/s]."""
        making = self.p_f + self.p_f_c * has.c / (self.K_f_c + has.c) + self.p_f_t * signal
        return making * has.rho / (self.K_f_rho + has.m_f)


class Densities(NamedTuple):
    """Cells, cytokine and collagen of tissue, or their rates, each of shape (...)."""

    rho: Array
    """Cell density relative to healthy tissue [1]."""
    c: Array
    """Cytokine concentration relative to a maximum amount [1]."""
    m_f: Array
    """Collagen density relative to healthy tissue [1]."""
