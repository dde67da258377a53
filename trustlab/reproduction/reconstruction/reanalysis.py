"""Every statistic a study prints, computed again from data: sums of squares, eigenvalues and differences, not moments."""

from __future__ import annotations

import numpy as np
from scipy import special

from trustlab.reproduction.printed_number import printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import ALPHA, Constraint, size_interval
from trustlab.reproduction.reconstruction.moment_statistics import pair_indices
from trustlab.studies.analysis.pairwise import bonferroni, holm
from trustlab.studies.analysis.sphericity import mauchly_factor, mauchly_p_value

__all__ = ["adjusted", "agrees", "printed_ends", "reanalyse"]


def _sidak(p: np.ndarray) -> np.ndarray:
    return -np.expm1(len(p) * np.log1p(-p))


def adjusted(p: np.ndarray, p_adjust: str) -> np.ndarray:
    """Return p-values adjusted for their number."""
    ways = {"bonferroni": bonferroni, "holm": holm, "sidak": _sidak, "none": lambda p: p}
    return ways[p_adjust](p)


def reanalyse(values: np.ndarray, study: PublishedStudy, p_adjust: str) -> dict[str, float]:
    """
    Return the statistics of data, shape (n, k), under the names of a study's constraints, in the units in which they are printed.

    The study names the conditions and says whether degrees of freedom are corrected; Mauchly's p has the second-order term.
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
        found |= {"mauchly.chi2": chi2, "mauchly.p": float(mauchly_p_value(chi2, n, k))}
        found["mauchly.violated"] = found["mauchly.p"]
    i, j = pair_indices(k)
    difference = values[:, i] - values[:, j]
    t = difference.mean(axis=0) / (difference.std(axis=0, ddof=1) / np.sqrt(n))
    p = 2.0 * special.stdtr(n - 1, -np.abs(t))
    found |= {"t_test.t": t[0], "t_test.p": p[0], "t_test.df": n - 1.0}
    for a, b, value in zip(i, j, adjusted(p, p_adjust), strict=True):
        found[f"pairs.{names[a]}-{names[b]}"] = found[f"pairs.{names[b]}-{names[a]}"] = value
    return {name: float(value) for name, value in found.items()}


def printed_ends(s: Constraint) -> tuple[float, float]:
    """Return the values that agree with a constraint, in the units in which it is printed."""
    if s.text == "not significant":
        return ALPHA, 1.0
    if s.text in ("significant", "sphericity violated, p < 0.05"):
        return 0.0, ALPHA
    low, high = printed_interval(s.text)
    is_p = s.name.startswith("pairs.") or s.name.endswith(".p")
    return (max(low, 0.0), min(high, 1.0)) if is_p else (low, high)


def agrees(s: Constraint, value: float) -> bool:
    """Return whether a value rounds to what is printed, or obeys the printed inequality; of a t only the size counts."""
    low, high = printed_ends(s)
    if s.name == "t_test.t":
        (low, high), value = size_interval(s.text), abs(value)
    if s.text == "not significant":
        return low < value <= high
    if s.text == "significant" or s.text.strip().startswith("<") or s.name == "mauchly.violated":
        return value < high
    return low <= value <= high
