"""
Repeated-measures analyses of many studies at once: the engine under `repeated_measures` and under
campaigns.

All pairs of conditions come with them: paired t-tests, adjusted p-values and standardized
differences.
"""

from dataclasses import dataclass, fields
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy import special
from scipy.optimize import brentq

from trustlab.models.checks import not_negative, open_unit, positive
from trustlab.models.html import as_html
from trustlab.studies.analysis.score_table import ScoreTable
from trustlab.studies.analysis.sphericity import corrected_tests, mauchly, orthonormal_contrasts


@dataclass(frozen=True)
class PartialEtaInterval:
    """
    Interval of partial η² and of the noncentrality it comes from.

    Parameters
    ----------
    low, high : float
        Limits of partial η².
    noncentrality_low, noncentrality_high : float
        Limits of λ.
    level : float
        Coverage.
    """

    low: float
    high: float
    noncentrality_low: float
    noncentrality_high: float
    level: float


# Noncentrality beyond which the noncentral F of SciPy fails; the form for large λ has nine digits
# there, and η² all of its own.
_LARGE = 1e9


def noncentrality_limit(f: float, df1: float, df2: float, probability: float) -> float:
    """
    Return the λ ≥ 0 at which P(F′ ≤ f | λ) is `probability`; 0 where it is less even at λ = 0.
    """
    # F′ df1/df2 = χ′²(λ)/χ²(df2), where χ′²(λ) = λ + df1 to within √λ: only the denominator is left
    # to vary.
    large = df1 * (f * float(special.chdtri(df2, probability)) / df2 - 1.0)
    if large > _LARGE:
        return large

    def excess(noncentrality: float) -> float:
        return float(special.ncfdtr(df1, df2, noncentrality, f)) - probability

    if excess(0.0) <= 0.0:
        return 0.0
    high = max(1.0, 2.0 * df1 * f)
    while excess(high) > 0.0:
        high *= 2.0
    return float(brentq(excess, 0.0, high, xtol=1e-12 * high, rtol=1e-13, maxiter=500))


def partial_eta_interval(
    f: float, df1: float, df2: float, level: float = 0.90
) -> PartialEtaInterval:
    """
    Return the interval of partial η² that inverts the noncentral F distribution.

    With λ_low and λ_high such that P(F′ ≥ f | λ_low) = P(F′ ≤ f | λ_high) = (1 − level)/2, the
    limits are λ / (λ + df1 + df2): λ = n (k − 1) η²/(1 − η²) in the population (`noncentrality`),
    and n (k − 1) = df1 + df2. Where the test is corrected, both degrees of freedom are those times
    ε, and λ is ε times that of the uncorrected F (Box, 1954). Steiger (2004) has one more below,
    for designs between subjects. The customary level is 0.90: its lower limit is above 0 where the
    test's p is below 0.05.

    Parameters
    ----------
    f : float
        Observed F, at least 0.
    df1, df2 : float
        Degrees of freedom, above 0.
    level : float
        Coverage, in (0, 1).

    Raises
    ------
    ValueError
        If F is negative or a number is not finite.
    """
    f, level = not_negative("f", f), open_unit("level", level)
    df1, df2 = positive("df1", df1), positive("df2", df2)
    tail = 0.5 * (1.0 - level)
    low = noncentrality_limit(f, df1, df2, 1.0 - tail)
    high = noncentrality_limit(f, df1, df2, tail)
    total = df1 + df2
    return PartialEtaInterval(low / (low + total), high / (high + total), low, high, level)


def t_half_width(sd: Any, n: int, level: float = 0.95) -> Any:
    """Return half the width of the interval of a mean of n values, t · sd / √n."""
    return special.stdtrit(n - 1, 0.5 + 0.5 * level) * sd / np.sqrt(n)


def within_subject_sd(values: np.ndarray) -> np.ndarray:
    """
    Return each condition's standard deviation of scores less their subject's mean, times √(k/(k −
    1)).

    Removing the subjects' means (Cousineau, 2005) leaves the spread that a comparison within
    subjects sees; the factor (Morey, 2008) compensates for the variance that this removes. For k =
    2 the interval is 1/√2 times that of the paired difference.
    """
    k = values.shape[1]
    centred = values - values.mean()  # a common offset would cost digits in the subjects' means
    return (centred - centred.mean(axis=1, keepdims=True)).std(axis=0, ddof=1) * np.sqrt(
        k / (k - 1.0)
    )


def describe(scores: ScoreTable, level: float = 0.95) -> pd.DataFrame:
    """
    Return a row per condition: condition n mean sd se median minimum maximum, and both intervals of
    the mean.
    """
    values = scores.values
    n = len(values)
    mean, sd = values.mean(axis=0), values.std(axis=0, ddof=1)
    between, within = t_half_width(sd, n, level), t_half_width(within_subject_sd(values), n, level)
    columns = {
        "condition": pd.Index(scores.conditions, tupleize_cols=False),
        "n": n,
        "mean": mean,
        "sd": sd,
        "se": sd / np.sqrt(n),
        "median": np.median(values, axis=0),
        "minimum": values.min(axis=0),
        "maximum": values.max(axis=0),
        "ci_low": mean - between,
        "ci_high": mean + between,
        "ci_low_within": mean - within,
        "ci_high_within": mean + within,
    }
    return pd.DataFrame(columns)


# Scores analysed or drawn in one go, so that memory does not grow with the number of studies.
_CHUNK = 1 << 20

# Sizes of scores beyond which squares would overflow, and below which they would underflow.
_GREATEST, _LEAST = 1e140, 1e-100


@dataclass(frozen=True, eq=False)
class PairwiseBatch:
    """
    Pairwise statistics of many studies, shape (studies, pairs); NaN where every subject has the
    same difference.

    `a` and `b` are the positions of the two conditions, shape (pairs,), a before b; differences are
    a − b, intervals have 95 %, p-values are two-sided. d_z is the mean over the standard deviation
    of the differences, d_av the mean difference over the mean of the two conditions' standard
    deviations (Lakens, 2013).
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


def bonferroni(p: np.ndarray) -> np.ndarray:
    """
    Return p-values times their number, at most 1.

    Parameters
    ----------
    p : numpy.ndarray, shape (..., tests)
        Unadjusted p-values of one family along the last axis; NaN stay NaN and do not count, as in
        R's p.adjust.
    """
    count = (~np.isnan(p)).sum(axis=-1, keepdims=True)
    return np.minimum(count * p, 1.0)


def holm(p: np.ndarray) -> np.ndarray:
    """
    Return p-values adjusted step by step (Holm, 1979).

    Parameters
    ----------
    p : numpy.ndarray, shape (..., tests)
        Unadjusted p-values of one family along the last axis; NaN stay NaN and do not count, as in
        R's p.adjust.
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

    `scores` has shape (studies, subjects, conditions), `sd` are the conditions' standard
    deviations, and `rounding` is the spread of differences that rounding of the scores alone can
    cause, shape (studies,).
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


@dataclass(frozen=True, eq=False)
class Omnibus:
    """
    The test of equal means: floats for one study, arrays of shape (studies,) for many.

    Parameters
    ----------
    n, k : int
        Subjects and conditions.
    F : float
        Ratio of mean squares.
    df1, df2 : int
        k − 1 and (n − 1)(k − 1).
    p : float
        Sphericity assumed.
    ss_effect, ss_subjects, ss_error : float
        Sums of squares.
    mauchly_w, mauchly_chi2, mauchly_p, mauchly_p_first_order : float
        Mauchly's test, its p with and without the second-order term; NaN for k = 2, for n ≤ k − 1
        and where the covariance of the contrasts is singular.
    mauchly_df : int
        k (k − 1)/2 − 1.
    epsilon_gg, epsilon_hf, epsilon_hf_untruncated : float
        Greenhouse–Geisser and Huynh–Feldt ε, the latter cut at 1 and not.
    p_gg, p_hf : float
        p with degrees of freedom times ε.
    eta2_partial, eta2_generalized : float
        SS_effect over SS_effect + SS_error, and over the sum of all three.
    """

    n: int
    k: int
    F: Any
    df1: int
    df2: int
    p: Any
    ss_effect: Any
    ss_subjects: Any
    ss_error: Any
    mauchly_w: Any
    mauchly_chi2: Any
    mauchly_df: int
    mauchly_p: Any
    mauchly_p_first_order: Any
    epsilon_gg: Any
    epsilon_hf: Any
    epsilon_hf_untruncated: Any
    p_gg: Any
    p_hf: Any
    eta2_partial: Any
    eta2_generalized: Any


@dataclass(frozen=True, eq=False)
class RepeatedMeasuresBatch(Omnibus):
    """
    One-way repeated-measures analyses of many studies: every field of `Omnibus` as an array, and
    the following.

    Parameters
    ----------
    mean, sd : numpy.ndarray, shape (studies, k)
        Of each condition.
    pairwise : PairwiseBatch
        Every pair of conditions.
    """

    mean: np.ndarray
    sd: np.ndarray
    pairwise: PairwiseBatch

    def study(self, s: int) -> dict[str, Any]:
        """
        Return the fields of `Omnibus` of one study.

        Parameters
        ----------
        s : int
            Its position.
        """
        values = {field.name: getattr(self, field.name) for field in fields(Omnibus)}
        return {name: float(v[s]) if np.ndim(v) else v for name, v in values.items()}

    def __len__(self) -> int:
        return self.F.size

    def table(self) -> pd.DataFrame:
        """Return one row per study with every omnibus statistic; index `study`."""
        columns = {field.name: getattr(self, field.name) for field in fields(Omnibus)}
        return pd.DataFrame(columns, index=pd.RangeIndex(len(self), name="study"))

    def pairs(self) -> pd.DataFrame:
        """
        Return one row per study and pair; columns study a b (positions of the conditions)
        mean_difference … d_av.
        """
        studies, pairs = self.pairwise.t.shape
        keys = {
            "study": np.repeat(np.arange(studies), pairs),
            "a": np.tile(self.pairwise.a, studies),
            "b": np.tile(self.pairwise.b, studies),
        }
        statistics = self.pairwise.statistics().items()
        values = {name: np.ravel(value) if np.ndim(value) else value for name, value in statistics}
        return pd.DataFrame(keys | values)

    def __repr__(self) -> str:
        return (
            f"RepeatedMeasuresBatch({len(self)} studies of {self.n} subjects × {self.k} conditions)"
        )

    def _repr_html_(self) -> str:
        return as_html(repr(self), self.table().describe().T)


def checked_scores(array: np.ndarray) -> np.ndarray:
    """
    Return scores as floats of shape (studies, subjects, conditions), each finite and of a size that
    can be squared.
    """
    try:
        given = np.asarray(array)
    except ValueError:
        given = np.empty(0, dtype=object)
    if given.dtype.kind not in "fiu":
        raise ValueError(
            f"array must hold real numbers, got {type(array).__name__} of dtype {given.dtype}"
        )
    if given.ndim != 3:
        raise ValueError(
            f"array must have three axes (study, subject, condition), got {given.shape}: one "
            "study is array[None]"
        )
    studies, n, k = given.shape
    if studies < 1:
        raise ValueError(f"array holds no study: its shape is {given.shape}")
    if n < 3 or k < 2:
        found = f"{n} subject(s) and {k} condition(s)"
        raise ValueError(f"every study needs at least 3 subjects and 2 conditions, got {found}")
    scores = given.astype(float, copy=False)
    bad = ~np.isfinite(scores)
    if bad.any():
        s, i, j = np.argwhere(bad)[0]
        found = f"{scores[s, i, j]}, not a finite number"
        raise ValueError(f"array[{s}, {i}, {j}] (study {s}, subject {i}, condition {j}) is {found}")
    largest = np.abs(scores).max(axis=(1, 2))
    out = (largest > _GREATEST) | ((largest > 0.0) & (largest < _LEAST))
    if out.any():
        found = f"study {int(np.argmax(out))} has scores of size {largest[np.argmax(out)]:.3g}"
        raise ValueError(f"{found}, whose squares no number holds; use another unit")
    return scores


def chunks(studies: int, scores: int) -> list[range]:
    """
    Return the numbers of studies of so many scores each, in the parts in which they are analysed or
    drawn.
    """
    step = max(1, _CHUNK // scores)
    return [range(first, min(first + step, studies)) for first in range(0, studies, step)]


def _analyse(scores: np.ndarray, first: int) -> dict:
    """Return every statistic of some studies; `first` is the number of the first, for errors."""
    studies, n, k = scores.shape
    d = k - 1
    rounding = (
        4.0 * np.finfo(float).eps * np.abs(scores).max(axis=(1, 2))
    )  # a spread of differences below this is no variance
    grand = scores.mean(axis=(1, 2))
    centred = scores - grand[:, None, None]
    mean = centred.mean(axis=1)
    residual = centred - mean[:, None, :]
    sd = np.sqrt(np.einsum("snk,snk->sk", residual, residual) / (n - 1))
    contrasts = orthonormal_contrasts(k)
    within = (residual.reshape(-1, k) @ contrasts).reshape(studies, n, d)
    covariance = np.matmul(within.transpose(0, 2, 1), within) / (n - 1)
    ss_effect = n * ((mean @ contrasts) ** 2).sum(axis=1)
    ss_error = (n - 1) * np.trace(covariance, axis1=1, axis2=2)
    ss_subjects = (residual.sum(axis=2) ** 2).sum(axis=1) / k
    flat = ss_error <= (n - 1) * d * rounding**2
    if flat.any():
        study = int(np.argmax(flat))
        effect = bool(ss_effect[study] > n * d * rounding[study] ** 2)
        raise ValueError(f"study {first + study}: {_why_flat(scores[study], effect)}")
    sphericity = mauchly(covariance, n, rounding**2)
    return {
        "mean": scores.mean(axis=1),
        "sd": sd,
        "ss_effect": ss_effect,
        "ss_subjects": ss_subjects,
        "ss_error": ss_error,
        "mauchly_w": sphericity.w,
        "mauchly_chi2": sphericity.chi2,
        "mauchly_p": sphericity.p,
        "mauchly_p_first_order": sphericity.p_first_order,
        "eta2_generalized": ss_effect / (ss_effect + ss_subjects + ss_error),
        "pairwise": paired_differences(centred, sd, rounding),
    } | corrected_tests(ss_effect, ss_error, covariance, 1, n - 1)


def _why_flat(values: np.ndarray, effect: bool) -> str:
    """Return why a study has no error variance; `effect` says whether its conditions differ."""
    if np.ptp(values) == 0.0:
        return f"every score is {values.flat[0]:g}; there is nothing to analyse"
    found = "all subjects differ by the same amounts" if effect else "no subject's scores differ"
    return (
        f"the error variance is zero ({found} between conditions), so that F and t are not defined"
    )


def repeated_measures_batch(array: np.ndarray) -> RepeatedMeasuresBatch:
    """
    Analyse many studies of the same size at once.

    Parameters
    ----------
    array : array_like, shape (studies, subjects, conditions)
        Complete finite scores.

    Returns
    -------
    RepeatedMeasuresBatch

    Raises
    ------
    ValueError
        If `array` has another shape, fewer than 3 subjects or 2 conditions, a score that is not a
        finite number, or a study without error variance; the study, subject and condition are
        named.

    Notes
    -----
    Sums of squares come from orthonormal contrasts of the centred scores, so that a large common
    offset costs no digits beyond those that the scores themselves have lost.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> studies = np.random.default_rng(0).normal(size=(1000, 12, 3)) + [0.0, 0.2, 0.8]
    >>> batch = tl.repeated_measures_batch(studies)
    >>> float((batch.p < 0.05).mean())
    0.382
    """
    scores = checked_scores(array)
    studies, n, k = scores.shape
    parts = [
        _analyse(scores[part.start : part.stop], part.start) for part in chunks(studies, n * k)
    ]
    pairs = _joined([vars(part.pop("pairwise")) for part in parts])
    return RepeatedMeasuresBatch(
        n=n,
        k=k,
        df1=k - 1,
        df2=(k - 1) * (n - 1),
        mauchly_df=k * (k - 1) // 2 - 1,
        pairwise=PairwiseBatch(**pairs),
        **_joined(parts),
    )


def _joined(parts: list[dict]) -> dict:
    """
    Put the arrays of all chunks below each other; what is one for all studies (a, b, df) comes from
    the first.
    """
    return {
        name: value if name in ("a", "b", "df") else np.concatenate([part[name] for part in parts])
        for name, value in parts[0].items()
    }


def analyse_table(scores: ScoreTable) -> RepeatedMeasuresBatch:
    """Analyse one complete table as a batch of one; an error names its columns."""
    try:
        return repeated_measures_batch(scores.values[None])
    except ValueError as error:
        why = str(error).removeprefix("study 0: ")
        raise ValueError(f"dv: column {scores.dv!r} by {scores.within!r}: {why}") from None
