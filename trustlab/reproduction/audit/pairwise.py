"""The audit of pairwise p-values: what means and SDs leave possible, and for which adjustment they go with F."""

from collections import Counter
from itertools import combinations

import numpy as np
from scipy import stats

from trustlab.reproduction.audit.catalogue import conditions_of
from trustlab.reproduction.audit.verdict import Finding, Formula, Numbers, Possible, Remark, Row, listing, row_about
from trustlab.reproduction.printed_number import PrintedNumber

ALPHA = 0.05


def means_and_sds(name: str, conditions: tuple[str, ...]) -> dict[str, str]:
    """Return symbol to id of the means and SDs of some conditions, and of n."""
    means = {f"M_{c}": f"{name}/mean.{c}" for c in conditions}
    return means | {f"SD_{c}": f"{name}/sd.{c}" for c in conditions} | {"n": f"{name}/n"}


def extreme_t(v: dict, a: str, b: str, correlation: int) -> np.ndarray:
    """Return the size of a paired t from means and SDs, at a correlation of 1 (the greatest) or −1 (the least)."""
    sd = np.abs(v[f"SD_{a}"] - correlation * v[f"SD_{b}"])
    return np.abs(v[f"M_{a}"] - v[f"M_{b}"]) * np.sqrt(v["n"]) / np.maximum(sd, 1e-12)


def _usual_bound(numbers: Numbers) -> str:
    """Return the bound that most pairwise p-values below one are printed with, "<.0005"."""
    bounds = Counter(x.printed for id, x in numbers.items() if "/pairs." in id and x.is_bound)
    return max(bounds, key=lambda text: bounds[text], default="")


def _pair(id: str, name: str, numbers: Numbers) -> Possible | Remark:
    """Return the range of one printed p: from correlation 1, unadjusted, to correlation −1, adjusted by Bonferroni."""
    a, b = id.removeprefix(f"{name}/pairs.").split("-")
    usual, odd = _usual_bound(numbers), ""
    if numbers[id].is_bound and numbers[id].printed != usual:
        odd = f"Suspicious: every other bound of its kind is printed {usual}; probably a zero is missing."
    if any(f"{name}/mean.{c}" not in numbers for c in (a, b)):
        return Remark(id, odd or "The mean and SD of one of the two conditions are not printed.")
    k = len(conditions_of(name))
    m = k * (k - 1) // 2
    inputs = means_and_sds(name, (a, b))

    def p_value(v: dict, correlation: int, times: float) -> np.ndarray:
        return np.minimum(times * 2.0 * stats.t.sf(extreme_t(v, a, b, correlation), v["n"] - 1.0), 1.0)

    least = Formula("p unadjusted at a correlation of 1", inputs, lambda v: p_value(v, 1, 1.0))
    most = Formula(f"{m} p (Bonferroni) at a correlation of −1", inputs, lambda v: p_value(v, -1, m))
    return Possible(id, least, most, odd)


def _adjustment(name: str, numbers: Numbers) -> Row:
    """
    Return for which adjustment of p the printed pairs can go with the printed F.

    The variances of all k(k − 1)/2 differences add up to k(k − 1) MS_error, and MS_error = MS_conditions/F. A printed p
    fixes the variance of its difference, p < .0005 bounds it from above, no significance from below. Šidák's and Holm's p
    lie between the unadjusted and Bonferroni's. Not checkable, as neither the adjustment nor every pair is printed.
    """
    conditions, number = conditions_of(name), numbers[f"{name}/anova.F"]
    k = len(conditions)
    inputs = {c: f"{name}/mean.{c}" for c in conditions} | {"F": number.id, "n": f"{name}/n"}

    def total(v: dict) -> np.ndarray:
        means = np.stack([v[c] for c in conditions])
        return k * (k - 1.0) * v["n"] * np.var(means, axis=0, ddof=1) / v["F"]

    formula = Formula("k(k − 1) MS_conditions/F", inputs, total)
    value, low, high = formula.range(numbers)
    times = {"unadjusted": 1.0, "Bonferroni": k * (k - 1) / 2}
    spans = {way: _sum_of_variances(name, numbers, m) for way, m in times.items()}
    fits = [way for way, (least, most) in spans.items() if least <= high and most >= low]
    allowed = "; ".join(f"{way}: from {least:.4g} to {most:.4g}" for way, (least, most) in spans.items())
    reason = (
        f"The variances of all differences add up to {value:.4g} by F, from {low:.4g} to {high:.4g} within rounding. The "
        f"printed pairs allow {allowed}, with pairs that are not listed taken as not significant at {ALPHA}. "
    )
    if len(fits) == 2:
        reason += "The adjustment is not printed; these numbers leave it open."
    elif fits:
        reason += f"The adjustment is not printed; of the two only {fits[0]} is possible."
    else:
        reason = f"Suspicious: {reason}Neither is possible."
    span, used = (value, low, high), listing(inputs, numbers)
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
    """Return least and greatest sum of the variances of all differences, where p-values were multiplied by `times`."""
    n = numbers[f"{name}/n"].value
    least = most = 0.0

    def spread(p: float, difference: float) -> float:
        """SD of a difference from its p and mean."""
        return difference * np.sqrt(n) / stats.t.isf(min(p / times, 1.0) / 2.0, n - 1.0)

    for pair in combinations(conditions_of(name), 2):
        means, sds = ([numbers[f"{name}/{what}.{c}"] for c in pair] for what in ("mean", "sd"))
        least_apart, most_apart = _distance(*means)
        least_sd, _ = _distance(*sds)  # at a correlation of 1; the greatest is at −1
        most_sd = sum(sd.value + sd.half for sd in sds)
        low_p, high_p = _printed_p(name, pair, numbers)
        below = spread(low_p, least_apart) if low_p > 0.0 else 0.0
        above = spread(high_p, most_apart) if high_p < 1.0 else np.inf
        least += max(below, least_sd) ** 2
        most += min(above, most_sd) ** 2
    return least, most


def pair_checks(name: str, numbers: Numbers) -> list[Finding]:
    """Return the checks of a study's pairwise p-values; the last is that of the adjustment, if all means are printed."""
    checks: list[Finding] = [_pair(id, name, numbers) for id in numbers if id.startswith(f"{name}/pairs.")]
    if all(f"{name}/mean.{c}" in numbers for c in conditions_of(name)):
        checks.append(_adjustment(name, numbers))
    return checks
