"""
What a printed study says about its data: one interval per printed number, on a statistic of means and covariance.

A pair's p may be printed unadjusted or adjusted for the m = k(k − 1)/2 comparisons: Bonferroni m p, Šidák
1 − (1 − p)^m, Holm the running maximum of (m − l + 1) p_(l). Each printed p is an interval, "<.0005" a half-line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from difflib import get_close_matches

import numpy as np
from scipy import optimize, special

from trustlab.reproduction.moment_statistics import mauchly_p, pair_indices
from trustlab.reproduction.published_study import PublishedStudy, published_studies
from trustlab.reproduction.study_checks import printed_interval

__all__ = ["ADJUSTMENTS", "Statement", "arithmetic_conflicts", "select", "sharpened", "statements"]

ADJUSTMENTS = ("bonferroni", "holm", "sidak", "none")
"""Adjustments of pairwise p-values for the number of comparisons."""

ALPHA = 0.05
NOTHING, EVERYTHING = float("-inf"), float("inf")


@dataclass(frozen=True)
class Statement:
    """
    One thing a study says about its data.

    Parameters
    ----------
    name : str
        For example "anova.F" or "pairs.C1-C3".
    kind : {"mean", "sd", "f_ratio", "epsilon", "chi2", "log_anova_p", "log_p", "log_adjusted_p"}
        The statistic of means and covariance it is about.
    index : int
        Which condition or pair, where there are several.
    low, high : float
        The values that agree with what is printed; infinite on an open side.
    text : str
        What is printed.
    """

    name: str
    kind: str
    index: int
    low: float
    high: float
    text: str


def _log_interval(text: str) -> tuple[float, float]:
    low, high = printed_interval(text)
    return (math.log(low) if low > 0.0 else NOTHING), (math.log(high) if high < 1.0 else EVERYTHING)


def _chi2_intervals(text: str, n: int, k: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Chi-squares whose p rounds to the printed one: with or without the second-order term, and with it."""
    low, high = printed_interval(text)

    def quantile(p: float, second_order: bool) -> float:
        top = special.chdtri(k * (k - 1) // 2 - 1, p * 0.5) + 10.0
        if mauchly_p(0.0, n, k, second_order) <= p:
            return 0.0
        return optimize.brentq(lambda x: mauchly_p(x, n, k, second_order) - p, 0.0, 2.0 * top)

    ends = np.array(
        [
            (quantile(high, s) if high < 1.0 else 0.0, quantile(low, s) if low > 0.0 else EVERYTHING)
            for s in (False, True)
        ]
    )
    return (ends[:, 0].min(), ends[:, 1].max()), tuple(ends[1])


def sharpened(found: Iterable[Statement], study: PublishedStudy) -> list[Statement]:
    """
    Return statements in which Mauchly's p has its second-order term, as R, SPSS and pingouin print it.

    Parameters
    ----------
    found : iterable of Statement
        The statements.
    study : PublishedStudy
        Their study.
    """
    sharp = []
    for s in found:
        if s.name in ("mauchly.p", "mauchly.violated"):
            text = s.text if s.name == "mauchly.p" else f"<{ALPHA}"
            low, high = _chi2_intervals(text, study.n, study.k)[1]
            s = replace(s, low=low, high=high)
        sharp.append(s)
    return sharp


def _scaled(interval: tuple[float, float], factor: float) -> tuple[float, float]:
    return interval[0] / factor, interval[1] / factor


def _omnibus(study: PublishedStudy) -> list[Statement]:
    n, k, found = study.n, study.k, []
    for name, text in study.anova.items():
        low, high = printed_interval(text)
        if name == "F":
            found.append(Statement("anova.F", "f_ratio", 0, low, high, text))
        elif name == "eta2":
            ends = [(n - 1) * max(e, 0.0) / (1.0 - e) if e < 1.0 else EVERYTHING for e in (low, high)]
            found.append(Statement("anova.eta2", "f_ratio", 0, *ends, text))
        elif name == "p":
            found.append(Statement("anova.p", "log_anova_p", 0, *_log_interval(text), text))
        elif study.corrected:
            factor = (k - 1) if name == "df1" else (k - 1) * (n - 1)
            found.append(Statement(f"anova.{name}", "epsilon", 0, *_scaled((low, high), factor), text))
    if study.epsilon:
        found.append(Statement("epsilon", "epsilon", 0, *printed_interval(study.epsilon), study.epsilon))
    if "chi2" in study.mauchly:
        text = study.mauchly["chi2"]
        found.append(Statement("mauchly.chi2", "chi2", 0, *printed_interval(text), text))
    if "p" in study.mauchly:
        text = study.mauchly["p"]
        found.append(Statement("mauchly.p", "chi2", 0, *_chi2_intervals(text, n, k)[0], text))
    elif study.corrected and "chi2" not in study.mauchly:
        least = _chi2_intervals(f"<{ALPHA}", n, k)[0][0]
        found.append(
            Statement("mauchly.violated", "chi2", 0, least, EVERYTHING, "sphericity violated, p < 0.05")
        )
    return found


def _pairwise(study: PublishedStudy, p_adjust: str) -> list[Statement]:
    kind, found = "log_adjusted_p", []
    i, j = pair_indices(study.k)
    position = {pair: q for q, pair in enumerate(zip(i.tolist(), j.tolist(), strict=True))}
    named = {}
    for name, text in study.pairs.items():
        named[study.pair(name)] = (f"pairs.{name}", *_log_interval(text), text)
    for name in study.significant_without_p:
        named[study.pair(name)] = (f"pairs.{name}", NOTHING, math.log(ALPHA), "significant")
    for pair, q in position.items():
        if pair in named:
            name, low, high, text = named[pair]
        elif study.listed_only or not (study.pairs or study.significant_without_p):
            continue
        else:
            name = f"pairs.{study.conditions[pair[0]]}-{study.conditions[pair[1]]}"
            low, high, text = math.log(ALPHA), EVERYTHING, "not significant"
        found.append(Statement(name, kind, q, low, high, text))
    if p_adjust == "holm":
        return found
    m = len(position)
    return [
        Statement(s.name, "log_p", s.index, *(_unadjusted(x, p_adjust, m) for x in (s.low, s.high)), s.text)
        for s in found
    ]


def _unadjusted(log_p: float, p_adjust: str, m: int) -> float:
    if math.isinf(log_p) or p_adjust == "none":
        return log_p
    if p_adjust == "bonferroni":
        return log_p - math.log(m)
    return math.log(-math.expm1(math.log1p(-math.exp(log_p)) / m))


def statements(study: PublishedStudy, p_adjust: str = "bonferroni") -> list[Statement]:
    """
    Return what a study says, number by number.

    Parameters
    ----------
    study : PublishedStudy
        The study.
    p_adjust : {"bonferroni", "holm", "sidak", "none"}
        How the printed pairwise p-values were adjusted.

    Returns
    -------
    list of Statement
        Means, standard deviations, F and what goes with it, sphericity, pairs. A pair without a p-value was reported as
        not significant, p > 0.05, unless the study's `listed_only` is set; a printed epsilon without a test of
        sphericity says that the test was significant.

    Raises
    ------
    ValueError
        If the study is no `PublishedStudy` or the adjustment is unknown.
    """
    if not isinstance(study, PublishedStudy):
        hint = "PublishedStudy.from_dict builds one"
        if isinstance(study, str):
            known = published_studies()
            near = study if study in known else next(iter(get_close_matches(study, known, n=1)), "uav.tlx")
            hint = f"a printed one is published_studies()[{near!r}]"
        raise ValueError(f"study must be a PublishedStudy, got {type(study).__name__}; {hint}")
    if p_adjust not in ADJUSTMENTS:
        raise ValueError(f"p_adjust must be one of {', '.join(ADJUSTMENTS)}, got {p_adjust!r}")
    found = []
    for q, condition in enumerate(study.conditions):
        for kind, printed in (("mean", study.mean), ("sd", study.sd)):
            if condition in printed:
                ends = printed_interval(printed[condition])
                found.append(Statement(f"{kind}.{condition}", kind, q, *ends, printed[condition]))
    found += _omnibus(study)
    for name, text in study.t_test.items():
        if name == "t":
            low, high = printed_interval(text)
            size = (0.0 if low < 0.0 < high else min(abs(low), abs(high)), max(abs(low), abs(high)))
            ends = [math.log(2.0 * special.stdtr(study.n - 1, -t)) for t in reversed(size)]
            found.append(Statement("t_test.t", "log_p", 0, *ends, text))
        elif name == "p":
            found.append(Statement("t_test.p", "log_p", 0, *_log_interval(text), text))
    return found + _pairwise(study, p_adjust)


def select(found: Iterable[Statement], without: Iterable[str]) -> list[Statement]:
    """
    Return the statements that are not left out.

    Parameters
    ----------
    found : iterable of Statement
        All of them.
    without : iterable of str
        Names of single statistics ("anova.F", "pairs.C1-C3", "mean.C2") or of groups ("mauchly", "pairs", "anova", "sd").

    Raises
    ------
    ValueError
        If a name is none of the study's, or nothing would be left.
    """
    found = list(found)
    if isinstance(without, str):
        raise ValueError(f'without must be a list of names, such as ("mauchly", "pairs"), got {without!r}')
    without = tuple(without)
    known = {s.name for s in found} | {s.name.split(".")[0] for s in found}
    for name in without:
        if name not in known:
            raise ValueError(
                f"without: {name!r} is none of the study's statistics; there are {', '.join(sorted(known))}"
            )
    return [s for s in found if s.name not in without and s.name.split(".")[0] not in without]


def _largest_agreement(group: list[Statement]) -> tuple[list[Statement], tuple[float, float]]:
    """The most statements whose intervals have a point in common; the first named win a tie."""
    best: list[Statement] = []
    for point in (s.low if math.isfinite(s.low) else s.high for s in group):
        agreeing = [s for s in group if s.low <= point <= s.high]
        best = agreeing if len(agreeing) > len(best) else best
    return best, (max(s.low for s in best), min(s.high for s in best))


def arithmetic_conflicts(study: PublishedStudy) -> dict[str, str]:
    """
    Return the printed numbers that contradict other printed numbers by arithmetic alone, whatever the data.

    Partial eta² against F, degrees of freedom against ε and n, p against F and its degrees of freedom, Mauchly's p against
    its chi-square. Of numbers that disagree, the fewest are named; of two, the one that is computed from the other.

    Parameters
    ----------
    study : PublishedStudy
        The study.

    Returns
    -------
    dict of str to str
        Reason by name of the statistic.
    """
    found, n, k = statements(study), study.n, study.k
    order = ["epsilon", "anova.df2", "anova.df1", "anova.F", "anova.eta2", "mauchly.chi2", "mauchly.p"]
    conflicts, ranges = {}, {}
    for kind, label in (("epsilon", "epsilon"), ("f_ratio", "F"), ("chi2", "chi-square")):
        group = sorted(
            (s for s in found if s.kind == kind and s.name in order), key=lambda s: order.index(s.name)
        )
        if not group:
            continue
        agreeing, ranges[kind] = _largest_agreement(group)
        names = " and ".join(f"{s.name} = {s.text}" for s in agreeing)
        for s in group:
            if s not in agreeing:
                conflicts[s.name] = (
                    f"{s.name} = {s.text} needs {label} from {s.low:.6g} to {s.high:.6g}, but {names}"
                    f" needs {ranges[kind][0]:.6g} to {ranges[kind][1]:.6g}"
                )
    if "p" in study.anova and "f_ratio" in ranges:
        epsilon = np.clip(ranges.get("epsilon", (1.0 / (k - 1), 1.0)), 1.0 / (k - 1), 1.0)
        df = (k - 1) * (epsilon if study.corrected else np.ones(2))
        p = special.fdtrc(df[:, None], df[:, None] * (n - 1), np.maximum(ranges["f_ratio"], 0.0))
        low, high = printed_interval(study.anova["p"])
        if p.max() < low or p.min() > high:
            conflicts["anova.p"] = (
                f"anova.p = {study.anova['p']}, but F and its degrees of freedom give {p.min():.4g} to {p.max():.4g}"
            )
    return conflicts | _wrong_degrees(study)


def _wrong_degrees(study: PublishedStudy) -> dict[str, str]:
    """Degrees of freedom that follow from n and k and are printed otherwise."""
    n, k, conflicts = study.n, study.k, {}
    if "df2" in study.anova and not study.corrected and float(study.anova["df2"]) != (k - 1) * (n - 1):
        conflicts["anova.df2"] = f"anova.df2 = {study.anova['df2']}, but (k − 1)(n − 1) = {(k - 1) * (n - 1)}"
    if "df" in study.t_test and float(study.t_test["df"]) != n - 1:
        conflicts["t_test.df"] = f"t_test.df = {study.t_test['df']}, but n − 1 = {n - 1}"
    if {"t", "p"} <= set(study.t_test):
        size = np.abs(printed_interval(study.t_test["t"]))
        p = 2.0 * special.stdtr(n - 1, -size)
        low, high = printed_interval(study.t_test["p"])
        if p.max() < low or p.min() > high:
            conflicts["t_test.p"] = (
                f"t_test.p = {study.t_test['p']}, but t gives {p.min():.4g} to {p.max():.4g}"
            )
    return conflicts
