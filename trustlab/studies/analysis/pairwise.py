"""All pairs of conditions: paired t-tests, adjusted p-values and standardized differences; arrays of studies at once."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import special

from trustlab.studies.analysis.descriptives import t_half_width


@dataclass(frozen=True, eq=False)
class PairwiseBatch:
    """
    Pairwise statistics of many studies, shape (studies, pairs); NaN where every subject has the same difference.

    `a` and `b` are the positions of the two conditions, shape (pairs,), a before b; differences are a − b, intervals
    have 95 %, p-values are two-sided. d_z is the mean over the standard deviation of the differences, d_av the mean
    difference over the mean of the two conditions' standard deviations (Lakens, 2013).
    """

    a: np.ndarray
    b: np.ndarray
    mean_difference: np.ndarray
    sd_difference: np.ndarray
    ci_low: np.ndarray
    ci_high: np.ndarray
    t: np.ndarray
    df: int
    p: np.ndarray
    p_bonferroni: np.ndarray
    p_holm: np.ndarray
    d_z: np.ndarray
    d_av: np.ndarray

    def statistics(self) -> dict[str, np.ndarray]:
        """Return what tables show, by name and in their order."""
        hidden = ("a", "b", "sd_difference")
        return {name: value for name, value in vars(self).items() if name not in hidden}

    def scaled(self, unit: np.ndarray) -> "PairwiseBatch":
        """Return the statistics of scores that are `unit` times as large, shape (studies,)."""
        lengths = ("mean_difference", "sd_difference", "ci_low", "ci_high")
        return replace(self, **{name: getattr(self, name) * unit[:, None] for name in lengths})


def bonferroni(p: np.ndarray) -> np.ndarray:
    """
    Return p-values times their number, at most 1.

    Parameters
    ----------
    p : numpy.ndarray, shape (..., tests)
        Unadjusted p-values of one family along the last axis; NaN stay NaN and do not count, as in R's p.adjust.
    """
    count = (~np.isnan(p)).sum(axis=-1, keepdims=True)
    return np.minimum(count * p, 1.0)


def holm(p: np.ndarray) -> np.ndarray:
    """
    Return p-values adjusted step by step (Holm, 1979).

    Parameters
    ----------
    p : numpy.ndarray, shape (..., tests)
        Unadjusted p-values of one family along the last axis; NaN stay NaN and do not count, as in R's p.adjust.
    """
    count = (~np.isnan(p)).sum(axis=-1, keepdims=True)
    order = np.argsort(p, axis=-1, kind="stable")  # NaN last
    steps = np.maximum(count - np.arange(p.shape[-1]), 1)
    ascending = np.take_along_axis(p, order, axis=-1)
    adjusted = np.minimum(np.maximum.accumulate(steps * ascending, axis=-1), 1.0)
    result = np.empty_like(p)
    np.put_along_axis(result, order, adjusted, axis=-1)
    return result


def paired_differences(scores: np.ndarray, sd: np.ndarray, rounding: np.ndarray) -> PairwiseBatch:
    """
    Compare every pair of conditions by a paired t-test.

    `scores` has shape (studies, subjects, conditions), `sd` are the conditions' standard deviations, and `rounding` is
    the spread of differences that rounding of the scores alone can cause, shape (studies,).
    """
    studies, n, k = scores.shape
    a, b = np.array(list(combinations(range(k), 2))).T
    mean = np.empty((studies, a.size))
    spread = np.empty((studies, a.size))
    for pair in range(a.size):  # pair by pair: all at once would not fit the cache
        difference = scores[:, :, a[pair]] - scores[:, :, b[pair]]
        mean[:, pair] = difference.mean(axis=1)
        difference -= mean[:, pair, None]
        spread[:, pair] = np.sqrt(np.einsum("sn,sn->s", difference, difference) / (n - 1))
    sd_difference = np.where(spread <= rounding[:, None], 0.0, spread)
    divisor = np.where(sd_difference > 0.0, sd_difference, np.nan)
    t = mean / (divisor / np.sqrt(n))
    p = 2.0 * special.stdtr(n - 1, -np.abs(t))
    half = t_half_width(divisor, n)
    average = 0.5 * (sd[:, a] + sd[:, b])
    return PairwiseBatch(
        a=a,
        b=b,
        mean_difference=mean,
        sd_difference=sd_difference,
        ci_low=mean - half,
        ci_high=mean + half,
        t=t,
        df=n - 1,
        p=p,
        p_bonferroni=bonferroni(p),
        p_holm=holm(p),
        d_z=mean / divisor,
        d_av=mean / np.where(average > 0.0, average, np.nan),
    )
