"""The audit of printed means and SDs: what scales, sample sizes and whole points leave possible."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction

import numpy as np

from trustlab.reproduction.audit_checks import Check, Formula, Numbers, Possible, Remark, Row, show
from trustlab.reproduction.audit_model_tables import PARTICIPANTS
from trustlab.reproduction.audit_numbers import PrintedNumber
from trustlab.reproduction.audit_studies import study_names

__all__ = ["attainable", "sample_checks", "simplest_ratio"]

LIKERT_1_5, SHARE, PERCENT = (1.0, 5.0), (0.0, 1.0), (0.0, 100.0)
UNBOUNDED = (0.0, math.inf)
SCALES = {
    "table_2.4/tlx": PERCENT,
    "table_2.4/satisfaction": LIKERT_1_5,
    "table_2.5/r": SHARE,
    "table_3.1/error": UNBOUNDED,
    "table_3.1/preference": LIKERT_1_5,
    "table_3.1/tlx": PERCENT,
    "uav.robot_performance": SHARE,
    "uav.utilization": SHARE,
    "uav.tlx": PERCENT,
    "uav.followed": PERCENT,
    "teleop.tracking_error": UNBOUNDED,
    "teleop.tlx": PERCENT,
}
"""Ends of the scales that the text gives or the measure has; those of the other questionnaires are not printed."""

TLX_RULES = {
    "raw, steps of 5": Fraction(6, 5),
    "weighted, steps of 5": Fraction(3),
    "raw, steps of 1": Fraction(6),
    "weighted, steps of 1": Fraction(15),
}
"""Whole points per respondent of a task load index: six scales, or fifteen weights, in steps of 5 or 1."""

TRUST_ITEMS, MOST_ITEMS = 12, 40


def attainable(number: PrintedNumber, units: Fraction) -> float:
    """
    Return the mean nearest to a printed one that whole points can have, NaN if none rounds to it.

    Parameters
    ----------
    number : PrintedNumber
        A printed mean.
    units : Fraction
        Whole points per unit of the scale: respondents × items for ratings in steps of 1.
    """
    least, most = number.compatible
    points = round(number.value * units)
    nearest = min(
        (Fraction(points + i) / units for i in (-1, 0, 1)), key=lambda x: abs(float(x) - number.value)
    )
    return float(nearest) if least <= float(nearest) <= most else math.nan


def simplest_ratio(number: PrintedNumber, most: int = 60) -> Fraction | None:
    """
    Return the percentage's simplest ratio of whole numbers, None if there is none.

    Parameters
    ----------
    number : PrintedNumber
        A printed percentage.
    most : int
        Greatest denominator to try.
    """
    least, top = number.compatible
    for denominator in range(1, most + 1):
        for ratio in {
            Fraction(math.floor(number.value * denominator / 100 + x), denominator) for x in (0, 1)
        }:
            if least <= 100 * ratio <= top:
                return ratio
    return None


def _measures(numbers: Numbers) -> dict[str, dict[str, str]]:
    """Return, per measure, condition to id of its mean."""
    found: dict[str, dict[str, str]] = {}
    for id in numbers:
        table, _, rest = id.partition("/")
        if table in ("table_2.4", "table_2.5", "table_3.1") and id.endswith("_mean"):
            condition, column = rest.split("/")
            found.setdefault(f"{table}/{column.removesuffix('_mean')}", {})[condition] = id
    for name in study_names(numbers):
        start = f"{name}/mean."
        found[name] = {id.removeprefix(start): id for id in numbers if id.startswith(start)}
    return found


def _size(measure: str) -> str:
    tables = {"table_2": "section_2_4_1_1/participants", "table_3": "section_3_8_2_1/participants"}
    return tables.get(measure.split(".")[0], f"{measure}/n")


def _sd(measure: str, mean: str) -> Possible | Remark:
    sd = mean.replace("_mean", "_sd").replace("/mean.", "/sd.")
    if measure not in SCALES:
        return Remark(sd, "Depends on scores that are not printed, on a scale that is not printed.")
    least, most = SCALES[measure]

    def greatest(v: dict) -> np.ndarray:
        if math.isinf(most):
            return v["M"] * np.sqrt(v["n"])
        return np.sqrt(np.maximum(v["n"] / (v["n"] - 1.0) * (v["M"] - least) * (most - v["M"]), 0.0))

    text = (
        "M √n, all but one score 0"
        if math.isinf(most)
        else f"√(n/(n − 1) (M − {least:g})({most:g} − M)), all scores at the ends of the scale"
    )
    return Possible(
        sd,
        Formula("0", {}, lambda v: np.array(0.0)),
        Formula(text, {"M": mean, "n": _size(measure)}, greatest),
    )


def _units(measure: str, condition: str, numbers: Numbers, per_person: Fraction) -> Fraction:
    """Return whole points per unit of the scale; Table 2.4 may rest on two sets of tests under C1."""
    sets = (
        numbers["section_2_4_1_3/sets"].value if measure.startswith("table_2.4") and condition == "C1" else 1
    )
    return Fraction(int(numbers[_size(measure)].value * sets)) * per_person


def _ratings(measure: str, ids: Mapping[str, str], numbers: Numbers) -> list:
    """Return, for a questionnaire, a remark per mean and one row on the number of items or rule of scoring."""
    kind = measure.replace("/", ".").split(".")[-1]
    if kind == "tlx":
        rules = {f"{name}": points for name, points in TLX_RULES.items()}
        wanted = []
    else:
        rules = {f"{items} items": Fraction(items) for items in range(1, MOST_ITEMS + 1)}
        wanted = (
            [f"{TRUST_ITEMS} items"]
            if kind == "trust"
            else ["3 items"]
            if measure == "table_2.4/satisfaction"
            else []
        )
    fits = {
        rule: [
            not math.isnan(attainable(numbers[id], _units(measure, c, numbers, points)))
            for c, id in ids.items()
        ]
        for rule, points in rules.items()
    }
    whole = [rule for rule, each in fits.items() if all(each)]
    first = whole[0] if whole else None
    remarks = []
    for i, (condition, id) in enumerate(ids.items()):
        reason = "Follows from answers that are not printed."
        if first:
            nearest = attainable(numbers[id], _units(measure, condition, numbers, rules[first]))
            reason += f" Whole points ({first}) can give {show(nearest, numbers[id], 2)}."
        missed = [rule for rule in wanted if not fits[rule][i]]
        if missed:
            reason += f" With {missed[0]} no whole points round to it."
        remarks.append(Remark(id, reason))
    return [*remarks, _Items(measure, ids, kind, whole, [rule for rule in wanted if not all(fits[rule])])]


class _Items:
    """Which numbers of items, or rules of scoring, all printed means of a questionnaire fit."""

    def __init__(self, measure: str, ids: Mapping[str, str], kind: str, whole: list[str], missed: list[str]):
        self.measure, self.ids, self.kind, self.whole, self.missed = measure, ids, kind, whole, missed

    def row(self, numbers: Numbers) -> Row:
        """Return the verdict, always "not checkable": the number of items is not printed."""
        anchor = numbers[next(iter(self.ids.values()))]
        items = self.kind != "tlx"
        reason = "The number of items is not printed." if items else "The rule of scoring is not printed."
        if self.whole:
            shown = [rule.removesuffix(" items") for rule in self.whole[:4]]
            reason += (
                f" All means are whole points for {', '.join(shown)} items."
                if items
                else (f" All means are whole points for: {'; '.join(shown)}.")
            )
        else:
            tried = f"up to {MOST_ITEMS} items" if items else "any of: " + "; ".join(TLX_RULES)
            reason += f" Not all means are whole points for {tried}."
        if self.missed:
            what = (
                "the checklist of [50] has as many"
                if self.kind == "trust"
                else "the text names three aspects"
            )
            reason = f"Suspicious: not {self.missed[0]} ({what}). {reason}"
        least = float(self.whole[0].split()[0]) if items and self.whole else math.nan
        return Row(
            f"{self.measure}/{'items' if items else 'scoring'}",
            anchor.where,
            f"{self.kind}: {'items' if items else 'scoring'} that all means fit",
            ", ".join(numbers[id].printed for id in self.ids.values()),
            least,
            math.nan,
            math.nan,
            "not checkable",
            reason,
            "mean × respondents × items is a whole number",
            "; ".join(f"{c} = {numbers[id].printed} ({id})" for c, id in self.ids.items())
            + f"; n = {numbers[_size(self.measure)].printed} ({_size(self.measure)})",
        )


def _performance(measure: str, condition: str, id: str, numbers: Numbers) -> Possible | Remark:
    """Return the range of a mean of Table 2.5 that the participants' own ranges leave."""
    name = measure.split("/")[-1]
    forced = ""
    if condition == "C3" and name in ("P_r", "r"):
        low, high = (
            np.mean(
                [
                    numbers[f"table_2.2/{name}{'_' if name == 'r' else ''}{end}/{p}"].value
                    for p in PARTICIPANTS
                ]
            )
            for end in ("l", "u")
        )
        forced = (
            f" The bounds of Table 2.2, which hold in steady state, are {low:.4f} and {high:.4f} on average."
        )
    if name == "r":
        return Remark(id, f"Measured; a share between 0 and 1.{forced}")
    ends = {
        end: {f"{name}_{end},{p}": f"table_2.1/{name}_{end}/{p}" for p in PARTICIPANTS}
        for end in ("min", "max")
    }
    least, most = (
        Formula(f"mean of {name}_{end} of Table 2.1", ends[end], lambda v: np.mean(list(v.values()), axis=0))
        for end in ("min", "max")
    )
    top = most.range(numbers)[0]
    odd = (
        f"Suspicious: it reaches the mean of the greatest values, {top:.4f}, as if every participant had been at their best "
        "throughout."
        if numbers[id].value >= top
        else ""
    )
    return Possible(id, least, most, note=odd or forced.strip())


def _followed(numbers: Numbers) -> list:
    checks = []
    for condition in ("C2", "C4"):
        ids = {f"x_{p}": f"table_2.6/{condition}/{p}" for p in PARTICIPANTS}
        checks += [
            Check(
                f"table_2.6/{condition}/mean",
                Formula("mean of the five", ids, lambda v: np.mean(list(v.values()), axis=0)),
            ),
            Check(
                f"table_2.6/{condition}/sd",
                Formula(
                    "SD of the five",
                    ids,
                    lambda v: np.std(list(v.values()), axis=0, ddof=1),
                    "divided by n − 1",
                ),
                (Formula("SD of the five", ids, lambda v: np.std(list(v.values()), axis=0), "divided by n"),),
            ),
        ]
        for id in ids.values():
            ratio = simplest_ratio(numbers[id])
            checks.append(
                Remark(
                    id,
                    "Counts of suggestions are not printed"
                    + (f"; simplest is {ratio.numerator} of {ratio.denominator}." if ratio else "."),
                )
            )
    return checks


def sample_checks(numbers: Numbers) -> list:
    """
    Return the checks of the means and SDs in Tables 2.4-2.6 and 3.1 and in the studies.

    Parameters
    ----------
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    """
    checks = _followed(numbers)
    for measure, ids in _measures(numbers).items():
        checks += [_sd(measure, id) for id in ids.values()]
        kind = measure.replace("/", ".").split(".")[-1]
        if measure.startswith("table_2.5"):
            checks += [_performance(measure, c, id, numbers) for c, id in ids.items()]
        elif kind in ("tlx", "trust", "satisfaction", "preference"):
            checks += _ratings(measure, ids, numbers)
        else:
            checks += [Remark(id, "Follows from recordings that are not printed.") for id in ids.values()]
    return checks
