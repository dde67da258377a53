"""
What a printed study implies about means and covariance: an interval per printed number.

A pair's p may be printed unadjusted or adjusted for the m = k(k − 1)/2 comparisons: Bonferroni m p,
Šidák 1 − (1 − p)^m, Holm the running maximum of (m − l + 1) p_(l). Each printed p is an interval,
"<.0005" a half-line. Some printed numbers contradict each other by arithmetic alone, whatever the
data: `arithmetic_conflicts` names them.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache

import numpy as np
from scipy import optimize, special

from trustlab.models.checks import of_class, one_of
from trustlab.reproduction.printed_number import printed_interval
from trustlab.reproduction.published_study import PublishedStudy, published_studies
from trustlab.reproduction.reconstruction.moment_statistics import pair_indices
from trustlab.reproduction.reconstruction.readings import Reading, readings
from trustlab.studies.anova import mauchly_p_value

# Adjustments of pairwise p-values for the number of comparisons.
ADJUSTMENTS = ("bonferroni", "holm", "sidak", "none")

ALPHA = 0.05
Interval = tuple[float, float]

# Printed numbers that fix one statistic: kind to its name and theirs; those first believed come
# first.
COMPARED = {
    "epsilon": ("epsilon", ("epsilon", "anova.df2", "anova.df1")),
    "f_ratio": ("F", ("anova.F", "anova.eta2")),
    "chi2": ("chi-square", ("mauchly.chi2", "mauchly.p")),
}


@dataclass(frozen=True)
class Constraint:
    """
    One printed number: `low` to `high` of the statistic `kind` of means and covariance.

    `kind` is a statistic of `MomentStatistics`, or "log_adjusted_p" or "spread" of `MomentProblem`;
    `index` says which condition or pair, where there are several; `name` is for example "anova.F"
    or "pairs.C1-C3", `text` what is printed.
    """

    name: str
    kind: str
    index: int
    low: float
    high: float
    text: str


def log_interval(text: str) -> Interval:
    """Return the interval of the logarithm of a printed p; infinite where p can be 0 or 1."""
    low, high = printed_interval(text)
    return (math.log(low) if low > 0.0 else -math.inf), (math.log(high) if high < 1.0 else math.inf)


def _chi2_interval(text: str, n: int, k: int) -> Interval:
    """Return the χ² whose p by Mauchly's test, to second order, rounds to the printed one."""
    low, high = printed_interval(text)

    def quantile(p: float) -> float:
        if mauchly_p_value(0.0, n, k) <= p:
            return 0.0
        # The plain chi-square quantile of p/2 lies above, as the second-order term is small beside
        # p.
        above = 2.0 * (special.chdtri(k * (k - 1) // 2 - 1, p * 0.5) + 10.0)
        return optimize.brentq(lambda x: mauchly_p_value(x, n, k) - p, 0.0, above)

    return quantile(high) if high < 1.0 else 0.0, quantile(low) if low > 0.0 else math.inf


def _f_interval(text: str, study: PublishedStudy, epsilon: float) -> Interval:
    """Return the F whose p, at degrees of freedom corrected by an ε, rounds to the printed one."""
    df1 = epsilon * (study.k - 1)
    low, high = (min(max(p, 0.0), 1.0) for p in printed_interval(text))
    least, most = special.fdtri(df1, df1 * (study.n - 1), 1.0 - np.array([high, low]))
    return float(least), float(most)


def _omnibus(study: PublishedStudy, reading: Reading) -> list[Constraint]:
    """Return the constraints of F and what follows from it, of epsilon and of sphericity."""
    n = study.n
    k = study.k
    rows = []

    def add(name: str, kind: str, interval: Interval, text: str) -> None:
        rows.append(Constraint(name, kind, 0, *interval, text))

    for name, text in study.anova.items():
        low, high = printed_interval(text)
        if name == "F":
            add("anova.F", "f_ratio", (low, high), text)
        elif name == "eta2":  # η² = F/(F + n − 1)
            low, high = (
                (n - 1) * max(e, 0.0) / (1.0 - e) if e < 1.0 else math.inf for e in (low, high)
            )
            add("anova.eta2", "f_ratio", (low, high), text)
        elif name == "p":
            if reading.rounded is None:
                add("anova.p", "log_anova_p", log_interval(text), text)
            else:
                add("anova.p", "f_ratio", _f_interval(text, study, reading.rounded), text)
        elif reading.df and reading.rounded is None:
            plain = (k - 1) if name == "df1" else (k - 1) * (n - 1)
            add(f"anova.{name}", "epsilon", (low / plain, high / plain), text)
    if study.epsilon:
        add("epsilon", "epsilon", printed_interval(study.epsilon), study.epsilon)
    chi2, p = study.mauchly.get("chi2"), study.mauchly.get("p")
    if chi2:
        add("mauchly.chi2", "chi2", printed_interval(chi2), chi2)
    if p:
        add("mauchly.p", "chi2", _chi2_interval(p, n, k), p)
    elif study.not_spherical and not chi2:
        add(
            "mauchly.violated",
            "chi2",
            _chi2_interval(f"<{ALPHA}", n, k),
            "sphericity violated, p < 0.05",
        )
    return rows


def _t_test(study: PublishedStudy) -> list[Constraint]:
    """Return the constraints of a paired t and its p."""
    rows = []
    for name, text in study.t_test.items():
        if name == "t":
            high, low = (
                math.log(2.0 * special.stdtr(study.n - 1, -t)) for t in size_interval(text)
            )
            rows.append(Constraint("t_test.t", "log_p", 0, low, high, text))
        elif name == "p":
            rows.append(Constraint("t_test.p", "log_p", 0, *log_interval(text), text))
    return rows


def size_interval(text: str) -> Interval:
    """
    Return the interval of a printed number's magnitude: which condition is first is not printed.
    """
    low, high = printed_interval(text)
    return (0.0 if low < 0.0 < high else min(abs(low), abs(high))), max(abs(low), abs(high))


def _pairwise(study: PublishedStudy, p_adjust: str) -> list[Constraint]:
    """
    Return the constraints of pairwise comparisons; pairs that are not listed were not significant.
    """
    named = {
        study.pair(name): (name, *log_interval(text), text) for name, text in study.pairs.items()
    }
    for name in study.significant_without_p:
        named[study.pair(name)] = (name, -math.inf, math.log(ALPHA), "significant")
    silent = study.listed_only or not named
    pairs = list(zip(*(index.tolist() for index in pair_indices(study.k)), strict=True))
    rows = []
    for q, (i, j) in enumerate(pairs):
        if (i, j) in named:
            name, low, high, text = named[i, j]
        elif silent:
            continue
        else:
            name = f"{study.conditions[i]}-{study.conditions[j]}"
            low = math.log(ALPHA)
            high = math.inf
            text = "not significant"
        kind = "log_adjusted_p"
        if p_adjust != "holm":  # the others invert pair by pair
            kind = "log_p"
            low, high = (_unadjusted(x, p_adjust, len(pairs)) for x in (low, high))
        rows.append(Constraint(f"pairs.{name}", kind, q, low, high, text))
    return rows


def _unadjusted(log_p: float, p_adjust: str, m: int) -> float:
    """Return the logarithm of p before its adjustment for m comparisons."""
    if math.isinf(log_p) or p_adjust == "none":
        return log_p
    if p_adjust == "bonferroni":
        return log_p - math.log(m)
    return math.log(-math.expm1(math.log1p(-math.exp(log_p)) / m))


def _named_study(name: str) -> str:
    """Return how to get the printed study that a name is nearest to."""
    known = published_studies()
    near = name if name in known else next(iter(get_close_matches(name, known, n=1)), "uav.tlx")
    return f"a printed one is published_studies()[{near!r}]"


def constraints(
    study: PublishedStudy, p_adjust: str = "bonferroni", reading: Reading | None = None
) -> list[Constraint]:
    """
    Return a constraint per printed number that means and covariance decide.

    A pair without a p-value was reported as not significant, p > 0.05, unless the study's
    `listed_only` is set. The reading is that of `reading_of` unless given.
    """
    of_class("study", study, PublishedStudy, _named_study(study) if isinstance(study, str) else "")
    one_of("p_adjust", p_adjust, ADJUSTMENTS)
    reading = reading_of(study) if reading is None else reading
    rows = []
    for q, condition in enumerate(study.conditions):
        for kind, printed in (("mean", study.mean), ("sd", study.sd)):
            if condition in printed:
                text = printed[condition]
                rows.append(
                    Constraint(f"{kind}.{condition}", kind, q, *printed_interval(text), text)
                )
    return [*rows, *_omnibus(study, reading), *_t_test(study), *_pairwise(study, p_adjust)]


@lru_cache(maxsize=64)
def reading_of(study: PublishedStudy) -> Reading:
    """Return the reading under which least contradicts by arithmetic; of several the most usual."""
    return min(readings(study), key=lambda reading: len(arithmetic_conflicts(study, reading)))


def degrees(study: PublishedStudy) -> list[Constraint]:
    """Return the printed degrees of freedom that no mean and no covariance changes."""
    moving = {s.name for s in constraints(study)}
    rows = []
    for test in ("mauchly", "anova", "t_test"):
        for name, text in getattr(study, test).items():
            if name.startswith("df") and f"{test}.{name}" not in moving:
                interval = printed_interval(text)
                rows.append(Constraint(f"{test}.{name}", "degrees", 0, *interval, text))
    return rows


def select(listed: Iterable[Constraint], without: Iterable[str]) -> list[Constraint]:
    """Return the constraints that are not left out by name, "anova.F", or group, "pairs"."""
    if isinstance(without, str):
        raise ValueError(
            f'without must be a list of names, such as ("mauchly", "pairs"), got {without!r}'
        )
    listed, without = list(listed), tuple(without)
    known = {s.name for s in listed} | {s.name.split(".")[0] for s in listed}
    for name in without:
        if name not in known:
            raise ValueError(
                f"without: {name!r} is not among its statistics {', '.join(sorted(known))}"
            )
    return [s for s in listed if s.name not in without and s.name.split(".")[0] not in without]


def _largest_agreement(group: Sequence[Constraint]) -> list[Constraint]:
    """
    Return the most constraints whose intervals have a point in common; the first named win a tie.
    """
    # If intervals have a common point, the lower end of one of them is one.
    ends = [s.low if math.isfinite(s.low) else s.high for s in group]
    return max(([s for s in group if s.low <= end <= s.high] for end in ends), key=len)


def arithmetic_conflicts(study: PublishedStudy, reading: Reading | None = None) -> dict[str, str]:
    """
    Return the printed numbers that contradict others, by name with the reason.

    Partial eta² against F, degrees of freedom against ε and n, p against F and its degrees of
    freedom, Mauchly's p against its chi-square. Of numbers that disagree, the fewest are named; of
    two, the one that is computed from the other.
    """
    of_class("study", study, PublishedStudy)
    reading = reading_of(study) if reading is None else reading
    by_name = {s.name: s for s in constraints(study, reading=reading)}
    conflicts, ranges = {}, {}
    for kind, (label, names) in COMPARED.items():
        group = [by_name[name] for name in names if name in by_name]
        if not group:
            continue
        agreeing = _largest_agreement(group)
        low, high = max(s.low for s in agreeing), min(s.high for s in agreeing)
        ranges[kind] = low, high
        believed = " and ".join(f"{s.name} = {s.text}" for s in agreeing)
        for s in group:
            if s not in agreeing:
                conflicts[s.name] = (
                    f"{s.name} = {s.text} needs {label} from {s.low:.6g} to {s.high:.6g}, but "
                    f"{believed} needs {low:.6g} to {high:.6g}"
                )
    if "p" in study.anova and "f_ratio" in ranges:
        p = _p_of_f(study, ranges["f_ratio"], ranges.get("epsilon"), reading)
        conflicts |= _contradicted(
            "anova.p", study.anova["p"], p, "F and its degrees of freedom give"
        )
    if {"t", "p"} <= set(study.t_test):
        p = 2.0 * special.stdtr(study.n - 1, -np.array(size_interval(study.t_test["t"])))
        conflicts |= _contradicted("t_test.p", study.t_test["p"], p, "t gives")
    return conflicts | _wrong_degrees(study, reading)


def _p_of_f(
    study: PublishedStudy, f_ratio: Interval, epsilon: Interval | None, reading: Reading
) -> np.ndarray:
    """Return p at the ends of the intervals of F and, where p is corrected, of epsilon."""
    least = 1.0 / (study.k - 1)
    factor = np.ones(2)
    if reading.rounded is not None:
        factor *= reading.rounded
    elif reading.p:
        factor = np.clip(epsilon or (least, 1.0), least, 1.0)
    df = (study.k - 1) * factor[:, None]
    return special.fdtrc(df, df * (study.n - 1), np.maximum(f_ratio, 0.0))


def _contradicted(name: str, text: str, p: np.ndarray, source: str) -> dict[str, str]:
    """Return the conflict of a printed p with those at the ends of other intervals, if any."""
    low, high = printed_interval(text)
    if p.min() <= high and p.max() >= low:
        return {}
    return {name: f"{name} = {text}, but {source} {p.min():.4g} to {p.max():.4g}"}


def _wrong_degrees(study: PublishedStudy, reading: Reading) -> dict[str, str]:
    """Return degrees of freedom that follow from n, k and the reading and are printed otherwise."""
    n, k = study.n, study.k
    factor = 1.0 if reading.rounded is None else reading.rounded
    follows = {"df1": ("k − 1", k - 1), "df2": ("(k − 1)(n − 1)", (k - 1) * (n - 1))}
    conflicts = {}
    for name, (formula, plain) in follows.items():
        text = study.anova.get(name)
        if text is None or (reading.df and reading.rounded is None):
            continue
        low, high = printed_interval(text)
        if low <= factor * plain <= high:
            continue
        by = "" if reading.rounded is None else f"{factor:g} "
        conflicts[f"anova.{name}"] = (
            f"anova.{name} = {text}, but {by}{formula} = {factor * plain:g}"
        )
        people = float(text) / (k - 1) + 1.0
        if name == "df2" and factor == 1.0 and people == round(people):
            conflicts["anova.df2"] += f" for n = {n}; it belongs to n = {people:g}"
    df = study.t_test.get("df")
    if df and float(df) != n - 1:
        conflicts["t_test.df"] = f"t_test.df = {df}, but n − 1 = {n - 1}"
    return conflicts
