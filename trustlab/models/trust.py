"""Two-way trust from performance, (3.2)-(3.4), and the scalings it sets, (3.5)-(3.6)."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.models.checks import (
    array_between,
    between,
    finite_array,
    finite_number,
    flag,
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
class TrustModel:
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

    a: float
    b: float
    t_min: float = 0.0
    t_max: float = 1.0
    p_min: float = 0.0
    p_max: float = 1.0
    allow_unbounded: bool = False

    def __post_init__(self):
        set_checked(self, _sensitivity, "a", "b")
        set_in_order(self, "t_min", "t_max")
        set_in_order(self, "p_min", "p_max")
        if not flag("allow_unbounded", self.allow_unbounded) and self.b > self.a:
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


def _sensitivity(name: str, value: Any) -> float:
    number = finite_number(name, value)
    if not 0.0 < number <= 1.0:
        raise ValueError(f"{name} must lie in (0, 1], got {number}")
    return number


class _Scaling:
    """What both scalings share: bounds, the middle of the range of trust, and their checks."""

    low: float
    high: float
    midpoint: float | None
    t_min: float
    t_max: float

    def __post_init__(self):
        set_checked(self, finite_number, "low", "high")
        if self.low > self.high:
            raise ValueError(
                f"low must not exceed high, got low = {self.low} and high = {self.high}"
            )
        if not self.low > 0.0:
            raise ValueError(
                f"low must be positive, got {self.low}: a scale of zero leaves one-way "
                "teleoperation (3.1)"
            )
        set_in_order(self, "t_min", "t_max")
        if self.midpoint is None:
            self.__dict__["midpoint"] = (self.t_min + self.t_max) / 2.0
        set_checked(self, finite_number, "midpoint")
        if not self.t_min < self.midpoint < self.t_max:
            raise ValueError(
                f"midpoint must lie strictly between t_min = {self.t_min} and t_max = "
                f"{self.t_max}, got {self.midpoint}"
            )

    def value(self, trust: float | np.ndarray) -> Any:
        """
        Return the scale at a trust.

        Parameters
        ----------
        trust : float or array_like, shape (N,)
            Trust; the scale is defined outside its range as well.

        Returns
        -------
        float or numpy.ndarray, shape (N,)
            The scale, between low and high.
        """
        if np.ndim(trust) == 0:
            return self._scale(finite_number("trust", trust))
        return np.array([self._scale(level) for level in finite_array("trust", trust)])

    def _scale(self, trust: float) -> float:
        raise NotImplementedError


@dataclass(frozen=True)
class LogisticScaling(_Scaling):
    """
    A scale that falls smoothly from `high` to `low` as trust grows, equation (3.5).

    α = high − (high − low)/(1 + exp(−s (T − T_mid)/(T_max − T_min))). With T_mid in the middle
    it ends within (high − low)/(1 + exp(s/2)) of its bounds, 0.7 % of the range for s = 10.

    Parameters
    ----------
    low, high : float
        Bounds of the scale, 0 < low ≤ high.
    steepness : float
        s; at least 10 so that the bounds are nearly met (Section 3.2).
    midpoint : float, optional
        Trust at which the scale is half-way; the middle of the range when not given.
    t_min, t_max : float
        Range of trust.

    Raises
    ------
    ValueError
        If low is not positive (that would make teleoperation unilateral), bounds are in the wrong
        order, s is below 10, or the midpoint is outside the range of trust.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.models.LogisticScaling(low=0.05, high=1.0).value(0.5)
    0.525
    """

    low: float
    high: float
    steepness: float = 10.0
    midpoint: float | None = None
    t_min: float = 0.0
    t_max: float = 1.0

    def __post_init__(self):
        super().__post_init__()
        set_checked(self, finite_number, "steepness")
        if self.steepness < 10.0:
            raise ValueError(
                "steepness must be at least 10, so that the scale nearly meets its bounds, got "
                f"{self.steepness}"
            )

    def _scale(self, trust):
        steepness = self.steepness / (self.t_max - self.t_min)
        return logistic_scale(self.low, self.high, steepness, self.midpoint, trust)


@dataclass(frozen=True)
class StepScaling(_Scaling):
    """
    A scale that drops from `high` to `low` where trust reaches a threshold, equation (3.6).

    Parameters
    ----------
    low, high : float
        Bounds of the scale, 0 < low ≤ high; it is low at the threshold itself.
    midpoint : float, optional
        The threshold of trust, strictly inside its range; the middle when not given.
    t_min, t_max : float
        Range of trust.

    Raises
    ------
    ValueError
        If low is not positive, bounds are in the wrong order, or the threshold is outside the range
        of trust.

    Notes
    -----
    Printed as α' = α_max + (α_min − α_max) H(T − b): falling in trust, as (3.5) is (Remark 9), H(0)
    = 1.
    """

    low: float
    high: float
    midpoint: float | None = None
    t_min: float = 0.0
    t_max: float = 1.0

    def _scale(self, trust):
        return self.low if trust >= self.midpoint else self.high
