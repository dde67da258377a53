"""Beyond significance: equivalence, Bayes factors, simultaneous intervals, agreement."""

from collections.abc import Hashable, Sequence
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import one_of, open_unit, positive, spawned, whole_number
from trustlab.studies.pairs import condition_pairs, holm
from trustlab.studies.repeated_measures import RepeatedMeasures, table_effects
from trustlab.studies.table import complete_scores, labelled, read_scores

UNITS = ("raw", "d_z")


def equivalence(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    bound: float,
    units: str = "raw",
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
        Smallest difference that would matter; positive.
    units : {"raw", "d_z"}
        Whether `bound` is in units of the score, or in standard deviations of the differences as
        estimated from these data.
    order : sequence, optional
        The order of the conditions.
    missing : {"raise", "listwise"}
        Whether a missing cell is an error, or its subject is left out; `.attrs["excluded"]` names
        them.
    alpha : float
        Level of both tests.

    Returns
    -------
    pandas.DataFrame
        A row per pair: a, b, n, mean_difference (a − b), low, high (the bounds in units of the
        score), t_low, p_low (against differences at or below `low`), t_high, p_high, df, p (the
        greater of the two), p_holm, ci_low, ci_high (level 1 − 2 alpha; inside the bounds where p <
        alpha), equivalent (p < alpha, unadjusted).

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.table`), every subject has the
        same difference, or an argument is out of range.

    References
    ----------
    D. Lakens, Equivalence tests: a practical primer, Social Psychological and Personality Science 8
    (2017) 355-362.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> tests = tl.equivalence(frame, dv="value", within="condition", subject="subject", bound=10.0)
    >>> tests[["a", "b", "p_holm", "equivalent"]].round(3).head(3)
        a   b  p_holm  equivalent
    0  C1  C2   0.019        True
    1  C1  C3   0.569       False
    2  C1  C4   0.003        True
    """
    from statsmodels.stats.weightstats import ttost_paired

    bound, alpha = positive("bound", bound), open_unit("alpha", alpha)
    if alpha >= 0.5:
        raise ValueError(
            f"alpha must be below 0.5 for an interval of level 1 − 2 alpha, got {alpha}"
        )
    one_of("units", units, UNITS)
    scores, excluded = complete_scores(
        read_scores(frame, dv, within, subject, order=order), missing
    )
    table_effects(scores)  # refuses scores without error variance
    pairs, n = condition_pairs(scores.values[None]), len(scores.subjects)
    rows = []
    for q, (i, j) in enumerate(combinations(range(len(scores.conditions)), 2)):
        a, b = scores.conditions[i], scores.conditions[j]
        x, y = scores.values[:, [i, j]].T
        sd = float((x - y).std(ddof=1))
        if np.isnan(pairs.t[0, q]):
            raise ValueError(
                f"dv: every subject has the same difference between {a!r} and {b!r}: no error to "
                "test"
            )
        reach = bound if units == "raw" else bound * sd
        p, (t_low, p_low, df), (t_high, p_high, _) = ttost_paired(x, y, -reach, reach)
        mean = float(pairs.mean_difference[0, q])
        half = special.stdtrit(df, 1.0 - alpha) * sd / np.sqrt(n)
        tests = t_low, p_low, t_high, p_high, df, p
        interval = mean - half, mean + half
        rows.append((a, b, n, mean, -reach, reach, *map(float, tests), *interval, bool(p < alpha)))
    names = (
        "a b n mean_difference low high t_low p_low t_high p_high df p ci_low ci_high equivalent"
    )
    table = pd.DataFrame(rows, columns=names.split())
    table.insert(table.columns.get_loc("ci_low"), "p_holm", holm(table["p"].to_numpy()))
    return labelled(table, scores.origin, excluded=excluded)


def simultaneous_intervals(
    result: RepeatedMeasures,
    method: str = "max_t",
    level: float = 0.95,
    *,
    draws: int = 20_000,
    seed: int = 0,
) -> pd.DataFrame:
    """
    Return intervals of all pairwise differences that hold together with a given probability.

    Parameters
    ----------
    result : RepeatedMeasures
        The analysis, of one factor.
    method : {"max_t", "bonferroni"}
        "max_t" takes the quantile of the greatest ``|t|`` of all pairs over simulated normal
        studies without effects, with the covariance of these data (Tukey's idea without
        sphericity).
    level : float
        Probability that all intervals hold.
    draws : int
        Simulated studies.
    seed : int
        Seed of the draws.

    Returns
    -------
    pandas.DataFrame
        Columns a, b, mean_difference, ci_low, ci_high, critical_t, and for "max_t" p_simultaneous
        (share of simulated studies with a greater ``|t|`` anywhere).

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    one_of("method", method, ("max_t", "bonferroni"))
    level, draws = open_unit("level", level), whole_number("draws", draws, least=1000, most=10**6)
    table = result.pairs()[["a", "b", "mean_difference", "t"]]
    a, b = np.triu_indices(result.k, 1)
    differences = result.scores.values[:, a] - result.scores.values[:, b]
    errors = differences.std(axis=0, ddof=1) / np.sqrt(result.n)
    critical = special.stdtrit(result.n - 1, 1.0 - 0.5 * (1.0 - level) / len(table))
    if method == "max_t":
        greatest = _greatest_t(np.cov(result.scores.values.T), result.n, draws, seed)
        critical = float(np.quantile(greatest, level))
        table["p_simultaneous"] = [
            (greatest >= abs(t)).mean() if np.isfinite(t) else np.nan for t in table["t"]
        ]
    table.insert(3, "ci_low", table["mean_difference"] - critical * errors)
    table.insert(4, "ci_high", table["mean_difference"] + critical * errors)
    return table.drop(columns="t").assign(critical_t=critical)


def _greatest_t(covariance: np.ndarray, n: int, draws: int, seed: int) -> np.ndarray:
    """
    Return the greatest |t| over all pairs of conditions in each of many studies without effects.
    """
    rng, k = np.random.default_rng(spawned(seed, 1)[0]), len(covariance)
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T  # the covariance may be singular
    greatest = []
    for start in range(0, draws, 1000):
        scores = rng.standard_normal((min(1000, draws - start), n, k)) @ root
        greatest.append(np.nanmax(np.abs(condition_pairs(scores).t), axis=1))
    return np.concatenate(greatest)


def bayes_factor(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    method: str | None = None,
    scale: float = 2**-0.5,
    order: Sequence | None = None,
    missing: str = "raise",
) -> pd.DataFrame:
    """
    Return how many times likelier the data are with a difference than without.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and condition.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject.
    method : {"jzs", "bic"}, optional
        "jzs": every pair by the t-test of Rouder and others, a Cauchy prior on d_z.
        "bic": all conditions against their common mean, exp(−ΔBIC/2) with n (k − 1) independent
        observations. By default "jzs" for two conditions, else "bic".
    scale : float
        Scale of the Cauchy prior; 1/√2 as in R's BayesFactor ("medium").
    order : sequence, optional
        The order of the conditions.
    missing : {"raise", "listwise"}
        Whether a missing cell is an error, or its subject is left out.

    Returns
    -------
    pandas.DataFrame
        Columns comparison, method, statistic (t or F), df1, df2, log_bf10 (natural logarithm),
        bf10, bf01, n; a row per pair for "jzs", one for "bic". Where bf10 is too large for a number
        it is infinite; log_bf10 is not.

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.table`) or an argument is out
        of range.

    References
    ----------
    J. N. Rouder and others, Bayesian t tests for accepting and rejecting the null hypothesis,
    Psychonomic Bulletin & Review 16 (2009) 225-237. M. E. J. Masson, A tutorial on a practical
    Bayesian alternative to null-hypothesis significance testing, Behavior Research Methods 43
    (2011) 679-690.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> factors = tl.bayes_factor(frame, dv="value", within="condition", subject="subject")
    >>> factors[["comparison", "bf10", "n"]].round(3)
      comparison   bf10   n
    0  condition  3.526  36
    """
    scale = positive("scale", scale)
    scores, excluded = complete_scores(
        read_scores(frame, dv, within, subject, order=order), missing
    )
    test = table_effects(scores).iloc[0]
    n = len(scores.subjects)
    names = scores.conditions
    if method is None:
        method = "jzs" if len(names) == 2 else "bic"
    one_of("method", method, ("jzs", "bic"))
    if method == "bic":
        ss, total = test["ss_error"], test["ss_effect"] + test["ss_error"]
        size = n * (len(names) - 1)
        df1, df2 = int(test["df1"]), int(test["df2"])
        log_bf10 = -0.5 * (size * np.log(ss / total) + df1 * np.log(size))
        rows = [(str(within), method, float(test["F"]), df1, df2, log_bf10)]
    else:
        rows = []
        statistics = condition_pairs(scores.values[None]).t[0].tolist()
        for (a, b), t in zip(combinations(names, 2), statistics, strict=True):
            log_bf10 = log_jzs_bayes_factor(t, n, scale) if np.isfinite(t) else np.nan
            rows.append((f"{a} − {b}", method, t, 1, n - 1, log_bf10))
    columns = ["comparison", "method", "statistic", "df1", "df2", "log_bf10"]
    table = pd.DataFrame(rows, columns=columns)
    with np.errstate(over="ignore"):
        factors = {"bf10": np.exp(table["log_bf10"]), "bf01": np.exp(-table["log_bf10"])}
    table = table.assign(**factors, n=n)
    return labelled(table, scores.origin, excluded=excluded)


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


def intraclass_correlation(
    frame: pd.DataFrame, dv: Hashable, rater: Hashable, subject: Hashable, *, missing: str = "raise"
) -> pd.DataFrame:
    """
    Return the intraclass correlations of Shrout and Fleiss, by pingouin.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject (target) and rater (or occasion).
    dv, rater, subject : hashable
        Columns with the rating, the rater and the subject rated.
    missing : {"raise", "listwise"}
        Whether a missing rating is an error, or its subject is left out.

    Returns
    -------
    pandas.DataFrame
        Columns type ("ICC(1,1)", "ICC(A,1)", "ICC(C,1)", and the same with k), icc, F, df1, df2, p,
        ci_low, ci_high (95 %), n, raters.

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.table`).

    References
    ----------
    P. E. Shrout, J. L. Fleiss, Intraclass correlations: uses in assessing rater reliability,
    Psychological Bulletin 86 (1979) 420-428.
    """
    import pingouin

    scores, excluded = complete_scores(read_scores(frame, dv, rater, subject), missing)
    table_effects(scores)  # refuses ratings without error variance
    n, k = scores.values.shape
    cells = {
        "target": np.repeat(range(n), k),
        "rater": np.tile(range(k), n),
        "rating": scores.values.ravel(),
    }
    long = pd.DataFrame(cells)
    digits = pingouin.options["round.column.CI95"]
    try:
        pingouin.options["round.column.CI95"] = 15  # two by default
        result = pingouin.intraclass_corr(long, targets="target", raters="rater", ratings="rating")
    finally:
        pingouin.options["round.column.CI95"] = digits
    low, high = np.array(result["CI95"].tolist()).T
    table = result[["Type", "ICC", "F", "df1", "df2", "pval"]].set_axis(
        ["type", "icc", "F", "df1", "df2", "p"], axis=1
    )
    table = table.assign(ci_low=low, ci_high=high, n=n, raters=k).reset_index(drop=True)
    return labelled(table, scores.origin, excluded=excluded)
