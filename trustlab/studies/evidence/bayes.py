"""Bayes factors of a difference against none: JZS for pairs, the BIC approximation for several conditions."""

from collections.abc import Hashable, Sequence

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of, positive
from trustlab.studies.analysis.batch import analyse_table
from trustlab.studies.analysis.score_table import complete_scores, labelled, read_scores


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
        "jzs": every pair by the t-test of Rouder and others, a Cauchy prior on d_z (by pingouin). "bic": all conditions against
        their common mean, exp(−ΔBIC/2) with n (k − 1) independent observations. By default "jzs" for two conditions, else "bic".
    scale : float
        Scale of the Cauchy prior; 1/√2 as in R's BayesFactor ("medium").
    order : sequence, optional
        Conditions in the order wanted.
    missing : {"raise", "listwise"}
        Whether a missing cell is an error, or its subject is left out.

    Returns
    -------
    pandas.DataFrame
        Columns comparison, method, statistic (t or F), df1, df2, bf10, bf01, n; a row per pair for "jzs", one for "bic".

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.analysis.score_table`) or an argument is out of range.

    References
    ----------
    J. N. Rouder and others, Bayesian t tests for accepting and rejecting the null hypothesis, Psychonomic Bulletin & Review 16
    (2009) 225-237. M. E. J. Masson, A tutorial on a practical Bayesian alternative to null-hypothesis significance testing,
    Behavior Research Methods 43 (2011) 679-690.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> factors = tl.bayes_factor(frame, dv="value", within="condition", subject="subject")
    >>> factors[["comparison", "bf10", "n"]].round(3)
      comparison   bf10   n
    0  condition  3.526  36
    """
    from pingouin import bayesfactor_ttest

    scale = positive("scale", scale)
    scores, excluded = complete_scores(read_scores(frame, dv, within, subject, order=order), missing)
    batch, n, names = analyse_table(scores), len(scores.subjects), scores.conditions
    method = ("jzs" if batch.k == 2 else "bic") if method is None else one_of("method", method, ("jzs", "bic"))
    if method == "bic":
        ss, total = batch.ss_error[0], batch.ss_effect[0] + batch.ss_error[0]
        size = n * (batch.k - 1)
        log_bf10 = -0.5 * (size * np.log(ss / total) + batch.df1 * np.log(size))
        rows = [(str(within), method, float(batch.F[0]), batch.df1, batch.df2, float(np.exp(log_bf10)))]
    else:
        pairs = batch.pairwise
        rows = []
        for i, j, t in zip(pairs.a, pairs.b, pairs.t[0], strict=True):
            bf = float(bayesfactor_ttest(float(t), n, paired=True, r=scale)) if np.isfinite(t) else np.nan
            rows.append((f"{names[i]} − {names[j]}", method, float(t), 1, n - 1, bf))
    table = pd.DataFrame(rows, columns=["comparison", "method", "statistic", "df1", "df2", "bf10"])
    table = table.assign(bf01=1.0 / table["bf10"], n=n)
    return labelled(table, scores.origin, excluded=excluded)


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
        Columns type ("ICC(1,1)", "ICC(A,1)", "ICC(C,1)", and the same with k), icc, F, df1, df2, p, ci_low, ci_high (95 %), n, raters.

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.analysis.score_table`).

    References
    ----------
    P. E. Shrout, J. L. Fleiss, Intraclass correlations: uses in assessing rater reliability, Psychological Bulletin 86 (1979)
    420-428.
    """
    import pingouin

    scores, excluded = complete_scores(read_scores(frame, dv, rater, subject), missing)
    analyse_table(scores)  # refuses ratings without error variance
    n, k = scores.values.shape
    cells = {"target": np.repeat(range(n), k), "rater": np.tile(range(k), n), "rating": scores.values.ravel()}
    long = pd.DataFrame(cells)
    digits = pingouin.options["round.column.CI95"]
    try:
        pingouin.options["round.column.CI95"] = 15  # two by default
        found = pingouin.intraclass_corr(long, targets="target", raters="rater", ratings="rating")
    finally:
        pingouin.options["round.column.CI95"] = digits
    low, high = np.array(found["CI95"].tolist()).T
    table = found[["Type", "ICC", "F", "df1", "df2", "pval"]].set_axis(["type", "icc", "F", "df1", "df2", "p"], axis=1)
    table = table.assign(ci_low=low, ci_high=high, n=n, raters=k).reset_index(drop=True)
    return labelled(table, scores.origin, excluded=excluded)
