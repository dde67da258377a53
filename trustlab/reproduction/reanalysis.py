"""Every statistic a study prints, computed again from data: sums of squares, eigenvalues and differences, not moments."""

from __future__ import annotations

import numpy as np
from scipy import special

from trustlab.reproduction.moment_statistics import mauchly_factor, mauchly_p, pair_indices
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.statements import Statement
from trustlab.reproduction.study_checks import printed_interval

__all__ = ["adjusted", "agrees", "printed_ends", "reanalyse"]


def adjusted(p: np.ndarray, p_adjust: str) -> np.ndarray:
    """
    Return p-values adjusted for their number.

    Parameters
    ----------
    p : numpy.ndarray, shape (m,)
        Unadjusted p-values.
    p_adjust : {"bonferroni", "holm", "sidak", "none"}
        The adjustment.
    """
    m = len(p)
    if p_adjust == "bonferroni":
        return np.minimum(m * p, 1.0)
    if p_adjust == "sidak":
        return -np.expm1(m * np.log1p(-p))
    if p_adjust == "holm":
        order, result = np.argsort(p), np.empty(m)
        result[order] = np.minimum(np.maximum.accumulate(p[order] * (m - np.arange(m))), 1.0)
        return result
    return p


def reanalyse(values: np.ndarray, study: PublishedStudy, p_adjust: str) -> dict[str, float]:
    """
    Return the statistics of data under the names of a study's statements.

    Parameters
    ----------
    values : numpy.ndarray, shape (n, k)
        The data, one row per subject.
    study : PublishedStudy
        The study that names conditions, and whether degrees of freedom are corrected.
    p_adjust : {"bonferroni", "holm", "sidak", "none"}
        The adjustment of pairwise p-values.

    Returns
    -------
    dict of str to float
        In the units in which they are printed; Mauchly's p with the second-order term.
    """
    (n, k), names = values.shape, study.conditions
    found = {f"mean.{c}": x for c, x in zip(names, values.mean(axis=0), strict=True)}
    found |= {f"sd.{c}": x for c, x in zip(names, values.std(axis=0, ddof=1), strict=True)}
    rest = values - values.mean(axis=1, keepdims=True)
    effect = n * ((values.mean(axis=0) - values.mean()) ** 2).sum()
    error = ((rest - rest.mean(axis=0)) ** 2).sum()
    eigenvalues = np.linalg.eigvalsh(np.cov(rest.T))[1:]
    epsilon = eigenvalues.sum() ** 2 / ((k - 1) * (eigenvalues**2).sum())
    F = effect / error * (n - 1)
    df1 = (k - 1) * (epsilon if study.corrected else 1.0)
    found |= {"anova.F": F, "anova.df1": df1, "anova.df2": df1 * (n - 1), "epsilon": epsilon}
    found |= {"anova.eta2": effect / (effect + error), "anova.p": special.fdtrc(df1, df1 * (n - 1), F)}
    if k > 2:
        chi2 = -mauchly_factor(n, k) * np.log(eigenvalues / eigenvalues.mean()).sum()
        found |= {"mauchly.chi2": chi2, "mauchly.p": float(mauchly_p(chi2, n, k))}
        found["mauchly.violated"] = found["mauchly.p"]
    i, j = pair_indices(k)
    difference = values[:, i] - values[:, j]
    t = difference.mean(axis=0) / (difference.std(axis=0, ddof=1) / np.sqrt(n))
    p = 2.0 * special.stdtr(n - 1, -np.abs(t))
    found |= {"t_test.t": t[0], "t_test.p": p[0], "t_test.df": n - 1.0}
    for a, b, value in zip(i, j, adjusted(p, p_adjust), strict=True):
        found[f"pairs.{names[a]}-{names[b]}"] = found[f"pairs.{names[b]}-{names[a]}"] = value
    return {name: float(value) for name, value in found.items()}


def printed_ends(statement: Statement) -> tuple[float, float]:
    """
    Return the values that agree with a statement, in the units in which it is printed.

    Parameters
    ----------
    statement : Statement
        The statement.
    """
    if statement.text in ("not significant", "significant", "sphericity violated, p < 0.05"):
        return (0.05, 1.0) if statement.text == "not significant" else (0.0, 0.05)
    low, high = printed_interval(statement.text)
    is_p = statement.name.startswith("pairs.") or statement.name.endswith(".p")
    return (max(low, 0.0), min(high, 1.0)) if is_p else (low, high)


def agrees(statement: Statement, value: float) -> bool:
    """
    Return whether a value rounds to what is printed, or obeys the printed inequality.

    Parameters
    ----------
    statement : Statement
        The statement.
    value : float
        The value; of a t only the size counts.
    """
    low, high = printed_ends(statement)
    if statement.name == "t_test.t":
        low, high, value = (
            (0.0 if low < 0.0 < high else min(abs(low), abs(high))),
            max(abs(low), abs(high)),
            abs(value),
        )
    if statement.text == "not significant":
        return low < value <= high
    if (
        statement.text == "significant"
        or statement.text.strip()[:1] == "<"
        or statement.name == "mauchly.violated"
    ):
        return value < high
    return low <= value <= high
