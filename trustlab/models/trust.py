"""Two-way trust from performance, (3.2)-(3.4), and the scalings it sets, (3.5)-(3.6)."""

import math
from dataclasses import dataclass

import numpy as np

from trustlab.models.checks import (
    array_between,
    between,
    finite_array,
    finite_number,
    in_order,
    positive,
)
from trustlab.models.compiled import njit
from trustlab.models.portable import exponential


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
    Return the scale of (3.5) at a trust, the same bits on every machine; far from the midpoint the
    exponential may be infinite, and the scale is `low`.
    """
    return low + (high - low) / (1.0 + exponential(steepness * (trust - midpoint)))


@njit
def trust_run(share, decay, gain, start):
    """
    Run trust, as a share of its range, over performance shares that are each held for one sample.
    """
    out, now = np.empty(share.size + 1), start
    for k in range(share.size):
        out[k] = now
        now = trust_step(now, share[k], decay, gain)
    out[share.size] = now
    return out


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
    >>> trust = TrustModel(a=0.2, b=0.2)
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
        for name in ("a", "b"):
            value = finite_number(name, getattr(self, name))
            if not 0.0 < value <= 1.0:
                raise ValueError(f"{name} must lie in (0, 1], got {value}")
            self.__dict__[name] = value
        t_min, t_max = in_order("t_min", self.t_min, "t_max", self.t_max)
        p_min, p_max = in_order("p_min", self.p_min, "p_max", self.p_max)
        self.__dict__.update(t_min=t_min, t_max=t_max, p_min=p_min, p_max=p_max)
        if self.b > self.a and not self.allow_unbounded:
            raise ValueError(
                f"with b = {self.b} > a = {self.a} trust settles above t_max at full performance, "
                "so that (3.4) does not hold; choose b ≤ a, or ask for it with "
                "allow_unbounded=True"
            )

    def _share(self, performance: float) -> float:
        value = between("performance", performance, self.p_min, self.p_max)
        return (value - self.p_min) / (self.p_max - self.p_min)

    def decay(self, sample_time: float) -> float:
        """
        Return the share of trust kept over a sample without performance.

        It is exp(−a T/(T_max − T_min)).

        Parameters
        ----------
        sample_time : float
            T [s], positive.

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
        return self.t_min + (self.t_max - self.t_min) * self.b / self.a * self._share(performance)

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
        span = self.t_max - self.t_min
        start = self.t_min if trust0 is None else finite_number("trust0", trust0)
        share = (values[:-1] - self.p_min) / (self.p_max - self.p_min)
        run = trust_run(
            share, self.decay(sample_time), self.b / self.a, (start - self.t_min) / span
        )
        return self.t_min + span * run


@dataclass(frozen=True)
class LogisticScaling:
    """
    A scale that falls smoothly from `high` to `low` as trust grows, equation (3.5).

    α = high − (high − low)/(1 + exp(−s (T − T_mid)/(T_max − T_min))). At the ends of trust it is
    within (high − low)/(1 + exp(s/2)) of its bounds, 0.7 % of the range for s = 10.

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
    >>> LogisticScaling(low=0.05, high=1.0).value(0.5)
    0.525
    """

    low: float
    high: float
    steepness: float = 10.0
    midpoint: float | None = None
    t_min: float = 0.0
    t_max: float = 1.0

    def __post_init__(self):
        _check_scaling(self)
        self.__dict__["steepness"] = finite_number("steepness", self.steepness)
        if self.steepness < 10.0:
            raise ValueError(
                "steepness must be at least 10, so that the scale nearly meets its bounds, got "
                f"{self.steepness}"
            )

    def value(self, trust):
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
        trust, steepness = _finite("trust", trust), self.steepness / (self.t_max - self.t_min)
        scales = np.vectorize(logistic_scale, otypes=[float])
        return _plain(scales(self.low, self.high, steepness, self.midpoint, trust))


@dataclass(frozen=True)
class StepScaling:
    """
    A scale that drops from `high` to `low` where trust reaches a threshold, equation (3.6).

    Parameters
    ----------
    low, high : float
        Bounds of the scale, 0 < low ≤ high.
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

    def __post_init__(self):
        _check_scaling(self)

    def value(self, trust):
        """
        Return the scale at a trust.

        Parameters
        ----------
        trust : float or array_like, shape (N,)
            Trust.

        Returns
        -------
        float or numpy.ndarray, shape (N,)
            low at and above the threshold, high below.
        """
        return _plain(np.where(_finite("trust", trust) >= self.midpoint, self.low, self.high))


def _check_scaling(scaling) -> None:
    low, high = finite_number("low", scaling.low), finite_number("high", scaling.high)
    if low > high:
        raise ValueError(f"low must not exceed high, got low = {low} and high = {high}")
    if not low > 0.0:
        raise ValueError(
            f"low must be positive, got {low}: a scale of zero leaves one-way teleoperation (3.1)"
        )
    t_min, t_max = in_order("t_min", scaling.t_min, "t_max", scaling.t_max)
    middle = (t_min + t_max) / 2.0
    if scaling.midpoint is not None:
        middle = finite_number("midpoint", scaling.midpoint)
    if not t_min < middle < t_max:
        raise ValueError(
            f"midpoint must lie strictly between t_min = {t_min} and t_max = {t_max}, got {middle}"
        )
    scaling.__dict__.update(low=low, high=high, midpoint=middle, t_min=t_min, t_max=t_max)


def _finite(name: str, values) -> np.ndarray:
    if np.ndim(values) == 0:
        return np.asarray(finite_number(name, values))
    return finite_array(name, values)


def _plain(values: np.ndarray):
    return float(values) if values.ndim == 0 else values
