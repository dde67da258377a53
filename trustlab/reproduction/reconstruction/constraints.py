"""
What a printed study implies about means and covariance: an interval per printed number.

A pair's p may be printed unadjusted or adjusted for the m = k(k − 1)/2 comparisons: Bonferroni m p,
Šidák 1 − (1 − p)^m, Holm the running maximum of (m − l + 1) p_(l). Degrees of freedom, p of F, both
or neither may be corrected by the ε of Greenhouse and Geisser, and the ε may have been rounded
before: a `Reading` says which.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from itertools import combinations

import numpy as np
from scipy import optimize, special

from trustlab.reproduction.printed_number import printed_decimal, printed_interval
from trustlab.reproduction.published_study import PublishedStudy
from trustlab.studies.anova import mauchly_p_value

# Adjustments of pairwise p-values for the number of comparisons.
ADJUSTMENTS = ("bonferroni", "holm", "sidak", "none")

ALPHA = 0.05
Interval = tuple[float, float]


@dataclass(frozen=True)
class Constraint:
    """
    One printed number: `low` to `high` of the statistic `kind` of means and covariance.

    `kind` is a statistic of `MomentProblem.statistics`, or "fixed" for a number that no mean and no
    covariance changes; `index` says which condition or pair, where there are several; `name` is for
    example "anova.F" or "pairs.C1-C3", `text` what is printed.
    """

    name: str
    kind: str
    index: int
    low: float
    high: float
    text: str


@dataclass(frozen=True)
class Reading:
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
    plain = {"df1": study.k - 1, "df2": (study.k - 1) * (study.n - 1)}
    # No ε makes degrees of freedom larger.
    too_many = any(
        printed_interval(study.anova[name])[0] > most
        for name, most in plain.items()
        if name in study.anova
    )
    rest = [NEITHER, ONLY_P] if too_many else [ONLY_P, ONLY_DF, BOTH, NEITHER]
    yield from (reading for reading in rest if reading != usual)
    if not study.epsilon:
        return
    epsilon = printed_decimal(study.epsilon)
    for unit in (Decimal("0.01"), Decimal("0.1")):
        rounded = epsilon.quantize(unit)
        if rounded != epsilon and rounded * (study.k - 1) >= 1:
            words = f"p and degrees of freedom corrected by ε rounded to {rounded}"
            yield Reading(words, True, True, float(rounded))


def pair_names(study: PublishedStudy) -> list[str]:
    """Return the names of all pairs of conditions, first with second, in the order of tests."""
    return [f"{a}-{b}" for a, b in combinations(study.conditions, 2)]


def size_interval(text: str) -> Interval:
    """
    Return the interval of a printed number's magnitude: which condition is first is not printed.
    """
    low, high = printed_interval(text)
    return (0.0 if low < 0.0 < high else min(abs(low), abs(high))), max(abs(low), abs(high))


def constraints(
    study: PublishedStudy, p_adjust: str, reading: Reading, movable: bool = False
) -> list[Constraint]:
    """
    Return a constraint per printed number; with `movable` only those of means and covariance.

    A pair without a p-value was reported as not significant, p > 0.05, unless the study's
    `listed_only` is set.
    """
    rows = [
        Constraint(f"{kind}.{c}", kind, q, *printed_interval(printed[c]), printed[c])
        for q, c in enumerate(study.conditions)
        for kind, printed in (("mean", study.mean), ("sd", study.sd))
        if c in printed
    ]
    rows += [*_omnibus(study, reading), *_t_test(study), *_pairwise(study, p_adjust)]
    moving = [s for s in rows if s.kind != "fixed"]
    return moving if movable else moving + [s for s in rows if s.kind == "fixed"]


def _omnibus(study: PublishedStudy, reading: Reading) -> Iterator[Constraint]:
    """Return the constraints of F and what follows from it, of epsilon and of sphericity."""
    n, k = study.n, study.k
    testable = 2 < k <= n
    for name, text in study.mauchly.items():
        low, high = printed_interval(text)
        if name == "df" or not testable:
            yield Constraint(f"mauchly.{name}", "fixed", 0, low, high, text)
        else:
            interval = (low, high) if name == "chi2" else _chi2_interval(text, n, k)
            yield Constraint(f"mauchly.{name}", "chi2", 0, *interval, text)
    if study.not_spherical and testable and not {"chi2", "p"} & study.mauchly.keys():
        interval, text = _chi2_interval(f"<{ALPHA}", n, k), f"sphericity violated, p < {ALPHA}"
        yield Constraint("mauchly.violated", "chi2", 0, *interval, text)
    if study.epsilon:
        yield Constraint("epsilon", "epsilon", 0, *printed_interval(study.epsilon), study.epsilon)
    for name, text in study.anova.items():
        kind, (low, high) = "f_ratio", printed_interval(text)
        if name == "eta2":  # η² = F/(F + n − 1)
            low, high = (
                (n - 1) * max(e, 0.0) / (1.0 - e) if e < 1.0 else math.inf for e in (low, high)
            )
        elif name == "p" and reading.rounded is None:
            kind = "anova_p"
        elif name == "p":
            low, high = _f_interval(text, study, reading.rounded)
        elif name != "F" and reading.df and reading.rounded is None:
            plain = (k - 1) if name == "df1" else (k - 1) * (n - 1)
            kind, (low, high) = "epsilon", (low / plain, high / plain)
        elif name != "F":
            kind = "fixed"
        yield Constraint(f"anova.{name}", kind, 0, low, high, text)


def _chi2_interval(text: str, n: int, k: int) -> Interval:
    """Return the χ² whose p by Mauchly's test, to second order, rounds to the printed one."""

    def quantile(p: float) -> float:
        if p <= 0.0 or mauchly_p_value(0.0, n, k) <= p:
            return math.inf if p <= 0.0 else 0.0
        # The plain chi-square quantile of p/2 lies above, as the second-order term is small beside
        # p.
        above = 2.0 * (special.chdtri(k * (k - 1) // 2 - 1, p * 0.5) + 10.0)
        return optimize.brentq(lambda x: mauchly_p_value(x, n, k) - p, 0.0, above)

    low, high = printed_interval(text)
    return quantile(high), quantile(low)


def _f_interval(text: str, study: PublishedStudy, epsilon: float) -> Interval:
    """Return the F whose p, at degrees of freedom corrected by an ε, rounds to the printed one."""
    df1 = epsilon * (study.k - 1)
    low, high = np.clip(printed_interval(text), 0.0, 1.0)
    least, most = special.fdtri(df1, df1 * (study.n - 1), 1.0 - np.array([high, low]))
    return float(least), float(most)


def _t_test(study: PublishedStudy) -> Iterator[Constraint]:
    """Return the constraints of a paired t and its p; t by its size."""
    for name, text in study.t_test.items():
        kind, (low, high) = "p", printed_interval(text)
        if name == "df" or study.k != 2:
            kind = "fixed"
        elif name == "t":
            high, low = (2.0 * special.stdtr(study.n - 1, -t) for t in size_interval(text))
        yield Constraint(f"t_test.{name}", kind, 0, low, high, text)


def _pairwise(study: PublishedStudy, p_adjust: str) -> Iterator[Constraint]:
    """
    Return the constraints of pairwise comparisons; pairs that are not listed were not significant.
    """
    named = {study.pair(name): (name, *printed_interval(p), p) for name, p in study.pairs.items()}
    for name in study.significant_without_p:
        named[study.pair(name)] = (name, 0.0, ALPHA, "significant")
    unlisted = not study.listed_only and named
    pairs = combinations(range(study.k), 2)
    for q, (pair, label) in enumerate(zip(pairs, pair_names(study), strict=True)):
        if pair not in named and not unlisted:
            continue
        name, low, high, text = named.get(pair, (label, ALPHA, math.inf, "not significant"))
        kind = "adjusted_p"
        if p_adjust != "holm":  # the others invert pair by pair
            kind = "p"
            low, high = (_unadjusted(p, p_adjust, len(pair_names(study))) for p in (low, high))
        yield Constraint(f"pairs.{name}", kind, q, low, high, text)


def _unadjusted(p: float, p_adjust: str, m: int) -> float:
    """Return p before its adjustment for m comparisons."""
    if not 0.0 < p < 1.0 or p_adjust == "none":
        return p
    return p / m if p_adjust == "bonferroni" else -math.expm1(math.log1p(-p) / m)


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
