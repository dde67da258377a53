"""The audit of statements.csv: ranks, comparisons, counts, and numbers printed in two places."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal

import numpy as np

from trustlab.reproduction.audit_checks import Check, Formula, Numbers, Remark, Row
from trustlab.reproduction.audit_studies import study_names

__all__ = ["statement_checks"]


def _rank(number: str, who: str, ids: Mapping[str, str], highest: bool, numbers: Numbers) -> Check:
    """Return the check of a rank: 1 for the highest, or lowest, of the conditions."""

    def rank(v: dict) -> np.ndarray:
        sign = 1.0 if highest else -1.0
        return 1.0 + sum((sign * v[c] > sign * v[who]).astype(float) for c in ids if c != who)

    order = sorted(ids, key=lambda c: numbers[ids[c]].value, reverse=highest)
    return Check(
        number,
        Formula(f"rank of {who}, {'highest' if highest else 'lowest'} first", ids, rank),
        note="In order: " + ", ".join(f"{c} {numbers[ids[c]].printed}" for c in order) + ".",
    )


def _ranks(numbers: Numbers) -> list:
    schemes = ("M", "MI", "MMI", "TMIG", "TMIS")
    best = {"error": False, "tlx": False, "trust": True, "preference": True}
    checks = []
    for id in [id for id in numbers if id.startswith("section_3_8_3/")]:
        who, measure = id.split("/")[1].split("_", 1)
        ids = {c: f"table_3.1/{c}/{measure}_mean" for c in schemes}
        highest = best[measure] != (numbers[id].printed == "worst")
        checks.append(_rank(id, who, ids, highest, numbers))
    return checks


def _sides(number: str, ids: Mapping[str, str], above: tuple, below: tuple, sign: float) -> Check:
    """Return the check that all of `above` exceed all of `below`, or fall short of them at sign −1."""
    return Check(
        number,
        Formula(
            f"least of {sign:+.0f} × ({', '.join(above)} − {', '.join(below)})",
            ids,
            lambda v: np.minimum.reduce([sign * (v[a] - v[b]) for a in above for b in below]),
        ),
        target=(1e-12, np.inf),
    )


def _comparisons() -> list:
    start, tsc, rest = "section_2_4_1_3/", ("C2", "C3"), ("C1", "C4", "C5")
    subjective = {
        column: {c: f"table_2.4/{c}/{column}_mean" for c in tsc + rest}
        for column in ("trust", "satisfaction", "tlx")
    }
    objective = {
        column: {c: f"table_2.5/{c}/{column}_mean" for c in (*tsc, "C1")} for column in ("P_r", "P_h", "r")
    }
    return [
        _sides(start + "trust", subjective["trust"], tsc, rest, 1.0),
        _sides(start + "satisfaction", subjective["satisfaction"], tsc, rest, 1.0),
        _sides(start + "workload", subjective["tlx"], tsc, rest, -1.0),
        _sides(start + "robot_performance", objective["P_r"], tsc, ("C1",), 1.0),
        _sides(start + "human_performance", objective["P_h"], tsc, ("C1",), 1.0),
        _sides(start + "utilization", objective["r"], tsc, ("C1",), -1.0),
    ]


def _counts(numbers: Numbers) -> list:
    def total(number: str, parts: tuple[str, ...], text: str, compute) -> Check:
        return Check(number, Formula(text, dict(zip("abcd", parts, strict=False)), compute))

    def add(v: dict) -> np.ndarray:
        return sum(v.values())

    def analysed(chapter: str) -> Formula:
        ids = {
            name: f"{name}/anova.df1"
            for name in study_names(numbers)
            if name.startswith(chapter) and f"{name}/anova.df1" in numbers
        }
        return Formula("number of printed ANOVAs", ids, lambda v: np.array(float(len(v))))

    tested = [
        name for name in study_names(numbers) if name.startswith("uav") and f"{name}/t_test.t" in numbers
    ]
    checks = [
        total(
            "section_2_4_1_3/laps_in_all",
            ("section_2_4_1_3/sets", "section_2_4_1_3/laps"),
            "sets × laps",
            lambda v: v["a"] * v["b"],
        ),
        total(
            "section_3_8_2/variables",
            ("section_3_8_2/objective", "section_3_8_2/subjective"),
            "objective + subjective",
            add,
        ),
        Check(
            "section_2_4_2_4/anovas",
            analysed("uav"),
            note=f"The seventh, {', '.join(tested)}, has two conditions and was compared by a t-test.",
        ),
        Check("section_3_9_4/anovas", analysed("teleop")),
        Check(
            "section_2_4_1_2/variables",
            Formula(
                "number of printed measures of the UAV study, which has the same variables",
                {name: f"{name}/n" for name in study_names(numbers) if name.startswith("uav")},
                lambda v: np.array(float(len(v))),
            ),
        ),
        Check(
            "section_3_8_2/levels",
            Formula(
                "rows of Table 3.1",
                {c: f"table_3.1/{c}/error_mean" for c in ("M", "MI", "MMI", "TMIG", "TMIS")},
                lambda v: np.array(float(len(v))),
            ),
        ),
        Check(
            "section_3_9_1/levels",
            Formula("df1 + 1", {"df1": "teleop.tlx/anova.df1"}, lambda v: v["df1"] + 1.0),
        ),
    ]
    for section in ("section_2_4_2_2", "section_3_8_2_1", "section_3_9_2"):
        people = f"{section}/participants"
        checks.append(total(people, (f"{section}/female", f"{section}/male"), "female + male", add))
        checks += [Remark(f"{section}/{sex}", "A part of the participants.") for sex in ("female", "male")]
    for number, people, rows in (
        ("section_2_4_2_2/square", "section_2_4_2_2/participants", 10),
        ("section_3_9_3/square", "section_3_9_2/participants", 4),
    ):
        checks.append(
            Check(
                number,
                Formula(
                    f"participants modulo {rows}",
                    {"participants": people},
                    lambda v, rows=rows: v["participants"] % rows,
                ),
                target=(0.0, 0.0),
                note=f"A square balanced for order and carry-over has {rows} orders; those dropped break the balance.",
            )
        )
    return checks


@dataclass(frozen=True)
class _Restated:
    """Whether a number printed in a second place is the one of the first, or that one rounded."""

    number: str
    source: str
    where: str

    def row(self, numbers: Numbers) -> Row:
        """Return the verdict; "differs" where rounding half up and half to even both give another number."""
        number, source = numbers[self.number], numbers[self.source]
        here, there = Decimal(number.printed), Decimal(source.printed)
        unit = Decimal(1).scaleb(here.as_tuple().exponent)
        shorter = here.as_tuple().exponent >= there.as_tuple().exponent
        same = here == there or (
            shorter and here in (there.quantize(unit, rule) for rule in (ROUND_HALF_UP, ROUND_HALF_EVEN))
        )
        rounded = there.quantize(unit, ROUND_HALF_UP) if shorter else there
        why = (
            f"{source.printed} rounds to {rounded}"
            if rounded != there
            else "neither is the other one rounded"
        )
        reason = f"{self.where} has {source.printed}" + (
            "." if same else f", here {number.printed} is printed: one of the two is wrong, as {why}."
        )
        return Row(
            number.id,
            number.where,
            number.quantity,
            number.printed,
            float(there),
            float(there),
            float(there),
            "reproduced" if same else "differs",
            reason,
            "the same number in two places",
            f"{source.printed} ({source.id})",
        )


def _captions_and_appendix(numbers: Numbers) -> list:
    checks: list = [
        _Restated(f"figure_2_18/{name}", f"section_2_5/{name}", "The text of Section 2.5")
        for name in ("TSC_ld", "TSC_ud")
    ]
    for id in [id for id in numbers if id.startswith("appendix_a/state/")]:
        model = id.replace("/state/", "/model/")
        checks.append(_Restated(id, model, "The transfer function"))
        checks.append(Remark(model, "Identified from flights that are not printed."))
    most = {end: numbers[f"section_2_5/TSC_{end}d"].value for end in "lu"}
    ways = {end: abs(most[end] - numbers[f"section_2_5/TSC_{end}_0"].value) for end in "lu"}
    rate = numbers["section_2_5/c_b"].value
    checks.append(
        Remark(
            "section_2_5/c_b",
            f"Chosen by the author. The printed change of thresholds takes at least {60.0 * max(ways.values()) / rate:.1f} min at "
            "this rate; the length of the tests is not printed.",
        )
    )
    return checks


def statement_checks(numbers: Numbers) -> list:
    """
    Return the checks of statements.csv but those of the models and of sphericity.

    Parameters
    ----------
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    """
    return [*_ranks(numbers), *_comparisons(), *_counts(numbers), *_captions_and_appendix(numbers)]
