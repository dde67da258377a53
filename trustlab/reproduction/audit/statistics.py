"""What the audit says of studies as a whole: duplicates, and how p-values were adjusted."""

from itertools import combinations

import numpy as np
from scipy import stats

from trustlab.reproduction.audit.catalogue import conditions_of, study_names
from trustlab.reproduction.audit.check import (
    Finding,
    Formula,
    Numbers,
    Remark,
    Row,
    listing,
    row_about,
)
from trustlab.reproduction.audit.relations import relations
from trustlab.reproduction.printed_number import PrintedNumber

ALPHA = 0.05


def _duplicates(first: str, second: str, numbers: Numbers) -> list[Remark]:
    """Return remarks on statistics that two studies share to the last digit."""

    def same(key: str) -> bool:
        pair = [
            numbers[id].printed for id in (f"{first}/{key}", f"{second}/{key}") if id in numbers
        ]
        return len(pair) == 2 and len(set(pair)) == 1

    remarks = []
    if same("mauchly.chi2") and same("mauchly.p"):
        chi2, df = numbers[f"{second}/mauchly.chi2"], numbers[f"{second}/mauchly.df"]
        chance = float(np.diff(stats.chi2.cdf(chi2.compatible, df.value))[0])
        reason = (
            f"Suspicious: χ² = {chi2.printed} and p = {numbers[f'{second}/mauchly.p'].printed} "
            f"are printed for {first} as well; under sphericity two measures agree so closely "
            f"with a chance of about 1 in {1.0 / chance:.0f}. Probably one was copied from the "
            "other."
        )
        quantity = f"{chi2.quantity}, against {first}"
        remarks.append(Remark(chi2.id, reason, suffix="/duplicate", quantity=quantity))
    if same("anova.F"):
        reason = f"Suspicious: the same F is printed for {first}."
        remarks.append(Remark(f"{second}/anova.F", reason, suffix="/duplicate"))
    return remarks


def study_checks(numbers: Numbers) -> list[Finding]:
    """Return the rows about pairs of studies, and about all pairs of conditions of a study."""
    names = study_names(numbers)
    rows: list[Finding] = []
    for name in names:
        rows += _adjustments(name, numbers)
    for first, second in combinations(names, 2):
        rows += _duplicates(first, second, numbers)
    return rows


def pair_checks(name: str, numbers: Numbers) -> list[Finding]:
    """Return the checks of a study's pairwise p-values; the last is that of the adjustment."""
    return [*relations(numbers, f"{name}/pairs.*"), *_adjustments(name, numbers)]


def _adjustments(name: str, numbers: Numbers) -> list[Row]:
    """Return the row on the adjustment of p-values if F and all means are printed."""
    needed = [f"{name}/anova.F", *(f"{name}/mean.{c}" for c in conditions_of(name))]
    return [_adjustment(name, numbers)] if all(id in numbers for id in needed) else []


def _adjustment(name: str, numbers: Numbers) -> Row:
    """
    Return for which adjustment of p the printed pairs can go with the printed F.

    The variances of all k(k − 1)/2 differences add up to k(k − 1) MS_error, and MS_error =
    MS_conditions/F. A printed p fixes the variance of its difference, p < .0005 bounds it from
    above, no significance from below. Šidák's and Holm's p lie between the unadjusted and
    Bonferroni's. Not checkable, as neither the adjustment nor every pair is printed.
    """
    conditions, number = conditions_of(name), numbers[f"{name}/anova.F"]
    k = len(conditions)
    ids = {f"M_{c}": f"{name}/mean.{c}" for c in conditions} | {"n": f"{name}/n", "F": number.id}
    text = "k(k − 1) MS_conditions/F"
    formula = Formula(text, lambda v: k * (k - 1.0) * v.n * v.M.var(axis=0, ddof=1) / v.F, ids)
    value, low, high = formula.range(numbers)
    times = {"unadjusted": 1.0, "Bonferroni": k * (k - 1) / 2}
    spans = {way: _sum_of_variances(name, numbers, m) for way, m in times.items()}
    fits = [way for way, (least, most) in spans.items() if least <= high and most >= low]
    allowed = "; ".join(
        f"{way}: from {least:.4g} to {most:.4g}" for way, (least, most) in spans.items()
    )
    reason = (
        f"The variances of all differences add up to {value:.4g} by F, from {low:.4g} to "
        f"{high:.4g} within rounding. The printed pairs allow {allowed}, with pairs that are not "
        f"listed taken as not significant at {ALPHA}. "
    )
    if len(fits) == 2:
        reason += "The adjustment is not printed; these numbers leave it open."
    elif fits:
        reason += f"The adjustment is not printed; of the two only {fits[0]} is possible."
    else:
        reason = f"Suspicious: {reason}Neither is possible."
    span, used = (value, low, high), listing(formula.inputs(numbers), numbers)
    id, quantity = f"{name}/pairs/adjustment", f"{number.quantity}, against the pairwise p-values"
    return row_about(number, "not checkable", reason, span, formula.text, used, id, quantity)


def _printed_p(name: str, pair: tuple[str, str], numbers: Numbers) -> tuple[float, float]:
    """Return least and greatest p of a pair; those not listed were not significant."""
    for a, b in (pair, pair[::-1]):
        if f"{name}/significant.{a}-{b}" in numbers:
            return 0.0, ALPHA
        if f"{name}/pairs.{a}-{b}" in numbers:
            return numbers[f"{name}/pairs.{a}-{b}"].compatible
    return ALPHA, 1.0


def _distance(first: PrintedNumber, second: PrintedNumber) -> tuple[float, float]:
    """Return least and greatest difference of two printed numbers within their rounding."""
    apart, slack = abs(first.value - second.value), first.half + second.half
    return max(apart - slack, 0.0), apart + slack


def _sum_of_variances(name: str, numbers: Numbers, times: float) -> tuple[float, float]:
    """Return least and greatest sum of the differences' variances, for p multiplied by `times`."""
    n = numbers[f"{name}/n"].value
    least = most = 0.0

    def spread(p: float, difference: float) -> float:
        """SD of a difference from its p and mean."""
        return difference * np.sqrt(n) / stats.t.isf(min(p / times, 1.0) / 2.0, n - 1.0)

    for pair in combinations(conditions_of(name), 2):
        means, sds = ([numbers[f"{name}/{kind}.{c}"] for c in pair] for kind in ("mean", "sd"))
        least_apart, most_apart = _distance(*means)
        least_sd, _ = _distance(*sds)  # at a correlation of 1; the greatest is at −1
        most_sd = sum(sd.value + sd.half for sd in sds)
        low_p, high_p = _printed_p(name, pair, numbers)
        below = spread(low_p, least_apart) if low_p > 0.0 else 0.0
        above = spread(high_p, most_apart) if high_p < 1.0 else np.inf
        least += max(below, least_sd) ** 2
        most += min(above, most_sd) ** 2
    return least, most
