"""Human utilization (2.5) and human performance (2.6)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.models.checks import between, in_order, mode_array, open_unit
from trustlab.models.compiled import njit


@njit
def yerkes_dodson(r, beta):
    """Return (r/β)^β ((1 − r)/(1 − β))^(1 − β): 0 at r = 0 and 1, 1 at r = β."""
    if r <= 0.0 or r >= 1.0:
        return 0.0
    return np.exp(beta * np.log(r / beta) + (1.0 - beta) * np.log((1.0 - r) / (1.0 - beta)))


@njit
def next_utilization(r, mode, a):
    """Return utilization one sample later, (2.5)."""
    return a * r + (1.0 - a) * mode


@njit
def performance_at(r, beta, p_min, p_max):
    """Return human performance at utilization r, (2.6)."""
    return (p_max - p_min) * yerkes_dodson(r, beta) + p_min


@njit
def performance_range(low, high, beta, p_min, p_max):
    """Return the least and greatest P_h of (2.6) over utilizations in [low, high]."""
    # (2.6) is concave with its maximum at β: the minimum is at an end, and so is the maximum unless
    # β lies between.
    at_low = performance_at(low, beta, p_min, p_max)
    at_high = performance_at(high, beta, p_min, p_max)
    return min(at_low, at_high), p_max if low <= beta <= high else max(at_low, at_high)


@njit
def human_performance(mode, a, beta, p_min, p_max, r0):
    """Simulate (2.5) from `r0` and evaluate (2.6) at each sample."""
    r = np.empty(mode.size)
    p_h = np.empty(mode.size)
    now = r0
    for k in range(mode.size):
        r[k] = now
        p_h[k] = performance_at(now, beta, p_min, p_max)
        now = next_utilization(now, mode[k], a)
    return r, p_h


@njit
def performance_curve(r, beta, p_min, p_max):
    """Evaluate (2.6) at each utilization in `r`."""
    p_h = np.empty(r.size)
    for k in range(r.size):
        p_h[k] = performance_at(r[k], beta, p_min, p_max)
    return p_h


@dataclass(frozen=True)
class HumanModel:
    """
    The operator's utilization, and their performance at a given utilization (Yerkes–Dodson).

    r(k+1) = a r(k) + (1 − a) M(k), equation (2.5), and
    P_h(k) = (P_max − P_min)(r/β)^β ((1 − r)/(1 − β))^(1 − β) + P_min, equation (2.6).

    Parameters
    ----------
    a : float
        a_r = 1 − 1/τ, the share of utilization that remains after one sample, in (0, 1). b_r is 1 −
        a.
    beta : float
        β, the utilization at which the operator performs best, in (0, 1); smaller for a harder
        task.
    p_min, p_max : float
        Human performance at r = 0 and r = 1, and at r = β, in the unit of the measure.

    Raises
    ------
    ValueError
        If a or beta is outside (0, 1) or p_min is not below p_max.

    Notes
    -----
    Saeidi, *Trust-based control of (semi)autonomous mobile robotic systems*, Section 2.2.3.

    Examples
    --------
    >>> human = HumanModel(a=0.9991, beta=0.74, p_min=0.391, p_max=0.4602)
    >>> round(float(human.performance(0.74)), 4)
    0.4602
    """

    a: float
    beta: float
    p_min: float
    p_max: float

    def __post_init__(self):
        a, beta = open_unit("a", self.a), open_unit("beta", self.beta)
        p_min, p_max = in_order("p_min", self.p_min, "p_max", self.p_max)
        self.__dict__.update(a=a, beta=beta, p_min=p_min, p_max=p_max)

    @property
    def b(self) -> float:
        """b_r = 1 − a_r = 1/τ, equation (2.5)."""
        return 1.0 - self.a

    @property
    def time_constant(self) -> float:
        """
        −1/ln a, in samples: after this many, 1/e of a deviation is left.

        τ of (2.5), 1/b, is half a sample more.
        """
        return -1.0 / np.log(self.a)

    def performance(self, r: float | np.ndarray) -> Any:
        """
        Return human performance at utilization `r`, equation (2.6).

        Parameters
        ----------
        r : float or array_like
            Utilization, in [0, 1].

        Returns
        -------
        float or numpy.ndarray
            Performance, of the shape of `r`.

        Raises
        ------
        ValueError
            If a utilization lies outside [0, 1].
        """
        array = np.asarray(r, dtype=float)
        inside = (array >= 0.0) & (array <= 1.0)
        if not inside.all():
            raise ValueError(f"utilization r must lie in [0, 1], got {array[~inside].flat[0]}")
        p_h = performance_curve(
            np.ascontiguousarray(array.ravel()), self.beta, self.p_min, self.p_max
        )
        return p_h.item() if array.ndim == 0 else p_h.reshape(array.shape)

    def simulate(self, mode: np.ndarray, r0: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """
        Simulate (2.5) and (2.6).

        Parameters
        ----------
        mode : array_like, shape (N,)
            1 manual, 0 autonomous, or a manual share in [0, 1], per sample.
        r0 : float
            Utilization at the first sample, in [0, 1]; 0 is a rested operator.

        Returns
        -------
        r : numpy.ndarray, shape (N,)
            Utilization; sample k + 1 follows from sample k.
        p_h : numpy.ndarray, shape (N,)
            Human performance.

        Raises
        ------
        ValueError
            If a mode or `r0` lies outside [0, 1].
        """
        start = between("r0", r0, 0.0, 1.0)
        return human_performance(mode_array(mode), self.a, self.beta, self.p_min, self.p_max, start)
