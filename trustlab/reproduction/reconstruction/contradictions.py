"""
Printed numbers that contradict others by arithmetic alone, whatever the data.

Of numbers that disagree, the fewest are named; of two, the one that is computed from the other.
"""

import math
from collections.abc import Mapping
from itertools import combinations, permutations
from typing import Any

import numpy as np
from scipy import special

from trustlab.reproduction.printed import Interval, greatest_sd, possible_f, printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import (
    Constraint,
    Reading,
    adjusted,
    constraints,
    readings,
)
from trustlab.studies.anova import mauchly_p_value


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


def _under(study: PublishedStudy, reading: Reading) -> dict[str, str]:
    """Return what contradicts under a reading, but for what the tests say of the cells."""
    n, k = study.n, study.k
    printed = {s.name: s for s in constraints(study)}
    wrong = _impossible(study, reading, printed)
    known = {name: np.array([s.low, s.high]) for name, s in printed.items() if name not in wrong}
    epsilon, against = _epsilon(study, reading, known)
    wrong |= {name: f"{name} = {printed[name].text} {why}" for name, why in against.items()}
    f_ratio = np.maximum(known.get("anova.F", np.array([0.0, math.inf])), 0.0)
    if "anova.eta2" in known:  # η² = F/(F + n − 1)
        with np.errstate(divide="ignore"):
            share = np.clip(known["anova.eta2"], 0.0, 1.0)
            needed = (n - 1) * share / (1.0 - share)
            conflict = _contradicted(printed["anova.eta2"], _eta2(f_ratio, n), "F gives")
        if not conflict:
            f_ratio = np.clip(f_ratio, *needed)
        wrong |= conflict
    if {"mauchly.chi2", "mauchly.p"} <= known.keys():
        p = mauchly_p_value(np.maximum(known["mauchly.chi2"], 0.0), n, k)
        wrong |= _contradicted(printed["mauchly.p"], p, "χ² gives")
    if {"t_test.t", "t_test.p"} <= known.keys():
        p = 2.0 * special.stdtr(n - 1, -known["t_test.t"])
        wrong |= _contradicted(printed["t_test.p"], p, "t gives")
    if k == 2 and "t_test.t" in known:  # |t| is the root of F
        wrong |= _contradicted(printed["t_test.t"], np.sqrt(f_ratio), "F gives")
    if "anova.p" in known and {"anova.F", "anova.eta2"} & known.keys():
        factor = np.array([reading.rounded or 1.0])
        if reading.p and not reading.rounded:
            # At a given F, p may be greatest between the ends of ε.
            least, most = np.clip(epsilon, 1.0 / (k - 1), 1.0)
            factor = np.linspace(least, most, 1001)
        df = (k - 1) * factor[:, None]
        p = special.fdtrc(df, df * (n - 1), f_ratio)
        wrong |= _contradicted(printed["anova.p"], p, "F and its degrees of freedom give")
    return wrong


def _epsilon(
    study: PublishedStudy, reading: Reading, known: Mapping[str, np.ndarray]
) -> tuple[Interval, dict[str, str]]:
    """
    Return ε by most of what is printed of it, the first named winning a tie, and what needs another
    one.
    """
    d = study.k - 1
    units = {"epsilon": 1.0}
    if reading.df and not reading.rounded:
        units |= {"anova.df2": d * (study.n - 1), "anova.df1": d}
    needed = {name: known[name] / unit for name, unit in units.items() if name in known}
    if not needed:
        return (1.0 / d, 1.0), {}
    # If intervals have a common point, an end of one of them is one.
    ends = [low if math.isfinite(low) else high for low, high in needed.values()]
    agreeing = max(
        ([name for name, (low, high) in needed.items() if low <= end <= high] for end in ends),
        key=len,
    )
    low = max(needed[name][0] for name in agreeing)
    high = min(needed[name][1] for name in agreeing)
    believed = f"but {' and '.join(agreeing)} from {low:.6g} to {high:.6g}"
    others = {name: ends for name, ends in needed.items() if name not in agreeing}
    wrong = {
        name: f"needs ε from {ends[0]:.6g} to {ends[1]:.6g}, {believed}"
        for name, ends in others.items()
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
            where = f" for {k} conditions, n = {n}{_where_degrees_belong(study)}"
        elif test == "mean":
            (least, most), where = study.scale, " on its scale"
        elif test == "sd" and condition in study.mean and f"mean.{condition}" not in wrong:
            most = greatest_sd(printed_interval(study.mean[condition]), n, study.scale)
            if most < math.inf:
                within = "from {:g} to {:g}".format(*study.scale)
                where = f" for {n} values {within} with mean {study.mean[condition]}"
        if test == "mauchly" and not 2 < k <= n:
            few = f"{n} subjects are too few for {k} conditions"
            wrong[name] = few if k > 2 else "sphericity always holds for two conditions"
        elif test == "t_test" and k != 2:
            wrong[name] = f"a t-test compares two conditions, and there are {k}"
        elif not _meets(s, least, most):
            within = f"be {most:g}" if least == most else f"lie between {least:.4g} and {most:.4g}"
            within = within if most < math.inf else f"be {least:.4g} or more"
            wrong[name] = f"{name} = {s.text} must {within}{where}"
    return wrong


def _meets(s: Constraint, least: float, most: float) -> bool:
    """Return whether a number agrees with a value from least to most; “<x” excludes x."""
    bounds = (s.low > -math.inf or s.high > least) and (s.high < math.inf or s.low < most)
    return least <= s.high and s.low <= most and bounds


def _where_degrees_belong(study: PublishedStudy) -> str:
    """Return to which design the degrees of freedom of F belong, if they belong to one."""
    if not {"df1", "df2"} <= study.anova.keys():
        return ""
    (low1, high1), (low2, high2) = (printed_interval(study.anova[name]) for name in ("df1", "df2"))
    df1, df2 = 0.5 * (low1 + high1), 0.5 * (low2 + high2)
    if not 0.0 < low1 <= high1 < math.inf or math.isinf(df2):
        return ""
    people, k = round(df2 / df1) + 1, math.ceil(df1) + 1
    if people < 2 or not low2 / high1 <= people - 1 <= high2 / low1:
        return ""
    epsilon = df2 / (k - 1) / (people - 1)
    by = f", ε = {epsilon:.2f}" if df1 < k - 1 else ""
    degrees = f"{study.anova['df1']} and {study.anova['df2']}"
    return f"; {degrees} belong to {k} conditions, n = {people}{by}"


def _contradicted(s: Constraint, values: np.ndarray, source: str) -> dict[str, str]:
    """Return the conflict of a number with what it is at the ends of others, if any."""
    least, most = np.min(values), np.max(values)
    if not (most < s.low or least > s.high):  # what is no number allows everything
        return {}
    return {s.name: f"{s.name} = {s.text}, but {source} {least:.4g} to {most:.4g}"}


def _beside_the_cells(
    study: PublishedStudy, p_adjust: str, wrong: Mapping[str, str]
) -> dict[str, str]:
    """
    Return F, t and p that printed means and standard deviations allow under no correlations.

    t² is the F of two conditions.
    """
    n, m = study.n, study.k * (study.k - 1) // 2
    printed = {s.name: s for s in constraints(study) if s.name not in wrong}
    conflicts = {}
    for conditions in dict.fromkeys([study.conditions, *combinations(study.conditions, 2)]):
        cells = [[printed.get(f"{cell}.{c}") for c in conditions] for cell in ("mean", "sd")]
        if None in cells[0] + cells[1]:
            continue
        mean, sd = (np.array([(s.low, s.high) for s in box]) for box in cells)
        possible = {}
        with np.errstate(all="ignore"):  # an end that is open allows everything
            f_ratio = np.array(possible_f(mean, sd, n))
            if conditions == study.conditions:
                possible = {"anova.F": f_ratio, "anova.eta2": _eta2(f_ratio, n)}
            if len(conditions) == 2:
                t = np.sqrt(f_ratio)
                p = 2.0 * special.stdtr(n - 1, -t)
                of_pair = adjusted(np.repeat(p[:, None], m, axis=1), p_adjust)
                # Holm multiplies p by 1 to m.
                of_pair = np.append(of_pair, p) if p_adjust == "holm" else of_pair
                named = dict.fromkeys(
                    (f"pairs.{'-'.join(c)}" for c in permutations(conditions)), of_pair
                )
                possible |= {"t_test.t": t, "t_test.p": p, **named}
        for name in printed:
            if name in possible:
                source = "means and standard deviations allow"
                conflicts |= _contradicted(printed[name], possible[name], source)
    return conflicts


def _eta2(f_ratio: np.ndarray, n: int) -> np.ndarray:
    """Return partial η² = F/(F + n − 1)."""
    return 1.0 / (1.0 + (n - 1) / f_ratio)
