"""The audit of pairwise p-values: what means and SDs leave possible, and for which adjustment they go with F."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import stats

from trustlab.reproduction.audit_checks import Formula, Numbers, Possible, Remark, Row
from trustlab.reproduction.audit_numbers import CONDITIONS

__all__ = ["pair_checks"]

ALPHA = 0.05


def _each(name: str, numbers: Numbers, k: int) -> list:
    start, checks = f"{name}/pairs.", []
    m = k * (k - 1) // 2
    below = Counter(x.printed for id, x in numbers.items() if "/pairs." in id and x.printed.startswith("<"))
    usual = below.most_common(1)[0][0] if below else ""
    for id in [id for id in numbers if id.startswith(start)]:
        a, b = id.removeprefix(start).split("-")
        odd = (
            f"Suspicious: every other bound of its kind is printed {usual}; probably a zero is missing."
            if numbers[id].printed.startswith("<") and numbers[id].printed != usual
            else ""
        )
        if any(f"{name}/mean.{c}" not in numbers for c in (a, b)):
            checks.append(Remark(id, odd or "The mean and SD of one of the two conditions are not printed."))
            continue
        inputs = {f"M_{c}": f"{name}/mean.{c}" for c in (a, b)} | {
            f"SD_{c}": f"{name}/sd.{c}" for c in (a, b)
        }
        inputs["n"] = f"{name}/n"

        def p_value(v: dict, sign: float, times: float, a=a, b=b) -> np.ndarray:
            sd = np.abs(v[f"SD_{a}"] + sign * v[f"SD_{b}"])
            t = np.abs(v[f"M_{a}"] - v[f"M_{b}"]) * np.sqrt(v["n"]) / np.maximum(sd, 1e-12)
            return np.minimum(times * 2.0 * stats.t.sf(t, v["n"] - 1.0), 1.0)

        checks.append(
            Possible(
                id,
                Formula("p unadjusted at a correlation of 1", inputs, lambda v, f=p_value: f(v, -1.0, 1.0)),
                Formula(
                    f"{m} p (Bonferroni) at a correlation of −1", inputs, lambda v, f=p_value: f(v, 1.0, m)
                ),
                note=odd,
            )
        )
    return checks


@dataclass(frozen=True)
class _Adjustment:
    """
    For which adjustment of p the printed pairs can go with the printed F.

    The variances of all k(k − 1)/2 differences add up to k(k − 1) MS_error, and MS_error = MS_conditions/F. A printed p
    fixes the variance of its difference, p < .0005 bounds it from above, no significance from below. Šidák's and Holm's p
    lie between the unadjusted and Bonferroni's.
    """

    name: str
    k: int

    def row(self, numbers: Numbers) -> Row:
        """Return the verdict, always "not checkable", as neither the adjustment nor every pair is printed."""
        conditions, number = CONDITIONS[self.name.split(".")[0]], numbers[f"{self.name}/anova.F"]
        inputs = {c: f"{self.name}/mean.{c}" for c in conditions} | {"F": number.id, "n": f"{self.name}/n"}
        total = Formula(
            "k(k − 1) MS_conditions/F",
            inputs,
            lambda v: (
                self.k
                * (self.k - 1.0)
                * v["n"]
                * np.var(np.stack([v[c] for c in conditions]), axis=0, ddof=1)
                / v["F"]
            ),
        )
        value, low, high = total.range(numbers)
        times = {"unadjusted": 1.0, "Bonferroni": self.k * (self.k - 1) / 2}
        spans = {way: self._span(numbers, conditions, m) for way, m in times.items()}
        fits = [way for way, (least, most) in spans.items() if least <= high and most >= low]
        told = "; ".join(f"{way}: from {least:.4g} to {most:.4g}" for way, (least, most) in spans.items())
        reason = (
            f"The variances of all differences add up to {value:.4g} by F, from {low:.4g} to {high:.4g} within rounding. The "
            f"printed pairs allow {told}, with pairs that are not listed taken as not significant at {ALPHA}. "
        )
        if len(fits) == 2:
            reason += "The adjustment is not printed; these numbers leave it open."
        elif fits:
            reason += f"The adjustment is not printed; of the two only {fits[0]} is possible."
        else:
            reason = f"Suspicious: {reason}Neither is possible."
        return Row(
            f"{self.name}/pairs/adjustment",
            number.where,
            f"{number.quantity}, against the pairwise p-values",
            number.printed,
            value,
            low,
            high,
            "not checkable",
            reason,
            total.text,
            total.listing(numbers),
        )

    def _span(self, numbers: Numbers, conditions: tuple[str, ...], times: float) -> tuple[float, float]:
        """Return least and greatest sum of the variances of all differences."""
        n = numbers[f"{self.name}/n"].value
        least = most = 0.0
        for a, b in combinations(conditions, 2):
            means, sds = ([numbers[f"{self.name}/{what}.{c}"] for c in (a, b)] for what in ("mean", "sd"))
            apart = abs(means[0].value - means[1].value)
            slack, loose = (x[0].half + x[1].half for x in (means, sds))
            listed = numbers.get(f"{self.name}/pairs.{a}-{b}") or numbers.get(f"{self.name}/pairs.{b}-{a}")
            low_p, high_p = listed.compatible if listed else (ALPHA, 1.0)
            if any(f"{self.name}/significant.{pair}" in numbers for pair in (f"{a}-{b}", f"{b}-{a}")):
                low_p, high_p = 0.0, ALPHA

            def spread(p: float, difference: float) -> float:
                return difference * np.sqrt(n) / stats.t.isf(min(p / times, 1.0) / 2.0, n - 1.0)

            below = spread(low_p, max(apart - slack, 0.0)) if low_p > 0.0 else 0.0
            above = spread(high_p, apart + slack) if high_p < 1.0 else np.inf
            least += max(below, abs(sds[0].value - sds[1].value) - loose, 0.0) ** 2
            most += min(above, sds[0].value + sds[1].value + loose) ** 2
        return least, most


def pair_checks(name: str, numbers: Numbers, k: int) -> list:
    """
    Return the checks of a study's pairwise p-values.

    Parameters
    ----------
    name : str
        The study, for example "uav.tlx".
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    k : int
        Conditions.
    """
    checks = _each(name, numbers, k)
    silent = [id for id in numbers if id.startswith(f"{name}/significant.")]
    checks += [Remark(id, "No p-value is printed.") for id in silent]
    conditions = CONDITIONS[name.split(".")[0]]
    if all(f"{name}/mean.{c}" in numbers for c in conditions):
        checks.append(_Adjustment(name, k))
    return checks
