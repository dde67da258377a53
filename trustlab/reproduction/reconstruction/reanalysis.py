"""Every statistic a study prints, computed again from data by the analysis of `trustlab.studies`, not from moments."""

import numpy as np

from trustlab.reproduction.printed_number import printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import ALPHA, Constraint, size_interval
from trustlab.studies.analysis.batch import repeated_measures_batch
from trustlab.studies.analysis.pairwise import bonferroni, holm


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
    names = study.conditions
    result = repeated_measures_batch(values[None])
    ours, pairs = result.study(0), result.pairwise
    factor, p = (ours["epsilon_gg"], ours["p_gg"]) if study.corrected else (1.0, ours["p"])
    found = {f"mean.{c}": x for c, x in zip(names, result.mean[0], strict=True)}
    found |= {f"sd.{c}": x for c, x in zip(names, result.sd[0], strict=True)}
    found |= {"anova.F": ours["F"], "anova.p": p, "anova.eta2": ours["eta2_partial"]}
    found |= {"anova.df1": factor * ours["df1"], "anova.df2": factor * ours["df2"]}
    found |= {"epsilon": ours["epsilon_gg"], "mauchly.chi2": ours["mauchly_chi2"]}
    found |= {"mauchly.p": ours["mauchly_p"], "mauchly.violated": ours["mauchly_p"]}
    found |= {"t_test.t": pairs.t[0, 0], "t_test.p": pairs.p[0, 0], "t_test.df": pairs.df}
    for a, b, value in zip(pairs.a, pairs.b, adjusted(pairs.p[0], p_adjust), strict=True):
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
