"""
Filters at a port: the two-port of Proposition 3 as printed, its passivity margin, and the corrected
two-port.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    between,
    finite_array,
    of_class,
    positive,
)
from trustlab.models.records import first_order, signals
from trustlab.teleoperation.ports import PassivityError

SLACK = 1e-12


class PassivityMargin(NamedTuple):
    """
    What a two-port filter needs to be passive.

    Parameters
    ----------
    least_product : float
        max (Im H)² over all frequencies: the two-port is passive exactly when k_12 k_21 is at least
        this.
    frequency : float
        Where the maximum is [rad/s].
    """

    least_product: float
    frequency: float


def passivity_margin(numerator, denominator) -> PassivityMargin:
    """
    Return what the two-port [[k_21, H], [−H, k_12]] of (4.16)-(4.17) needs to be passive.

    Its Hermitian part [[k_21, i Im H], [−i Im H, k_12]] is positive semidefinite exactly when k_12,
    k_21 ≥ 0 and k_12 k_21 ≥ (Im H)², at every frequency. The maximum is found among the real roots
    of a polynomial, not on a grid.

    Parameters
    ----------
    numerator, denominator : array_like
        Coefficients of H(s), highest power first; stable and proper.

    Raises
    ------
    ValueError
        If H is improper or unstable.

    Notes
    -----
    Proposition 3 of Saeidi asks k_12, k_21 ≥ 0 only, as if u_1ᵀH u_2 − u_2ᵀH u_1 were zero.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.teleoperation.passivity_margin([10.0], [1.0, 10.0]).least_product
    0.25
    """
    top = np.trim_zeros(finite_array("numerator", numerator), "f")
    bottom = np.trim_zeros(finite_array("denominator", denominator), "f")
    if bottom.size < max(top.size, 1):
        raise ValueError("H must be proper: its numerator has a higher degree than its denominator")
    poles = np.roots(bottom)
    if (poles.real >= 0.0).any():
        pole = poles[np.argmax(poles.real)]
        raise ValueError(f"H must be stable, but its denominator has a root at {pole:.4g}")
    # Im H = Im(N(iω) D(−iω))/|D(iω)|²
    near, far = (np.poly1d(c * 1j ** np.arange(c.size - 1, -1, -1.0)) for c in (top, bottom))
    conjugate = np.poly1d(far.c.conj())
    imaginary, size = np.poly1d((near * conjugate).c.imag), np.poly1d((far * conjugate).c.real)
    flat = imaginary.deriv() * size - imaginary * size.deriv()
    places = np.abs(np.append(flat.roots, 0.0))  # one place too many does no harm
    heights = (imaginary(places) / size(places)) ** 2
    best = int(np.argmax(heights))
    return PassivityMargin(float(heights[best]), float(places[best]))


class FilterRun(NamedTuple):
    """
    What a two-port filter did with two signals, with its ledger.

    Parameters
    ----------
    t : numpy.ndarray, shape (N,)
        Time at the end of each sample [s].
    y_1, y_2 : numpy.ndarray, shape (N, n)
        Outputs of (4.16).
    supply : numpy.ndarray, shape (N,)
        ∫ u_1ᵀy_2 − u_2ᵀy_1 dτ: energy taken in [J].
    storage : numpy.ndarray, shape (N,)
        Energy held [J].
    """

    t: np.ndarray
    y_1: np.ndarray
    y_2: np.ndarray
    supply: np.ndarray
    storage: np.ndarray

    @property
    def generated(self) -> np.ndarray:
        """
        Energy given out beyond what was taken in and is no longer held [J], shape (N,); at most
        zero in a passive filter.
        """
        return self.storage - self.supply


@dataclass(frozen=True)
class TwoPortFilter(Checked):
    """
    The two-port of Fig. 4.5 with one pole, equation (4.16), in discrete time by the midpoint rule.

    y_1 = LP[u_1] − k_12 u_2, y_2 = k_21 u_1 + LP[u_2], LP = ω_c/(s + ω_c). With k_12 k_21 ≥ ¼ it is
    passive with the storage (k_21 ‖a‖² + k_12 ‖c‖²)/ω_c, a = LP[u_1], c = LP[u_2]; the ledger
    balances at every sample, not only in the limit.

    Parameters
    ----------
    cutoff : float
        ω_c [rad/s], positive.
    k12 : float
        Share of the force that is taken from the velocity [m/(N s)].
    k21 : float
        Damping [N s/m].
    require_passive : bool
        Refuse gains with k_12 k_21 < ¼.

    Raises
    ------
    PassivityError
        If the gains do not make the filter passive.
    ValueError
        If a number is not finite or has the wrong sign.
    """

    cutoff: Positive
    k12: NotNegative
    k21: NotNegative
    require_passive: bool = True

    def __post_init__(self):
        super().__post_init__()
        product = self.k12 * self.k21
        if self.require_passive and product < 0.25 * (1.0 - SLACK):
            raise PassivityError(
                f"the two-port filter is not passive: k_12 k_21 = {product:.4g}, and max (Im H)² = "
                "0.25; raise k12 or k21, or pass require_passive=False to see it fail"
            )

    def run(self, u_1: np.ndarray, u_2: np.ndarray, sample_time: float) -> FilterRun:
        """
        Filter two signals, from rest.

        Parameters
        ----------
        u_1, u_2 : array_like, shape (N, n) or (N,)
            Inputs: velocity at one port and force at the other; each sample held.
        sample_time : float
            T [s], positive.

        Raises
        ------
        ValueError
            If the inputs are not finite or differ in shape.
        """
        step = positive("sample_time", sample_time)
        first, second = signals(u_1=u_1, u_2=u_2)
        (a, held_a), (c, held_c) = (_low_pass(u, self.cutoff, step) for u in (first, second))
        y_1, y_2 = a - self.k12 * second, self.k21 * first + c
        supply = step * np.cumsum((first * y_2 - second * y_1).sum(axis=1))
        stored = (self.k21 * held_a**2 + self.k12 * held_c**2).sum(axis=1) / self.cutoff
        return FilterRun(step * np.arange(1, len(first) + 1), y_1, y_2, supply, stored)


def printed_filter(cutoff: float) -> TwoPortFilter:
    """
    Return the filter of Proposition 3 with k_12 = k_21 = 0, which the text calls lossless (4.18);
    it generates energy.

    Parameters
    ----------
    cutoff : float
        ω_c [rad/s].
    """
    return TwoPortFilter(cutoff, 0.0, 0.0, require_passive=False)


def corrected_filter(cutoff: float, impedance: float) -> TwoPortFilter:
    """
    Return the least that is passive, k_12 k_21 = ¼: k_21 = ½ impedance and k_12 = ½/impedance.

    Parameters
    ----------
    cutoff : float
        ω_c [rad/s].
    impedance : float
        k_21/k_12 is its square [N s/m]; the channel's b shares the cost between drag and yielding.
    """
    impedance = positive("impedance", impedance)
    return TwoPortFilter(cutoff, 0.5 / impedance, 0.5 * impedance)


def sinusoid_energy(
    two_port: TwoPortFilter, duration: float, sample_time: float = 1e-3
) -> FilterRun:
    """
    Run a two-port on u_1 = cos ω_c t, u_2 = sin ω_c t, which the printed filter turns into ½ unit
    of energy per second for ever.

    Parameters
    ----------
    two_port : TwoPortFilter
        The filter.
    duration : float
        Length [s], up to ten million samples.
    sample_time : float
        T [s].

    Raises
    ------
    ValueError
        If it is no filter, or a number is out of range.
    """
    of_class("two_port", two_port, TwoPortFilter)
    step = positive("sample_time", sample_time)
    length = between("duration", duration, step, 1e7 * step)
    phase = two_port.cutoff * step * (np.arange(round(length / step)) + 0.5)
    return two_port.run(np.cos(phase), np.sin(phase), step)


def _low_pass(u: np.ndarray, cutoff: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the midpoint output and the state after each sample of da/dt = ω_c (u − a)."""
    g = 0.5 * step * cutoff
    state = first_order(u, 2.0 * g / (1.0 + g), (1.0 - g) / (1.0 + g))
    return state - 0.5 * np.diff(state, axis=0, prepend=0.0), state
