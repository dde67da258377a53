"""The audit of statements.csv: ranks, comparisons, counts, and numbers printed in two places."""

from collections.abc import Mapping
from decimal import ROUND_HALF_UP, Decimal

import numpy as np

from trustlab.reproduction.audit.catalogue import study_names
from trustlab.reproduction.audit.verdict import Check, Finding, Formula, Numbers, Remark, Row, row_about
from trustlab.reproduction.printed_number import ROUNDINGS, last_unit

SCHEMES = ("M", "MI", "MMI", "TMIG", "TMIS")
HIGHER_IS_BETTER = {"error": False, "tlx": False, "trust": True, "preference": True}
# Latin squares balanced for order and carry-over: id, id of the participants, number of orders.
SQUARES = (
    ("section_2_4_2_2/square", "section_2_4_2_2/participants", 10),
    ("section_3_9_3/square", "section_3_9_2/participants", 4),
)


def _rank(number: str, numbers: Numbers) -> Check:
    """Return the check of a rank in Table 3.1: 1 for the best, or for the worst where "worst" is printed."""
    who, measure = number.split("/")[1].split("_", 1)
    ids = {scheme: f"table_3.1/{scheme}/{measure}_mean" for scheme in SCHEMES}
    highest = HIGHER_IS_BETTER[measure] != (numbers[number].printed == "worst")
    sign = 1.0 if highest else -1.0

    def rank(v: dict) -> np.ndarray:
        return 1.0 + sum((sign * v[c] > sign * v[who]).astype(float) for c in ids if c != who)

    order = sorted(ids, key=lambda c: numbers[ids[c]].value, reverse=highest)
    return Check(
        number,
        Formula(f"rank of {who}, {'highest' if highest else 'lowest'} first", ids, rank),
        note="In order: " + ", ".join(f"{c} {numbers[ids[c]].printed}" for c in order) + ".",
    )


def _comparison(statement: str, mean: str, rest: tuple[str, ...], sign: float) -> Check:
    """Return the check that both conditions with TSC exceed all of the rest, or fall short of them at sign −1."""
    tsc = ("C2", "C3")
    gap = Formula(
        f"least of {sign:+.0f} × ({', '.join(tsc)} − {', '.join(rest)})",
        {c: mean.format(c) for c in tsc + rest},
        lambda v: np.minimum.reduce([sign * (v[a] - v[b]) for a in tsc for b in rest]),
    )
    return Check(f"section_2_4_1_3/{statement}", gap, target=(1e-12, np.inf))


def _comparisons() -> list[Check]:
    others, manual = ("C1", "C4", "C5"), ("C1",)
    return [
        _comparison("trust", "table_2.4/{}/trust_mean", others, 1.0),
        _comparison("satisfaction", "table_2.4/{}/satisfaction_mean", others, 1.0),
        _comparison("workload", "table_2.4/{}/tlx_mean", others, -1.0),
        _comparison("robot_performance", "table_2.5/{}/P_r_mean", manual, 1.0),
        _comparison("human_performance", "table_2.5/{}/P_h_mean", manual, 1.0),
        _comparison("utilization", "table_2.5/{}/r_mean", manual, -1.0),
    ]


def _combined(number: str, first: str, sign: str, second: str) -> Check:
    """Return the check of a sum or product of two numbers of one section."""
    section, _, _ = number.partition("/")
    ids = {"a": f"{section}/{first}", "b": f"{section}/{second}"}
    text = f"{first} {sign.replace('*', '×')} {second}"
    return Check(number, Formula.of(f"a {sign} b", ids, text=text))


def _number_of(text: str, ids: Mapping[str, str]) -> Formula:
    """Return a formula that counts its inputs."""
    return Formula(text, ids, lambda v: np.array(float(len(v))))


def _anovas(chapter: str, numbers: Numbers) -> Formula:
    ids = {name: f"{name}/anova.df1" for name in study_names(numbers) if name.startswith(chapter)}
    return _number_of("number of printed ANOVAs", {name: id for name, id in ids.items() if id in numbers})


def _counts(numbers: Numbers) -> list[Check]:
    """Return the checks of counts of laps, variables, analyses and levels."""
    uav = [name for name in study_names(numbers) if name.startswith("uav")]
    tested = [name for name in uav if f"{name}/t_test.t" in numbers]
    same = "number of printed measures of the UAV study, which has the same variables"
    rows = {scheme: f"table_3.1/{scheme}/error_mean" for scheme in SCHEMES}
    return [
        _combined("section_2_4_1_3/laps_in_all", "sets", "*", "laps"),
        _combined("section_3_8_2/variables", "objective", "+", "subjective"),
        Check(
            "section_2_4_2_4/anovas",
            _anovas("uav", numbers),
            note=f"The seventh, {', '.join(tested)}, has two conditions and was compared by a t-test.",
        ),
        Check("section_3_9_4/anovas", _anovas("teleop", numbers)),
        Check("section_2_4_1_2/variables", _number_of(same, {name: f"{name}/n" for name in uav})),
        Check("section_3_8_2/levels", _number_of("rows of Table 3.1", rows)),
        Check("section_3_9_1/levels", Formula.of("df1 + 1", {"df1": "teleop.tlx/anova.df1"})),
    ]


def _participants() -> list[Check]:
    """Return the checks of numbers of participants, by sex and in Latin squares."""
    checks = [
        _combined(f"{section}/participants", "female", "+", "male")
        for section in ("section_2_4_2_2", "section_3_8_2_1", "section_3_9_2")
    ]
    for number, people, orders in SQUARES:
        left = Formula.of(f"participants % {orders}", {"participants": people})
        note = f"A square balanced for order and carry-over has {orders} orders; those dropped break the balance."
        checks.append(Check(number, left, target=(0.0, 0.0), note=note))
    return checks


def _restated(id: str, first: str, where: str, numbers: Numbers) -> Row:
    """Return whether a number printed in a second place is the one of the first, or that one rounded."""
    number, source = numbers[id], numbers[first]
    here, there = Decimal(number.printed), Decimal(source.printed)
    same = here in (there.quantize(last_unit(here), rule) for rule in ROUNDINGS)
    reason = f"{where} has {source.printed}."
    if not same:
        rounded = there.quantize(last_unit(here), ROUND_HALF_UP)
        neither = "neither is the other one rounded"
        why = f"{source.printed} rounds to {rounded}" if rounded != there else neither
        reason = f"{reason[:-1]}, here {number.printed} is printed: one of the two is wrong, as {why}."
    verdict, value = "reproduced" if same else "differs", float(there)
    source_text = f"{source.printed} ({source.id})"
    return row_about(number, verdict, reason, (value,) * 3, "the same number in two places", source_text)


def _captions_and_appendix(numbers: Numbers) -> list[Finding]:
    """Return the rows of numbers that are printed twice, and the remark on the rate of correction."""
    captions = [id for id in numbers if id.startswith("figure_2_18/")]
    states = [id for id in numbers if id.startswith("appendix_a/state/")]
    section = "section_2_5/TSC_{}".format
    changes = [abs(numbers[section(f"{end}d")].value - numbers[section(f"{end}_0")].value) for end in "lu"]
    minutes = 60.0 * max(changes) / numbers["section_2_5/c_b"].value
    chosen = (
        f"Chosen by the author. The printed change of thresholds takes at least {minutes:.1f} min at "
        "this rate; the length of the tests is not printed."
    )
    text = "The text of Section 2.5"
    return [
        *(_restated(id, id.replace("figure_2_18", "section_2_5"), text, numbers) for id in captions),
        *(_restated(id, id.replace("state", "model"), "The transfer function", numbers) for id in states),
        Remark("section_2_5/c_b", chosen),
    ]


def statement_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of statements.csv but those of the models and of sphericity."""
    ranks = [_rank(id, numbers) for id in numbers if id.startswith("section_3_8_3/")]
    return [*ranks, *_comparisons(), *_counts(numbers), *_participants(), *_captions_and_appendix(numbers)]
