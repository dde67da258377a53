"""
What a study prints as intervals, and which of its numbers contradict others by arithmetic alone,
whatever the data.

What a paper multiplies by the ε of Greenhouse and Geisser, which may have been rounded before, says
a `Reading`. Of numbers that disagree, the fewest are named; of two, the one that is computed from
the other.
"""

import math
from collections.abc import Iterator, Mapping
from decimal import Decimal
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize, special

from trustlab.reproduction.printed import (
    Interval,
    greatest_sd,
    printed_decimal,
    printed_interval,
)
from trustlab.reproduction.published import PublishedStudy
from trustlab.studies.anova import mauchly_p_value
from trustlab.studies.pairs import bonferroni, holm

# Adjustments of pairwise p-values for the number of comparisons.
ADJUSTMENTS = ("bonferroni", "holm", "sidak", "none")

ALPHA = 0.05


class Constraint(NamedTuple):
    """One printed number: its name, such as "anova.F", its text, and what agrees with it."""

    name: str
    text: str
    low: float
    high: float

    @property
    def is_p(self) -> bool:
        """Whether it is a p-value."""
        tests = "anova.p", "mauchly.p", "mauchly.violated", "t_test.p", "pairs."
        return self.name.startswith(tests)


class Reading(NamedTuple):
    """
    What was multiplied by ε: the printed degrees of freedom (`df`), those of the printed p (`p`).

    `rounded` is the ε that both were multiplied by, where it is another than that of the data.
    """

    words: str
    df: bool
    p: bool
    rounded: float | None = None


NEITHER = Reading("uncorrected p and degrees of freedom", False, False)
BOTH = Reading("corrected p and degrees of freedom", True, True)
ONLY_P = Reading("corrected p, uncorrected degrees of freedom", False, True)
ONLY_DF = Reading("uncorrected p, corrected degrees of freedom", True, False)


def readings(study: PublishedStudy) -> Iterator[Reading]:
    """Return the readings of a study, the usual one first."""
    usual = BOTH if study.corrected else NEITHER
    yield usual
    if study.k == 2:  # ε is 1
        return
    # No ε makes degrees of freedom larger: where too many are printed, none was applied to them.
    plain = {"df1": study.k - 1, "df2": (study.k - 1) * (study.n - 1)}
    ends = [(*printed_interval(study.anova[df]), plain[df]) for df in plain.keys() & study.anova]
    too_many = any(low > df for low, _, df in ends) and not any(high < df for _, high, df in ends)
    for reading in (ONLY_P, ONLY_DF, BOTH, NEITHER):
        if reading != usual and not (too_many and reading.df):
            yield reading
    if not study.epsilon:
        return
    epsilon = printed_decimal(study.epsilon)
    for unit in (Decimal("0.01"), Decimal("0.1")):
        rounded = epsilon.quantize(unit)
        if rounded != epsilon and rounded * (study.k - 1) >= 1:
            words = f"p and degrees of freedom corrected by ε rounded to {rounded}"
            yield Reading(words, True, True, float(rounded))


def constraints(study: PublishedStudy) -> list[Constraint]:
    """
    Return a constraint per printed number.

    A pair without a p-value was reported as not significant, p > 0.05, unless the study's
    `listed_only` is set.
    """
    rows = []
    for name, text, low, high in study.table().itertuples(name=None):
        if name == "t_test.t":  # its size: which condition is first is not printed
            low, high = max(low, -high, 0.0), max(high, -low)
        rows.append(Constraint(name, text, low, high))
    if study.not_spherical and 2 < study.k <= study.n and not {"chi2", "p"} & study.mauchly.keys():
        text = f"sphericity violated, p < {ALPHA}"
        rows.append(Constraint("mauchly.violated", text, 0.0, ALPHA))
    for name in study.significant_without_p:
        rows.append(Constraint(f"pairs.{name}", "significant", 0.0, ALPHA))
    named = {study.pair(name) for name in (*study.pairs, *study.significant_without_p)}
    for pair in combinations(range(study.k), 2):
        if named and pair not in named and not study.listed_only:
            name = "-".join(study.conditions[i] for i in pair)
            rows.append(Constraint(f"pairs.{name}", "not significant", ALPHA, 1.0))
    return rows


def adjusted(p: np.ndarray, p_adjust: str) -> np.ndarray:
    """Return p-values adjusted for their number along the last axis."""
    if p_adjust == "sidak":
        return -np.expm1(p.shape[-1] * np.log1p(-p))
    if p_adjust == "none":
        return p
    return holm(p) if p_adjust == "holm" else bonferroni(p)


def reading_of(study: PublishedStudy) -> Reading:
    """Return the reading under which least contradicts by arithmetic; of several the most usual."""
    return min(readings(study), key=lambda reading: len(_under(study, reading)))


def contradictions(study: PublishedStudy, p_adjust: str = "bonferroni") -> dict[str, str]:
    """
    Return the printed numbers that contradict others, by name with the reason.

    Numbers that cannot be (p above 1, a mean outside the scale), partial eta² against F, degrees of
    freedom against ε and n, t of two conditions against F, p against F and its degrees of freedom,
    Mauchly's p against its chi-square, and F, t and p against what the means and standard
    deviations allow.
    """
    wrong = _under(study, reading_of(study))
    return wrong | _beside_the_cells(study, p_adjust, wrong)


def ends_of(known: Mapping[str, Constraint], name: str) -> np.ndarray:
    """Return the ends of what agrees with a number, which are open where none is known."""
    return np.array(known[name][2:] if name in known else (-math.inf, math.inf))


@np.errstate(all="ignore")  # an end that is open allows everything
def _under(study: PublishedStudy, reading: Reading) -> dict[str, str]:
    """Return what contradicts under a reading, but for what the tests say of the cells."""
    n, k = study.n, study.k
    printed = {s.name: s for s in constraints(study)}
    wrong = _impossible(study, reading, printed)
    known = {name: s for name, s in printed.items() if name not in wrong}
    epsilon, against = _epsilon(study, reading, known)
    wrong |= against
    f_ratio = np.maximum(ends_of(known, "anova.F"), 0.0)
    conflict = _contradicted(known, {"anova.eta2": _eta2(f_ratio, n)}, "F gives")
    if not conflict:
        share = np.clip(ends_of(known, "anova.eta2"), 0.0, 1.0)
        f_ratio = np.clip(f_ratio, *((n - 1) * share / (1.0 - share)))
    wrong |= conflict
    if "mauchly.p" in known:
        p = mauchly_p_value(np.maximum(ends_of(known, "mauchly.chi2"), 0.0), n, k)
        wrong |= _contradicted(known, {"mauchly.p": p}, "χ² gives")
    p = 2.0 * special.stdtr(n - 1, -ends_of(known, "t_test.t"))
    wrong |= _contradicted(known, {"t_test.p": p}, "t gives")
    wrong |= _contradicted(known, {"t_test.t": np.sqrt(f_ratio)}, "F gives")
    factor = np.array([reading.rounded or 1.0])
    if reading.p and not reading.rounded:
        # At a given F, p may be greatest between the ends of ε.
        low, high = np.clip(epsilon, 1.0 / (k - 1), 1.0)
        factor = np.linspace(low, high, 1001)
    df = (k - 1) * factor[:, None]
    p = special.fdtrc(df, df * (n - 1), f_ratio)
    return wrong | _contradicted(known, {"anova.p": p}, "F and its degrees of freedom give")


def _epsilon(
    study: PublishedStudy, reading: Reading, known: Mapping[str, Constraint]
) -> tuple[Interval, dict[str, str]]:
    """
    Return ε by most of what is printed of it, the first named winning a tie, and what needs another
    one.
    """
    d = study.k - 1
    units = {"epsilon": 1.0}
    if reading.df and not reading.rounded:
        units |= {"anova.df2": d * (study.n - 1), "anova.df1": d}
    needed = {name: ends_of(known, name) / unit for name, unit in units.items() if name in known}
    if not needed:
        return (1.0 / d, 1.0), {}
    # If intervals have a common point, an end of one of them is one.
    points = [low if math.isfinite(low) else high for low, high in needed.values()]
    agreeing = max(
        ([name for name, (low, high) in needed.items() if low <= x <= high] for x in points),
        key=len,
    )
    low = max(needed[name][0] for name in agreeing)
    high = min(needed[name][1] for name in agreeing)
    believed = f"but {' and '.join(agreeing)} from {low:.6g} to {high:.6g}"
    wrong = {
        name: f"{name} = {known[name].text} needs ε from {least:.6g} to {most:.6g}, {believed}"
        for name, (least, most) in needed.items()
        if name not in agreeing
    }
    return (low, high), wrong


def _impossible(
    study: PublishedStudy, reading: Reading, printed: Mapping[str, Constraint]
) -> dict[str, str]:
    """Return numbers that no data have, and tests that there cannot be."""
    n, k = study.n, study.k
    d = k - 1
    factor = np.array([reading.rounded or (1.0 / d if reading.df else 1.0), reading.rounded or 1.0])
    # The least and the greatest value of a statistic.
    limits: dict[str, Any] = {
        "anova.df1": d * factor,
        "anova.df2": d * (n - 1) * factor,
        "epsilon": (1.0 / d, 1.0),
        "mauchly.df": [k * d // 2 - 1] * 2,
        "t_test.df": [n - 1] * 2,
    }
    wrong = {}
    for name, s in printed.items():
        test, _, condition = name.partition(".")
        least, most = limits.get(name, (0.0, 1.0 if s.is_p or name == "anova.eta2" else math.inf))
        where = ""
        if name in limits:
            where = f" for {k} conditions, n = {n}{_where_degrees_belong(printed)}"
        elif test == "mean":
            (least, most), where = study.scale, " on its scale"
        elif test == "sd" and condition in study.mean and f"mean.{condition}" not in wrong:
            mean = printed[f"mean.{condition}"]
            most = greatest_sd((mean.low, mean.high), n, study.scale)
            if most < math.inf:
                within = "from {:g} to {:g}".format(*study.scale)
                where = f" for {n} values {within} with mean {mean.text}"
        gap = min(s.high - least, most - s.low)
        if test == "mauchly" and not 2 < k <= n:
            wrong[name] = f"{k} conditions of {n} subjects have no test of sphericity"
        elif test == "t_test" and k != 2:
            wrong[name] = f"a t-test compares two conditions, and there are {k}"
        elif gap < 0.0 or (gap == 0.0 and math.isinf(s.high - s.low)):  # “<x” excludes x
            within = f"lie between {least:.4g} and {most:.4g}" if least < most else f"be {most:g}"
            wrong[name] = f"{name} = {s.text} must {within}{where}"
    return wrong


def _where_degrees_belong(printed: Mapping[str, Constraint]) -> str:
    """Return to which design the degrees of freedom of F belong, if they belong to one."""
    if not {"anova.df1", "anova.df2"} <= printed.keys():
        return ""
    (low1, high1), (low2, high2) = (ends_of(printed, f"anova.{df}") for df in ("df1", "df2"))
    df1, df2 = 0.5 * (low1 + high1), 0.5 * (low2 + high2)
    if low1 <= 0.0 or not math.isfinite(df1 + df2):
        return ""
    people, k = round(df2 / df1) + 1, math.ceil(df1) + 1
    if people < 2 or not low2 / high1 <= people - 1 <= high2 / low1:
        return ""
    degrees = f"{printed['anova.df1'].text} and {printed['anova.df2'].text}"
    epsilon = f", ε = {df2 / (k - 1) / (people - 1):.2f}" if df1 < k - 1 else ""
    return f"; {degrees} belong to {k} conditions, n = {people}{epsilon}"


def _contradicted(
    known: Mapping[str, Constraint], values: Mapping[str, np.ndarray], source: str
) -> dict[str, str]:
    """Return the conflicts of numbers with what they are at the ends of others."""
    conflicts = {}
    for name, reached in values.items():
        least, most = np.min(reached), np.max(reached)
        low, high = ends_of(known, name)
        if most < low or least > high:  # what is no number allows everything
            text = f"{name} = {known[name].text}, but {source} {least:.4g} to {most:.4g}"
            conflicts[name] = text
    return conflicts


@np.errstate(all="ignore")
def _beside_the_cells(
    study: PublishedStudy, p_adjust: str, wrong: Mapping[str, str]
) -> dict[str, str]:
    """
    Return F, t and p that printed means and standard deviations allow under no correlations.

    t² is the F of two conditions.
    """
    n, m = study.n, study.k * (study.k - 1) // 2
    known = {s.name: s for s in constraints(study) if s.name not in wrong}
    mean, sd = (
        np.array([ends_of(known, f"{cell}.{c}") for c in study.conditions])
        for cell in ("mean", "sd")
    )
    f_ratio = np.array(possible_f(mean, sd, n))
    possible = {"anova.F": f_ratio, "anova.eta2": _eta2(f_ratio, n)}
    for (i, a), (j, b) in combinations(enumerate(study.conditions), 2):
        t = np.sqrt(possible_f(mean[[i, j]], sd[[i, j]], n))
        p = 2.0 * special.stdtr(n - 1, -t)
        of_pair = adjusted(np.repeat(p[:, None], m, axis=1), p_adjust)
        # Holm multiplies p by 1 to m.
        of_pair = np.append(of_pair, p) if p_adjust == "holm" else of_pair
        possible |= {"t_test.t": t, "t_test.p": p}  # of two conditions
        possible |= {f"pairs.{a}-{b}": of_pair, f"pairs.{b}-{a}": of_pair}
    return _contradicted(known, possible, "means and standard deviations allow")


def _eta2(f_ratio: np.ndarray, n: int) -> np.ndarray:
    """Return partial η² = F/(F + n − 1)."""
    return 1.0 / (1.0 + (n - 1) / f_ratio)


def possible_f(mean: np.ndarray, sd: np.ndarray, n: float) -> Interval:
    """
    Return bounds of F over boxes (k, 2) of means and standard deviations, at any correlations.

    With T = tr(PS), F = n Σ(m − m̄)²/T. An end that is open allows everything.
    """
    largest = np.maximum(sd[:, 1], 0.0)
    # T is least where all correlations are 1, and greatest where the sum of conditions is constant.
    least_error = _least_spread(np.maximum(sd, 0.0))
    most_error = 0.5 * largest.sum() ** 2 if len(sd) == 2 else (largest**2).sum()
    most_effect = (np.abs(mean - mean.mean()).max(axis=1) ** 2).sum()
    return np.divide(n * _least_spread(mean), most_error), np.divide(n * most_effect, least_error)


def _least_spread(boxes: np.ndarray) -> float:
    """Return a lower bound of Σ(m − m̄)², the least of Σ(m − c)² by c, over intervals (k, 2)."""
    low, high = boxes.T
    if low.max() <= high.min():
        return 0.0

    def spread(c: float) -> float:
        return float((np.maximum(np.maximum(low - c, c - high), 0.0) ** 2).sum())

    return optimize.minimize_scalar(spread, (high.min(), low.max())).fun * (1.0 - 1e-6)
