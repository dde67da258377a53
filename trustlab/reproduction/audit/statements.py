"""
The audit of statements.csv and relations.toml: ranks, comparisons, counts, settings, numbers
printed in two places.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from decimal import ROUND_HALF_UP, Decimal

import numpy as np

from trustlab.reproduction.audit.catalogue import claims, study_names
from trustlab.reproduction.audit.verdict import (
    Check,
    Finding,
    Formula,
    Numbers,
    Remark,
    Row,
    row_about,
)
from trustlab.reproduction.printed_number import ROUNDINGS, last_unit
from trustlab.reproduction.published import published_folder

SCHEMES = ("M", "MI", "MMI", "TMIG", "TMIS")
HIGHER_IS_BETTER = {"error": False, "tlx": False, "trust": True, "preference": True}

# Who says how far answers of a study went: both studies have the questionnaire of the one before.
SCALES = {"uav.satisfaction": "section_2_4_1_3/scale", "teleop.satisfaction": "section_3_8_2/scale"}


def _rank(number: str, numbers: Numbers) -> Check:
    """
    Return the check of a rank in Table 3.1: 1 for the best, or for the worst where "worst" is
    printed.
    """
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


def _comparison(number: str, measure: str, sign: float, tsc: list[str], rest: list[str]) -> Check:
    """
    Return the check that the conditions with TSC exceed all of the rest, or fall short of them at
    sign −1.
    """
    gap = Formula(
        f"least of {sign:+.0f} × ({', '.join(tsc)} − {', '.join(rest)})",
        {c: measure.format(c) for c in tsc + rest},
        lambda v: np.minimum.reduce([sign * (v[a] - v[b]) for a in tsc for b in rest]),
    )
    return Check(number, gap, target=(1e-12, np.inf))


def _number_of(text: str, ids: Mapping[str, str]) -> Formula:
    """Return a formula that counts its inputs."""
    return Formula(text, ids, lambda v: np.array(float(len(v))))


def _anovas(chapter: str, numbers: Numbers) -> Formula:
    ids = {name: f"{name}/anova.df1" for name in study_names(numbers) if name.startswith(chapter)}
    return _number_of(
        "number of printed ANOVAs", {name: id for name, id in ids.items() if id in numbers}
    )


def _counts(numbers: Numbers) -> list[Check]:
    """Return the checks of counts of variables, analyses and levels."""
    uav = [name for name in study_names(numbers) if name.startswith("uav")]
    tested = [name for name in uav if f"{name}/t_test.t" in numbers]
    same = "number of printed measures of the UAV study, which has the same variables"
    rows = {scheme: f"table_3.1/{scheme}/error_mean" for scheme in SCHEMES}
    return [
        Check(
            "section_2_4_2_4/anovas",
            _anovas("uav", numbers),
            note=f"The seventh, {', '.join(tested)}, has two conditions and was compared by a "
            "t-test.",
        ),
        Check("section_3_9_4/anovas", _anovas("teleop", numbers)),
        Check("section_2_4_1_2/variables", _number_of(same, {name: f"{name}/n" for name in uav})),
        Check("section_3_8_2/levels", _number_of("rows of Table 3.1", rows)),
    ]


def _relations(numbers: Numbers) -> list[Check]:
    """
    Return the checks of relations.toml: comparisons of conditions, and numbers that are arithmetic
    of others.
    """
    listed = tomllib.loads((published_folder() / "relations.toml").read_text(encoding="utf-8"))
    checks = [_comparison(**row) for row in listed["comparisons"]]
    for number, row in listed["arithmetic"].items():
        folder, _, _ = number.rpartition("/")
        beside = {
            id.removeprefix(f"{folder}/"): id for id in numbers if id.startswith(f"{folder}/")
        }
        ids = beside | row.pop("inputs", {})
        formula = Formula.of(row.pop("formula"), ids, row.pop("label", ""), row.pop("text", ""))
        checks.append(Check(number, formula, **row))
    return checks


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


def _captions_and_appendix(numbers: Numbers) -> list[Finding]:
    """
    Return the rows of numbers that are printed twice, and the remark on the rate of correction.
    """
    captions = [id for id in numbers if id.startswith("figure_2_18/")]
    states = [id for id in numbers if id.startswith("appendix_a/state/")]
    section = "section_2_5/TSC_{}".format
    changes = [
        abs(numbers[section(f"{end}d")].value - numbers[section(f"{end}_0")].value) for end in "lu"
    ]
    minutes = 60.0 * max(changes) / numbers["section_2_5/c_b"].value
    chosen = (
        f"Chosen by the author. The printed change of thresholds takes at least {minutes:.1f} min "
        "at this rate; the length of the tests is not printed."
    )
    text = "The text of Section 2.5"
    return [
        *(
            _restated(id, id.replace("figure_2_18", "section_2_5"), text, numbers)
            for id in captions
        ),
        *(
            _restated(id, id.replace("state", "model"), "The transfer function", numbers)
            for id in states
        ),
        Remark("section_2_5/c_b", chosen),
    ]


def statement_checks(numbers: Numbers) -> list[Finding]:
    """
    Return the checks of statements.csv but those of the models and of sphericity, and those of
    relations.toml.
    """
    ranks = [_rank(id, numbers) for id in numbers if id.startswith("section_3_8_3/")]
    return [*ranks, *_counts(numbers), *_relations(numbers), *_captions_and_appendix(numbers)]


def _on_the_scale(study: str, numbers: Numbers) -> Check:
    """Return the check that no mean exceeds the greatest answer."""
    means = {id.rpartition(".")[2]: id for id in numbers if id.startswith(f"{study}/mean.")}
    greatest = Formula("greatest mean", means, lambda v: np.maximum.reduce(list(v.values())))
    scale = numbers[SCALES[study]]
    note = (
        f"The dependent variables of {study} are said to be those of the study before, "
        f"answered from 1 to {scale.printed}."
    )
    return Check(scale.id, greatest, suffix=f"/{study}", target=(1.0, scale.value), note=note)


def _perfect_operator(numbers: Numbers) -> Check:
    """
    Return the check that nobody who is measured performs better than a perfect operator, u_h = u_i.
    """
    means = {
        id.rpartition(".")[2]: id for id in numbers if id.startswith("uav.human_performance/mean.")
    }
    perfect = Formula("(u_i − u_h)/du_max at u_h = u_i", means, lambda v: np.zeros(()))
    best = max(numbers[id].value for id in means.values())
    note = (
        f"Means up to {best:g} are printed as performance: a quality would be 1 − |u_i − "
        "u_h|/du_max."
    )
    return Check("section_2_4_2/Z_Ph", perfect, target=(best, np.inf), note=note)


def _heaviest_handle(section: str, numbers: Numbers) -> Remark:
    """Return a remark on (3.10) at rest, B ≥ M Λ."""
    B, rate = numbers[f"{section}/B"], numbers[f"{section}/Lambda"]
    grams = 1000.0 * B.value / rate.value
    found = (
        f"(3.10) needs B ≥ MΛ: with B = {B.printed} and Λ = {rate.printed} the handle may "
        f"weigh {grams:.3g} g"
    )
    if grams < 50.0:  # no handle of a haptic device is so light
        return Remark(
            B.id, f"Suspicious: {found}, less than any that a hand holds; its mass is not printed."
        )
    return Remark(B.id, f"{found}; its mass is not printed.")


def setting_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of settings that other printed numbers bear on."""
    minutes = {name: f"section_2_4_2_3/{name}" for name in ("tutorial", "identification", "task")}
    minutes |= {"trials": "section_2_4_2_2/trials"}
    needed = Formula.of(
        "(tutorial + identification + 5 * trials * task) / 60", minutes, "five conditions"
    )
    study = numbers["section_2_4_2_3/study"]
    rest = "The rest is for questionnaires, consent and breaks."
    return [
        *(_on_the_scale(name, numbers) for name in SCALES),
        _perfect_operator(numbers),
        *(_heaviest_handle(section, numbers) for section in ("section_3_8_1", "section_3_9")),
        Check(study.id, needed, target=(0.0, study.value), note=rest),
    ]


def _relative(after: str, before: str) -> Formula:
    """Return the magnitude of a change relative to `before`, in %."""
    ids = {"after": after, "before": before}
    return Formula.of("100 * abs(after - before) / before", ids, "relative change")


def _by_range(number: str, after: str, before: str) -> Check:
    """
    Return the check of a difference of two robot performances in % of the range, or relative to the
    first.
    """
    ids = {
        "after": after,
        "before": before,
        "P_r_min": "remark_7/P_r_min",
        "P_r_max": "remark_7/P_r_max",
    }
    change = "100 * (after - before)"
    difference = Formula.of(
        f"{change} / (P_r_max - P_r_min)", ids, "difference of two values of (2.39)"
    )
    relative = Formula.of(f"{change} / (before - P_r_min)", ids, "relative change of (2.39)")
    return Check(number, difference, (relative,))


def _in_points(number: str, after: str, before: str, scale: float, numbers: Numbers) -> Check:
    """
    Return the check of a difference times `scale`, which is 100 for shares, or of a relative
    change.
    """
    relative = _relative(after, before)
    label = (
        "difference in units of the measure, printed as %" if scale == 1.0 else "percentage points"
    )
    difference = "abs(after - before)" if scale == 1.0 else f"{scale:g} * abs(after - before)"
    points = Formula.of(difference, relative.inputs, label)
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


def _teleoperation(numbers: Numbers) -> list[Check]:
    """Return the checks of the claims of Chapter 3 that are made twice."""
    both = "claim/section_3_9_5/tmig_and_omi_lower_tracking_error_against_mmi_by"
    mean = "teleop.{}/mean.{}".format
    omi, before = numbers[mean("tracking_error", "OMI")], mean("tracking_error", "MMI")
    tmig = _relative(mean("tracking_error", "TMIG"), before)
    used = (
        replace(
            tmig, label=f"the value of OMI, {omi.printed}, was used", changed={"after": omi.value}
        ),
    )
    quantity = "{} lowers tracking error against MMI by [%]".format
    return [
        Check(both, _relative(omi.id, before), quantity=quantity("OMI")),
        Check(both, tmig, explanations=used, suffix="/TMIG", quantity=quantity("TMIG")),
        Check("section_3_1/error", tmig, explanations=used),
        _in_points("section_3_1/workload", mean("tlx", "TMIG"), mean("tlx", "MMI"), 1.0, numbers),
    ]


def claim_checks(numbers: Numbers) -> list[Check]:
    """Return the checks of the printed percentages and differences."""
    read = [
        _claim(x.id, reading, after, before, numbers)
        for x, reading, after, before in claims()
        if reading
    ]
    return [*read, *_teleoperation(numbers)]
