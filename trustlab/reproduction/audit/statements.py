"""The audit of ranks, percentages and differences, and of numbers printed in two places."""

from dataclasses import replace
from decimal import ROUND_HALF_UP, Decimal
from typing import Any

import numpy as np

from trustlab.reproduction.audit.catalogue import claims
from trustlab.reproduction.audit.check import Check, Finding, Formula, Numbers, Row, row_about
from trustlab.reproduction.audit.relations import CHANGE, change
from trustlab.reproduction.printed_number import ROUNDINGS, last_unit

SCHEMES = ("M", "MI", "MMI", "TMIG", "TMIS")
HIGHER_IS_BETTER = {"error": False, "tlx": False, "trust": True, "preference": True}


def _rank(number: str, numbers: Numbers) -> Check:
    """Return the check of a rank in Table 3.1: 1 is the best, or the worst where that is said."""
    scheme, measure = number.split("/")[1].split("_", 1)
    ids = {f"x_{name}": f"table_3.1/{name}/{measure}_mean" for name in SCHEMES}
    highest = HIGHER_IS_BETTER[measure] != (numbers[number].printed == "worst")
    sign = 1 if highest else -1
    order = sorted(SCHEMES, key=lambda c: numbers[ids[f"x_{c}"]].value, reverse=highest)
    means = ", ".join(f"{c} {numbers[ids[f'x_{c}']].printed}" for c in order)
    text = f"rank of {scheme}, {'highest' if highest else 'lowest'} first"

    def rank(v: Any) -> np.ndarray:
        this = getattr(v, f"x_{scheme}")
        return 1.0 + (sign * v.x > sign * this).sum(axis=0)

    return Check(number, Formula(text, rank, ids), note=f"In order: {means}.")


def _restated(id: str, first: str, where: str, numbers: Numbers) -> Row:
    """
    Return whether a number printed in a second place is the one of the first, or that one rounded.
    """
    number, source = numbers[id], numbers[first]
    here, there = Decimal(number.printed), Decimal(source.printed)
    same = here in (there.quantize(last_unit(here), rule) for rule in ROUNDINGS)
    reason = f"{where} has {source.printed}."
    if not same:
        rounded = there.quantize(last_unit(here), ROUND_HALF_UP)
        neither = "neither is the other one rounded"
        why = f"{source.printed} rounds to {rounded}" if rounded != there else neither
        reason = (
            f"{reason[:-1]}, here {number.printed} is printed: one of the two is wrong, as {why}."
        )
    verdict, value = "reproduced" if same else "differs", float(there)
    source_text = f"{source.printed} ({source.id})"
    return row_about(
        number, verdict, reason, (value,) * 3, "the same number in two places", source_text
    )


def statement_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of ranks, and of numbers that are printed twice."""
    ranks = [_rank(id, numbers) for id in numbers if id.startswith("section_3_8_3/")]
    captions = [id for id in numbers if id.startswith("figure_2_18/")]
    states = [id for id in numbers if id.startswith("appendix_a/state/")]
    text = "The text of Section 2.5"
    return [
        *ranks,
        *(
            _restated(id, id.replace("figure_2_18", "section_2_5"), text, numbers)
            for id in captions
        ),
        *(
            _restated(id, id.replace("state", "model"), "The transfer function", numbers)
            for id in states
        ),
    ]


def _relative(after: str, before: str) -> Formula:
    """Return the magnitude of a change relative to `before`, in %."""
    return Formula(CHANGE, change, {"after": after, "before": before}, "relative change")


def _by_range(number: str, after: str, before: str) -> Check:
    """Return the check of a difference in % of the range of P_r, or relative to the first."""
    ids = {
        "after": after,
        "before": before,
        "P_r_min": "remark_7/P_r_min",
        "P_r_max": "remark_7/P_r_max",
    }
    difference = Formula(
        "100 (after − before)/(P_r_max − P_r_min)",
        lambda v: 100 * (v.after - v.before) / (v.P_r_max - v.P_r_min),
        ids,
        "difference of two values of (2.39)",
    )
    relative = Formula(
        "100 (after − before)/(before − P_r_min)",
        lambda v: 100 * (v.after - v.before) / (v.before - v.P_r_min),
        ids,
        "relative change of (2.39)",
    )
    return Check(number, difference, (relative,))


def _in_points(number: str, after: str, before: str, scale: float, numbers: Numbers) -> Check:
    """Return the check of a difference times `scale`, 100 for shares, or of a relative change."""
    relative = _relative(after, before)
    label = (
        "difference in units of the measure, printed as %" if scale == 1.0 else "percentage points"
    )
    text = "|after − before|" if scale == 1.0 else f"{scale:g} |after − before|"
    points = Formula(text, lambda v: scale * abs(v.after - v.before), relative.ids, label)
    would, _, _ = relative.range(numbers)
    note = f"Printed with a % sign, which reads as a relative change; that would be {would:.1f} %."
    return Check(number, points, (relative,), note=note)


def _as_change(number: str, after: str, before: str, numbers: Numbers) -> Check:
    """
    Return the check of a relative change; a mean of two decimals may have been used with three.
    """
    relative, mean = _relative(after, before), numbers[after]
    finer = [mean.value + k / 1000 for k in (-1, 1, -2, 2, -3, 3, -4, 4) if mean.decimals == 2]
    condition = after.partition("/")[2].removeprefix("mean.")

    def with_mean(value: float) -> Formula:
        label = f"the mean of {condition} was {value:.3f}, printed as {mean.printed}"
        return replace(relative, label=label, changed={"after": value})

    return Check(number, relative, explanations=tuple(map(with_mean, finer)))


def _claim(number: str, reading: str, after: str, before: str, numbers: Numbers) -> Check:
    """Return the check of a claim by its reading."""
    if reading == "range":
        return _by_range(number, after, before)
    if reading == "relative":
        return _as_change(number, after, before, numbers)
    return _in_points(number, after, before, 100.0 if reading == "share" else 1.0, numbers)


def claim_checks(numbers: Numbers) -> list[Check]:
    """Return the checks of the printed percentages and differences."""
    read = [
        _claim(number.id, reading, after, before, numbers)
        for number, reading, after, before in claims()
        if reading
    ]
    mean = "teleop.tlx/mean.{}".format
    again = _in_points("section_3_1/workload", mean("TMIG"), mean("MMI"), 1.0, numbers)
    return [*read, again]
