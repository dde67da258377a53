"""The audit of printed means and SDs: what scales, sample sizes and whole points leave possible."""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from trustlab.reproduction.audit.catalogue import PARTICIPANTS, study_names
from trustlab.reproduction.audit.check import (
    Finding,
    Formula,
    Numbers,
    Possible,
    Remark,
    Row,
    listing,
    row_about,
    show,
)
from trustlab.reproduction.printed_number import PrintedNumber
from trustlab.reproduction.published import published_facts

MEASURES = published_facts("measures")
TLX_RULES = {rule: Fraction(points) for rule, points in MEASURES["tlx_rules"].items()}
MOST_ITEMS = 40


def attainable(number: PrintedNumber, units: Fraction) -> float:
    """
    Return the mean nearest to a printed one that whole points can have (the GRIM test).

    NaN if none rounds to it.

    `units` are whole points per unit of the scale: respondents × items for ratings in steps of 1.
    """
    least, most = number.compatible
    points = round(number.value * units)
    means = [Fraction(points + i) / units for i in (-1, 0, 1)]
    nearest = float(min(means, key=lambda x: abs(float(x) - number.value)))
    return nearest if least <= nearest <= most else math.nan


def simplest_ratio(number: PrintedNumber, most: int = 60) -> Fraction | None:
    """Return a percentage's simplest ratio with a denominator up to `most`, or None."""
    least, top = number.compatible
    for denominator in range(1, most + 1):
        below = math.floor(number.value * denominator / 100)
        for ratio in (Fraction(below, denominator), Fraction(below + 1, denominator)):
            if least <= 100 * ratio <= top:
                return ratio
    return None


def _measures(numbers: Numbers) -> dict[str, dict[str, str]]:
    """Return, per measure, condition to id of its mean."""
    measures: dict[str, dict[str, str]] = {}
    for id in numbers:
        table, _, rest = id.partition("/")
        if table in ("table_2.4", "table_2.5", "table_3.1") and id.endswith("_mean"):
            condition, column = rest.split("/")
            measures.setdefault(f"{table}/{column.removesuffix('_mean')}", {})[condition] = id
    for name in study_names(numbers):
        start = f"{name}/mean."
        measures[name] = {id.removeprefix(start): id for id in numbers if id.startswith(start)}
    return measures


def _size(measure: str) -> str:
    """Return the id of the number of respondents."""
    tables = {"table_2": "section_2_4_1_1/participants", "table_3": "section_3_8_2_1/participants"}
    return tables.get(measure.split(".")[0], f"{measure}/n")


def _kind(measure: str) -> str:
    """Return what is measured: "tlx" of "uav.tlx" and of "table_2.4/tlx"."""
    return measure.replace("/", ".").split(".")[-1]


def _sd(measure: str, mean: str) -> Possible | Remark:
    """Return the range of an SD that the mean and the ends of the scale leave."""
    sd = mean.replace("_mean", "_sd").replace("/mean.", "/sd.")
    if measure not in MEASURES["scales"]:
        return Remark(sd, "Depends on scores that are not printed, on a scale that is not printed.")
    least, most = MEASURES["scales"][measure]
    inputs = {"M": mean, "n": _size(measure)}

    text = f"√(n/(n − 1) (M − {least:g})({most:g} − M)), all scores at the ends of the scale"

    def at_the_ends(v: Any) -> np.ndarray:
        variance = v.n / (v.n - 1.0) * (v.M - least) * (most - v.M)
        return np.sqrt(np.maximum(variance, 0.0))

    greatest = Formula(text, at_the_ends, inputs)
    if math.isinf(most):
        greatest = Formula("M √n, all but one score 0", lambda v: v.M * np.sqrt(v.n), inputs)
    return Possible(sd, Formula("0", lambda v: 0), greatest)


def _units(measure: str, condition: str, numbers: Numbers, per_person: Fraction) -> Fraction:
    """
    Return whole points per unit of the scale; Table 2.4 may rest on two sets of tests under C1.
    """
    twice = measure.startswith("table_2.4") and condition == "C1"
    sets = numbers["section_2_4_1_3/sets"].value if twice else 1
    return Fraction(int(numbers[_size(measure)].value * sets)) * per_person


def _expected_items(measure: str) -> tuple[str, str] | None:
    """
    Return how many items a questionnaire should have, and who says so; None where nothing is known.
    """
    expected = MEASURES["expected_items"]
    return expected.get(measure) or expected.get(_kind(measure))


def _ratings(measure: str, ids: Mapping[str, str], numbers: Numbers) -> list[Remark | Row]:
    """Return a questionnaire's remarks, one per mean, and a row on its items or its scoring."""
    rules = TLX_RULES
    if _kind(measure) != "tlx":
        rules = {f"{items} items": Fraction(items) for items in range(1, MOST_ITEMS + 1)}

    def nearest(condition: str, rule: str) -> float:
        units = _units(measure, condition, numbers, rules[rule])
        return attainable(numbers[ids[condition]], units)

    fitting = [rule for rule in rules if not any(math.isnan(nearest(c, rule)) for c in ids)]
    expected = _expected_items(measure)
    remarks = []
    for condition, id in ids.items():
        reason = "Follows from answers that are not printed."
        if fitting:
            mean = nearest(condition, fitting[0])
            reason += f" Whole points ({fitting[0]}) can give {show(mean, numbers[id], 2)}."
        if expected and math.isnan(nearest(condition, expected[0])):
            reason += f" With {expected[0]} no whole points round to it."
        if rules is TLX_RULES and all(math.isnan(nearest(condition, rule)) for rule in rules):
            n = numbers[_size(measure)].printed
            reason = (
                f"Suspicious: for n = {n} no whole points give it, raw or weighted (GRIM). {reason}"
            )
        remarks.append(Remark(id, reason))
    return [*remarks, _items(measure, ids, fitting, numbers)]


def _items(measure: str, ids: Mapping[str, str], fitting: list[str], numbers: Numbers) -> Row:
    """
    Return which numbers of items, or rules of scoring, all means fit.

    Not checkable, as neither is printed.
    """
    kind = _kind(measure)
    fewest = math.nan
    first = next(iter(ids.values()))
    if kind == "tlx":
        word, unknown = "scoring", "The rule of scoring is not printed."
        fit, tried = ": " + "; ".join(fitting[:4]), "any of: " + "; ".join(TLX_RULES)
    else:
        word, unknown = "items", "The number of items is not printed."
        counts = [rule.removesuffix(" items") for rule in fitting]
        fit, tried = f" {', '.join(counts[:4])} items", f"up to {MOST_ITEMS} items"
        fewest = float(counts[0]) if counts else math.nan
    fits = (
        f"All means are whole points for{fit}"
        if fitting
        else f"Not all means are whole points for {tried}"
    )
    reason, expected = f"{unknown} {fits}.", _expected_items(measure)
    if expected and expected[0] not in fitting:
        reason = f"Suspicious: not {expected[0]} ({expected[1]}). {reason}"
    formula = "mean × respondents × items is a whole number"
    inputs = listing({**ids, "n": _size(measure)}, numbers)
    id, quantity = f"{measure}/{word}", f"{kind}: {word} that all means fit"
    printed = ", ".join(numbers[id].printed for id in ids.values())
    span = (fewest, math.nan, math.nan)
    return row_about(
        numbers[first], "not checkable", reason, span, formula, inputs, id, quantity, printed
    )


def _performance(measure: str, condition: str, id: str, numbers: Numbers) -> Possible | Remark:
    """Return the range of a mean of Table 2.5 that the participants' own ranges leave."""
    name, forced = _kind(measure), ""
    if condition == "C3" and name in ("P_r", "r"):
        symbol = "r_" if name == "r" else "P_r"
        low, high = (
            np.mean([numbers[f"table_2.2/{symbol}{end}/{p}"].value for p in PARTICIPANTS])
            for end in "lu"
        )
        forced = (
            f"The bounds of Table 2.2, which hold in steady state, are {low:.4f} and "
            f"{high:.4f} on average."
        )
    if name == "r":
        return Remark(id, f"Measured; a share between 0 and 1. {forced}")

    def mean_of(end: str) -> Formula:
        ids = {f"x_{p}": f"table_2.1/{name}_{end}/{p}" for p in PARTICIPANTS}
        return Formula(f"mean of {name}_{end} of Table 2.1", lambda v: v.x.mean(axis=0), ids)

    top, _, _ = mean_of("max").range(numbers)
    if numbers[id].value >= top:
        forced = (
            f"Suspicious: it reaches the mean of the greatest values, {top:.4f}, as if every "
            "participant had been at their best throughout."
        )
    return Possible(id, mean_of("min"), mean_of("max"), forced)


def _followed(condition: str, numbers: Numbers) -> list[Remark]:
    """Return remarks on the shares of Table 2.6: the simplest counts that give them."""
    remarks = []
    for p in PARTICIPANTS:
        id = f"table_2.6/{condition}/{p}"
        ratio = simplest_ratio(numbers[id])
        simplest = f"; simplest is {ratio.numerator} of {ratio.denominator}" if ratio else ""
        remarks.append(Remark(id, f"Counts of suggestions are not printed{simplest}."))
    return remarks


def sample_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of the means and SDs in Tables 2.4-2.6 and 3.1 and in the studies."""
    checks: list[Finding] = [*_followed("C2", numbers), *_followed("C4", numbers)]
    for measure, ids in _measures(numbers).items():
        checks += [_sd(measure, id) for id in ids.values()]
        if measure.startswith("table_2.5"):
            checks += [_performance(measure, c, id, numbers) for c, id in ids.items()]
        elif _kind(measure) in ("tlx", "trust", "satisfaction", "preference"):
            checks += _ratings(measure, ids, numbers)
    return checks
