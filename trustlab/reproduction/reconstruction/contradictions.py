"""
Printed numbers that contradict others by arithmetic alone, whatever the data.

Of numbers that disagree, the fewest are named; of two, the one that is computed from the other.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations

import numpy as np
from scipy import optimize, special

from trustlab.reproduction.printed_number import printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import (
    Constraint,
    Interval,
    Reading,
    constraints,
    readings,
    size_interval,
)

# Printed numbers that fix one statistic: kind to its name and theirs; those first believed come
# first.
COMPARED = {
    "epsilon": ("epsilon", ("epsilon", "anova.df2", "anova.df1")),
    "f_ratio": ("F", ("anova.F", "anova.eta2")),
    "chi2": ("chi-square", ("mauchly.chi2", "mauchly.p")),
}

# The most that a statistic can be; the least is 0.
LIMITS = {
    "anova.F": math.inf,
    "anova.eta2": 1.0,
    "anova.p": 1.0,
    "mauchly.chi2": math.inf,
    "mauchly.p": 1.0,
    "t_test.p": 1.0,
    "pairs": 1.0,
}


@lru_cache(maxsize=64)
def reading_of(study: PublishedStudy) -> Reading:
    """Return the reading under which least contradicts by arithmetic; of several the most usual."""
    return min(readings(study), key=lambda reading: len(_of_the_tests(study, reading)))


def contradictions(study: PublishedStudy, p_adjust: str = "bonferroni") -> dict[str, str]:
    """
    Return the printed numbers that contradict others, by name with the reason.

    Numbers that cannot be (p above 1, a mean outside the scale), partial eta² against F, degrees of
    freedom against ε and n, p against F and its degrees of freedom, Mauchly's p against its
    chi-square, and F, t and p against what the means and standard deviations allow.
    """
    wrong = _of_the_tests(study, reading_of(study)) | _of_the_cells(study)
    return _beside_the_cells(study, p_adjust, wrong) | wrong


def _of_the_cells(study: PublishedStudy) -> dict[str, str]:
    """Return means and standard deviations that n values within the scale cannot have."""
    low, high = study.scale
    wrong = {}
    for condition, text in study.mean.items():
        least, most = printed_interval(text)
        if most < low or least > high:
            wrong[f"mean.{condition}"] = (
                f"mean.{condition} = {text} lies outside the scale {low:g} to {high:g}"
            )
    for condition, text in study.sd.items():
        name, (least, most) = f"sd.{condition}", printed_interval(text)
        if most < 0.0:
            wrong[name] = f"{name} = {text} is negative"
        if condition not in study.mean or math.isinf(high - low) or f"mean.{condition}" in wrong:
            continue
        # The variance is greatest with all values at the ends of the scale, and with the mean as
        # near its middle as can be.
        mean = float(np.clip(0.5 * (low + high), *printed_interval(study.mean[condition])))
        spread = math.sqrt(max((mean - low) * (high - mean), 0.0) * study.n / (study.n - 1))
        if least > spread:
            wrong[name] = (
                f"{name} = {text} exceeds what {study.n} values from {low:g} to {high:g} with "
                f"mean {study.mean[condition]} can have ({spread:.4g})"
            )
    return wrong


def _of_the_tests(study: PublishedStudy, reading: Reading) -> dict[str, str]:
    """Return what contradicts among the statistics of the tests, under a reading."""
    listed = constraints(study, "none", reading)
    wrong = _impossible(study, listed) | _wrong_degrees(study, reading)
    by_name = {s.name: s for s in listed if s.name not in wrong}
    ranges: dict[str, Interval] = {}
    for kind, (label, names) in COMPARED.items():
        group = [by_name[name] for name in names if name in by_name and by_name[name].kind == kind]
        if not group:
            continue
        agreeing = _largest_agreement(group)
        low, high = max(s.low for s in agreeing), min(s.high for s in agreeing)
        ranges[kind] = low, high
        believed = " and ".join(f"{s.name} = {s.text}" for s in agreeing)
        wrong |= {
            s.name: f"{s.name} = {s.text} needs {label} from {s.low:.6g} to {s.high:.6g}, but "
            f"{believed} needs {low:.6g} to {high:.6g}"
            for s in group
            if s not in agreeing
        }
    if "anova.p" in by_name and "f_ratio" in ranges:
        wrong |= _wrong_p_of_f(study, reading, ranges, wrong)
    if {"t_test.t", "t_test.p"} <= by_name.keys():
        p = 2.0 * special.stdtr(study.n - 1, -np.array(size_interval(study.t_test["t"])))
        wrong |= _contradicted("t_test.p", study.t_test["p"], p, "t gives")
    return wrong


def _largest_agreement(group: Sequence[Constraint]) -> list[Constraint]:
    """
    Return the most constraints whose intervals have a point in common; the first named win a tie.
    """
    # If intervals have a common point, the lower end of one of them is one.
    ends = [s.low if math.isfinite(s.low) else s.high for s in group]
    return max(([s for s in group if s.low <= end <= s.high] for end in ends), key=len)


def _impossible(study: PublishedStudy, listed: Sequence[Constraint]) -> dict[str, str]:
    """Return numbers that no data have, and tests that there cannot be."""
    k = study.k
    wrong = {}
    for s in listed:
        test = s.name.split(".")[0]
        if test == "mauchly" and not 2 < k <= study.n:
            few = f"{study.n} subjects are too few for {k} conditions"
            wrong[s.name] = few if k > 2 else "sphericity always holds for two conditions"
        elif test == "t_test" and k != 2:
            wrong[s.name] = f"a t-test compares two conditions, and there are {k}"
        elif s.kind == "epsilon" and not (s.low <= 1.0 and s.high >= 1.0 / (k - 1)):
            wrong[s.name] = (
                f"{s.name} = {s.text} needs ε from {s.low:.4g} to {s.high:.4g}, which must lie "
                f"between 1/(k − 1) = {1.0 / (k - 1):.4g} and 1{_where_degrees_belong(study)}"
            )
        most = LIMITS.get("pairs" if test == "pairs" else s.name)
        if most is None or not s.text.strip()[-1].isdigit():  # "not significant"
            continue
        low, high = printed_interval(s.text)
        if high < 0.0 or low > most or (high == 0.0 and "<" in s.text):
            wrong[s.name] = f"{s.name} = {s.text} must lie between 0 and {most:g}"
    return wrong


def _wrong_degrees(study: PublishedStudy, reading: Reading) -> dict[str, str]:
    """Return degrees of freedom that follow from n, k and the reading and are printed otherwise."""
    n, k = study.n, study.k
    factor = reading.rounded or 1.0
    by = f"{factor:g} " if reading.rounded else ""
    follows: dict[tuple[str, str], tuple[str, float]] = {
        ("mauchly", "df"): ("k(k − 1)/2 − 1", k * (k - 1) // 2 - 1),
        ("t_test", "df"): ("n − 1", n - 1),
    }
    if not reading.df or reading.rounded:
        follows["anova", "df1"] = f"{by}(k − 1)", factor * (k - 1)
        follows["anova", "df2"] = f"{by}(k − 1)(n − 1)", factor * (k - 1) * (n - 1)
    wrong = {}
    for (test, name), (formula, value) in follows.items():
        text = getattr(study, test).get(name, f"{value}")
        low, high = printed_interval(text)
        if not low <= value <= high:
            where = _where_degrees_belong(study) if test == "anova" else ""
            wrong[f"{test}.{name}"] = f"{test}.{name} = {text}, but {formula} = {value:g}{where}"
    return wrong


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


def _wrong_p_of_f(
    study: PublishedStudy, reading: Reading, ranges: dict[str, Interval], wrong: dict[str, str]
) -> dict[str, str]:
    """Return the conflict of p with F, and with ε where p is corrected, if any."""
    least = 1.0 / (study.k - 1)
    factor = np.full(2, reading.rounded or 1.0)
    if reading.p and not reading.rounded:
        factor = np.clip(ranges.get("epsilon", (least, 1.0)), least, 1.0)
    text, f_ratio = study.anova["p"], np.maximum(ranges["f_ratio"], 0.0)
    df = (study.k - 1) * factor[:, None]
    p = special.fdtrc(df, df * (study.n - 1), f_ratio)
    source = "F and its degrees of freedom give"
    conflict = _contradicted("anova.p", text, p, source)
    if conflict and {"anova.df1", "anova.df2"} <= wrong.keys():
        df1, df2 = (np.array(printed_interval(study.anova[name])) for name in ("df1", "df2"))
        p = special.fdtrc(df1[:, None], df2[:, None], f_ratio)
        if not _contradicted("anova.p", text, p, ""):
            conflict["anova.p"] += "; it belongs to the printed degrees of freedom"
    return conflict


def _contradicted(name: str, text: str, p: np.ndarray, source: str) -> dict[str, str]:
    """Return the conflict of a printed p with those at the ends of other intervals, if any."""
    low, high = printed_interval(text)
    if p.min() <= high and p.max() >= low:
        return {}
    return {name: f"{name} = {text}, but {source} {p.min():.4g} to {p.max():.4g}"}


def _beside_the_cells(
    study: PublishedStudy, p_adjust: str, wrong: dict[str, str]
) -> dict[str, str]:
    """
    Return F, t and p that printed means and standard deviations allow under no correlations.

    With T = tr(PS), F = n Σ(m − m̄)²/T, and t² is the F of two conditions.
    """
    listed = constraints(study, p_adjust, reading_of(study), movable=True)
    boxes = {
        (s.kind, s.index): (s.low, s.high)
        for s in listed
        if s.kind in ("mean", "sd") and s.name not in wrong
    }
    pairs = list(combinations(range(study.k), 2))
    conflicts = {}
    for s in listed:
        cells = pairs[s.index] if s.kind in ("p", "adjusted_p") else range(study.k)
        known = all((kind, i) in boxes for kind in ("mean", "sd") for i in cells)
        if s.name in wrong or not known or s.kind not in ("p", "adjusted_p", "f_ratio"):
            continue
        mean, sd = (np.array([boxes[kind, i] for i in cells]) for kind in ("mean", "sd"))
        with np.errstate(all="ignore"):  # an end that is open allows everything
            least, most = _possible_f(mean, sd, study.n)
        label = "F"
        if s.kind != "f_ratio":
            label = "p"
            high, low = 2.0 * special.stdtr(study.n - 1, -np.sqrt([least, most]))
            # Holm multiplies p by 1 to m.
            least, most = low, high * (len(pairs) if s.kind == "adjusted_p" else 1.0)
        if most < s.low or least > s.high:
            conflicts[s.name] = (
                f"{s.name} = {s.text} needs {label} from {max(s.low, 0.0):.4g} to {s.high:.4g}, "
                f"but means and standard deviations allow {least:.4g} to {most:.4g}"
            )
    return conflicts


def _possible_f(mean: np.ndarray, sd: np.ndarray, n: int) -> Interval:
    """Return bounds of F over boxes (k, 2) of means and standard deviations."""
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
