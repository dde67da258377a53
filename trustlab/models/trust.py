"""Two-way trust from performance, (3.2)-(3.4), and the scales that follow it, (3.5)."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.models.checks import (
    Checked,
    Share,
    array_between,
    between,
    finite_number,
    positive,
    set_checked,
    set_in_order,
)
from trustlab.models.compiled import njit


@njit(error_model="numpy", forceinline=True)
def trust_step(trust, share, decay, gain):
    """
    Return trust one sample later, (3.2) or (3.3), as a share of its range.

    It is exact for a performance that is held over the sample.
    """
    return decay * trust + gain * (1.0 - decay) * share


@njit(error_model="numpy", forceinline=True)
def logistic_scale(low, high, steepness, midpoint, trust):
    """
    Return the scale of (3.5) at a trust.

    Far from the midpoint the exponential may be infinite, and the scale is `low`.
    """
    return low + (high - low) / (1.0 + np.exp(steepness * (trust - midpoint)))


@njit
def trust_run(share, decay, gain, start):
    """
    Run trust, as a share of its range, over performance shares that are each held for one sample.
    """
    trust = np.empty(share.size + 1)
    trust[0] = start
    for k in range(share.size):
        trust[k + 1] = trust_step(trust[k], share[k], decay, gain)
    return trust


@dataclass(frozen=True)
class TrustModel(Checked):
    """
    Trust that grows with performance and decays with its own level, (3.2) and (3.3).

    dT/dt = −a (T − T_min)/(T_max − T_min) + b (P − P_min)/(P_max − P_min). With b ≤ a trust stays
    between its bounds (3.4) for any performance within its range; with b > a it settles above T_max
    at full performance.

    Parameters
    ----------
    a : float
        Sensitivity to the present level of trust [1/s, times the range of trust], in (0, 1].
    b : float
        Sensitivity to performance, likewise, in (0, 1].
    t_min, t_max : float
        Range of trust.
    p_min, p_max : float
        Range of performance, of the robot in (3.2) and of the operator in (3.3).
    allow_unbounded : bool
        Accept b > a, with which (3.4) does not hold.

    Raises
    ------
    ValueError
        If a or b is outside (0, 1], a range is empty, or b > a and `allow_unbounded` is False.

    Notes
    -----
    Saeidi, Section 3.2. The text asks only 0 < a, b ≤ 1 for (3.4); b ≤ a is needed as well.

    Examples
    --------
    >>> import trustlab as tl
    >>> trust = tl.TrustModel(a=0.2, b=0.2)
    >>> round(trust.step(0.5, performance=1.0, sample_time=0.1), 6)
    0.509901
    """

    a: Share
    b: Share
    t_min: float = 0.0
    t_max: float = 1.0
    p_min: float = 0.0
    p_max: float = 1.0
    allow_unbounded: bool = False

    def __post_init__(self):
        super().__post_init__()
        set_checked(self, positive, "a", "b")
        set_in_order(self, "t_min", "t_max")
        set_in_order(self, "p_min", "p_max")
        if self.b > self.a and not self.allow_unbounded:
            raise ValueError(
                f"with b = {self.b} > a = {self.a} trust settles above t_max at full performance, "
                "so that (3.4) does not hold; choose b ≤ a, or ask for it with "
                "allow_unbounded=True"
            )

    def decay(self, sample_time: float) -> float:
        """
        Return exp(−a Δt/(T_max − T_min)): the share of trust that a sample without performance
        leaves.

        Parameters
        ----------
        sample_time : float
            Δt [s], positive.

        Raises
        ------
        ValueError
            If `sample_time` is not positive.
        """
        return math.exp(-self.a * positive("sample_time", sample_time) / (self.t_max - self.t_min))

    def steady_state(self, performance: float) -> float:
        """
        Return the steady-state trust for a constant performance.

        Parameters
        ----------
        performance : float
            Between p_min and p_max.
        """
        share = self._share(between("performance", performance, self.p_min, self.p_max))
        return self.t_min + (self.t_max - self.t_min) * self.b / self.a * share

    def step(self, trust: float, performance: float, sample_time: float) -> float:
        """
        Return trust one sample later, exactly, performance being held over the sample.

        Parameters
        ----------
        trust : float
            Trust now.
        performance : float
            Performance over the sample, between p_min and p_max.
        sample_time : float
            Length of the sample [s].

        Raises
        ------
        ValueError
            If an argument is not finite or out of range.
        """
        trust, decay = finite_number("trust", trust), self.decay(sample_time)
        return decay * trust + (1.0 - decay) * self.steady_state(performance)

    def simulate(
        self, performance: np.ndarray, sample_time: float, trust0: float | None = None
    ) -> np.ndarray:
        """
        Return trust along a record of performance, each sample held until the next.

        Parameters
        ----------
        performance : array_like, shape (N,)
            Between p_min and p_max.
        sample_time : float
            Length of a sample [s].
        trust0 : float, optional
            Trust at the first sample; T_min when not given.

        Returns
        -------
        numpy.ndarray, shape (N,)
            Sample k + 1 follows from sample k; the last performance has no effect.

        Raises
        ------
        ValueError
            If a sample is not finite or out of range.
        """
        values = array_between("performance", performance, self.p_min, self.p_max, "p_min, p_max")
        start = self.t_min if trust0 is None else finite_number("trust0", trust0)
        span, decay = self.t_max - self.t_min, self.decay(sample_time)
        share = self._share(values[:-1])
        return self.t_min + span * trust_run(
            share, decay, self.b / self.a, (start - self.t_min) / span
        )

    def _share(self, performance: Any) -> Any:
        return (performance - self.p_min) / (self.p_max - self.p_min)
