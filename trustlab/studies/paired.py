"""Two conditions: paired t-test, equivalence, and Bayes factor; two or more, pair by pair."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import between, open_unit, positive
from trustlab.studies.pairs import holm, normality
from trustlab.studies.repeated_measures import RepeatedMeasures, repeated_measures
from trustlab.studies.table import Tested, labelled
from trustlab.studies.words import apa_pair


@dataclass(frozen=True, eq=False, repr=False)
class PairedTTest(Tested):
    """
    A dependent t-test, difference a − b.

    Every column of `table` is an attribute too: the conditions a and b; n, the subjects compared;
    mean_difference and sd_difference, with the interval of the mean, ci_low and ci_high, at the
    level confidence; Student's t on df = n − 1 degrees of freedom and its two-sided p; d_z, the
    mean over the standard deviation of the differences, with its interval d_z_low, d_z_high, which
    inverts the noncentral t distribution, exact to four digits; d_av, over the mean of both
    standard deviations; correlation of a and b, NaN if one of them is constant; shapiro_w and
    shapiro_p, Shapiro and Wilk's test of the differences, NaN for more than 5,000 subjects.

    Parameters
    ----------
    tests : pandas.DataFrame
        What `table` returns.
    analysis : RepeatedMeasures
        The analysis of both conditions: its scores, and whom it left out.
    """

    title = "Paired t-test"

    tests: pd.DataFrame
    analysis: RepeatedMeasures

    def descriptives(self) -> pd.DataFrame:
        """Return descriptive statistics as `RepeatedMeasures.descriptives`."""
        return self.analysis.descriptives()

    def apa(self) -> str:
        """Return the sentence a paper needs."""
        return apa_pair(self)


COLUMNS = ["a", "b", "n", "mean_difference", "sd_difference", "ci_low", "ci_high", "confidence"]
COLUMNS += ["t", "df", "p", "d_z", "d_z_low", "d_z_high", "d_av", "correlation", "shapiro_w"]
COLUMNS += ["shapiro_p"]


def paired_t_test(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    order: Sequence[Hashable] | None = None,
    confidence: float = 0.95,
    missing: str = "raise",
) -> PairedTTest:
    """
    Compare two conditions within subjects: t = mean(a − b)/(s/√n) on n − 1 degrees of freedom.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and condition.
    dv, within, subject : hashable
        Columns with the score, the condition (two of them) and the subject.
    order : sequence, optional
        The two conditions, a then b. By default sorted, or in the order of a categorical column.
    confidence : float
        Level of the intervals; the sentence judges p at 1 − confidence.
    missing : {"raise", "listwise"}
        Whether a missing score is an error, or its subject is left out and named in the result.

    Returns
    -------
    PairedTTest

    Raises
    ------
    ValueError
        If the table is refused (see `repeated_measures`), there are not exactly two conditions, or
        every subject has the same difference.

    References
    ----------
    D. Lakens, Calculating and reporting effect sizes, Frontiers in Psychology 4 (2013) 863.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> values = {"subject": [1, 1, 2, 2, 3, 3], "mode": ["A", "B"] * 3}
    >>> frame = pd.DataFrame(values).assign(error=[1.0, 1.4, 1.1, 1.9, 0.8, 1.0])
    >>> test = tl.paired_t_test(frame, dv="error", within="mode", subject="subject")
    >>> test.table()[["mean_difference", "t", "df", "p"]].round(3)
       mean_difference      t  df      p
    0           -0.467 -2.646   2  0.118
    """
    result = repeated_measures(frame, dv, within, subject, order=order, missing=missing)
    if result.k != 2:
        raise ValueError(
            f"within: column {within!r} has {result.k} conditions, {[*result.conditions]}; a "
            "paired t-test compares two. Select their rows, or use repeated_measures"
        )
    a, b = result.scores.to_numpy().T
    shapiro = normality(a, b)
    test = result.pairs(confidence=confidence).assign(
        n=result.n,
        sd_difference=(a - b).std(ddof=1),
        confidence=confidence,
        correlation=result.scores.corr().iloc[0, 1],
        shapiro_w=shapiro["W"],
        shapiro_p=shapiro["p"],
    )
    return PairedTTest(labelled(test[COLUMNS], result.origin), result)


def equivalence(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    bound: float,
    order: Sequence | None = None,
    missing: str = "raise",
    alpha: float = 0.05,
) -> pd.DataFrame:
    """
    Test every pair of conditions for equivalence by two one-sided paired t-tests.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and condition.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject.
    bound : float
        Smallest difference that would matter, in units of the score; positive.
    order : sequence, optional
        The order of the conditions.
    missing : {"raise", "listwise"}
        Whether a missing cell is an error, or its subject is left out; `.attrs["excluded"]` names
        them.
    alpha : float
        Level of both tests, below 0.5.

    Returns
    -------
    pandas.DataFrame
        A row per pair: a, b, n, mean_difference (a − b), low, high (the bounds), t_low, p_low
        (against differences at or below `low`), t_high, p_high, df, p (the greater of the two),
        p_holm, ci_low, ci_high (level 1 − 2 alpha; inside the bounds where p < alpha), equivalent
        (p < alpha, unadjusted).

    Raises
    ------
    ValueError
        If the table is refused (see `repeated_measures`), every subject has the same difference, or
        an argument is out of range.

    References
    ----------
    D. Lakens, Equivalence tests: a practical primer, Social Psychological and Personality Science 8
    (2017) 355-362.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> tests = tl.equivalence(frame, dv="value", within="condition", subject="subject", bound=10.0)
    >>> tests[["a", "b", "equivalent"]].head(3)
        a   b  equivalent
    0  C1  C2        True
    1  C1  C3       False
    2  C1  C4        True
    """
    bound, alpha = positive("bound", bound), open_unit("alpha", alpha)
    if alpha >= 0.5:
        raise ValueError(f"alpha must be below 0.5, as the interval has 1 − 2 alpha, got {alpha}")
    result = repeated_measures(frame, dv, within, subject, order=order, missing=missing)
    level = 1.0 - 2.0 * alpha
    pairs, df = _tested(result, level), result.n - 1
    mean = pairs["mean_difference"]
    error = (pairs["ci_high"] - mean) / special.stdtrit(df, 1.0 - alpha)
    t_low, t_high = (mean + bound) / error, (mean - bound) / error
    p_low, p_high = special.stdtr(df, -t_low), special.stdtr(df, t_high)
    p = np.maximum(p_low, p_high)
    table = pairs[["a", "b"]].assign(
        n=result.n,
        mean_difference=mean,
        low=-bound,
        high=bound,
        t_low=t_low,
        p_low=p_low,
        t_high=t_high,
        p_high=p_high,
        df=df,
        p=p,
        p_holm=holm(p.to_numpy()),
        ci_low=pairs["ci_low"],
        ci_high=pairs["ci_high"],
        equivalent=p < alpha,
    )
    return labelled(table, result.origin, excluded=result.excluded, confidence=level)


def _tested(result: RepeatedMeasures, confidence: float = 0.95) -> pd.DataFrame:
    """Return the pairs of conditions, all of which have a t."""
    pairs = result.pairs(confidence=confidence)
    for pair in pairs[pairs["t"].isna()].itertuples():
        raise ValueError(
            f"dv: every subject has the same difference between {pair.a!r} and {pair.b!r}; leave "
            "one out by selecting rows"
        )
    return pairs


def bayes_factor(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    scale: float = 2**-0.5,
    order: Sequence | None = None,
    missing: str = "raise",
) -> pd.DataFrame:
    """
    Return how many times likelier the data are with a difference than without, for every pair of
    conditions, by the t-test of Rouder and others: a Cauchy prior on d_z.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and condition.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject.
    scale : float
        Scale of the Cauchy prior, from 1e-6 to 1e6; 1/√2 as in R's BayesFactor ("medium").
    order : sequence, optional
        The order of the conditions.
    missing : {"raise", "listwise"}
        Whether a missing cell is an error, or its subject is left out; `.attrs["excluded"]` names
        them.

    Returns
    -------
    pandas.DataFrame
        A row per pair: a, b, t, log_bf10 (natural logarithm), bf10, bf01, n. Where bf10 is too
        large for a number it is infinite; log_bf10 is not.

    Raises
    ------
    ValueError
        If the table is refused (see `repeated_measures`), every subject has the same difference, or
        an argument is out of range.

    References
    ----------
    J. N. Rouder and others, Bayesian t tests for accepting and rejecting the null hypothesis,
    Psychonomic Bulletin & Review 16 (2009) 225-237.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> values = {"subject": [1, 1, 2, 2, 3, 3], "mode": ["A", "B"] * 3}
    >>> frame = pd.DataFrame(values).assign(error=[1.0, 1.4, 1.1, 1.9, 0.8, 1.0])
    >>> tl.bayes_factor(frame, "error", "mode", "subject")[["a", "b", "t", "bf10", "n"]].round(3)
       a  b      t   bf10  n
    0  A  B -2.646  1.501  3
    """
    scale = between("scale", scale, 1e-6, 1e6)
    result = repeated_measures(frame, dv, within, subject, order=order, missing=missing)
    table = _tested(result)[["a", "b", "t"]]
    table = table.assign(log_bf10=[log_jzs_bayes_factor(t, result.n, scale) for t in table["t"]])
    with np.errstate(over="ignore"):
        table["bf10"], table["bf01"] = np.exp(table["log_bf10"]), np.exp(-table["log_bf10"])
    return labelled(table.assign(n=result.n), result.origin, excluded=result.excluded)


def log_jzs_bayes_factor(t: float, n: int, scale: float) -> float:
    """
    Return ln BF10 of a paired t of n subjects (Rouder and others 2009, Equation 1).

    d_z has a Cauchy prior: variance g, with g = scale²/χ²₁. The integral over u = ln g is a
    trapezoidal sum, which converges exponentially because the integrand is analytic and vanishes at
    both ends; it is worked out in logarithms, so that no t is too large.
    """
    df = n - 1
    # Beyond these ends the integrand is below e⁻⁵⁰ of its peak: it falls as exp(−scale²/2g) to the
    # left and, past the variance that t speaks for, as 1/g to the right.
    spoken_for = max(np.log(scale**2), np.log1p(t * t / n))
    u = np.arange(np.log(scale**2) - 6.0, spoken_for + 60.0, 0.02)
    g = np.exp(u)
    likelihood = -0.5 * np.log1p(n * g)
    likelihood -= 0.5 * n * np.log1p(t * t / (df * (1.0 + n * g)))
    prior = np.log(scale) - 0.5 * np.log(2.0 * np.pi) - 0.5 * u - scale**2 / (2.0 * g)
    integral = np.logaddexp.reduce(likelihood + prior) + np.log(u[1] - u[0])
    return float(integral + 0.5 * n * np.log1p(t * t / df))
