"""
The audit of ranks, percentages and differences, of numbers printed in two places, and of settings;
and what it says beside a verdict where numbers decide the words.
"""

from collections import Counter
from dataclasses import replace
from decimal import ROUND_HALF_UP, Decimal
from typing import Any

import numpy as np

from trustlab.reproduction.audit.catalogue import (
    PARTICIPANTS,
    claims,
    why_unchecked,
)
from trustlab.reproduction.audit.check import (
    Allows,
    Finding,
    Follows,
    Formula,
    Numbers,
    Row,
    row_about,
)
from trustlab.reproduction.audit.relations import (
    CHANGE,
    LIMIT_INPUTS,
    change,
    limits,
    related,
    relations,
    upper_limit,
)
from trustlab.reproduction.printed_number import ROUNDINGS

SCHEMES = ("M", "MI", "MMI", "TMIG", "TMIS")
HIGHER_IS_BETTER = {"error": False, "tlx": False, "trust": True, "preference": True}


def relation_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of all relations, with what is to be said of them."""
    checks = list(relations(numbers))
    notes = {
        **_notes_on_limits(numbers),
        **_notes_on_steps(checks, numbers),
        **_notes_on_bounds(numbers),
        **_note_on_spread(numbers),
    }
    return [
        replace(check, note=f"{notes.get(check.of + check.suffix, '')} {check.note}".strip())
        for check in checks
    ]


def _notes_on_limits(numbers: Numbers) -> dict[str, str]:
    """Say where the chosen TSC_u lies above TSC_ub, and where b_pr breaks (2.3)."""
    notes = {}
    for p in PARTICIPANTS:
        id = f"table_2.1/TSC_ub/{p}"
        check, chosen = related(id, numbers), numbers[f"table_2.2/TSC_u/{p}"]
        limit, _, _ = check.range(numbers)
        below = ""
        if limit < chosen.value:
            below = (
                f"The chosen TSC_u = {chosen.printed} of Table 2.2 lies above TSC_ub = "
                f"{limit:.3f} as recomputed."
            )
        notes[f"section_2_4_1_2/limits/{p}"] = below
        notes[id] = f"{below} {_untied_gain(check, p, numbers)}".strip()
    return notes


def _untied_gain(check: Follows, p: str, numbers: Numbers) -> str:
    """Say so if the printed limit needs a b_pr that rounds as printed but violates (2.3)."""
    untied = replace(check, as_printed=())
    if check.row(numbers).verdict != "differs" or untied.row(numbers).verdict == "differs":
        return ""
    gain = numbers[f"table_2.1/b_pr/{p}"]
    by_equation, _, _ = related(gain.id, numbers).range(numbers)
    return (
        f"Only a b_pr that does not obey (2.3) and still rounds to {gain.printed}, from "
        f"{gain.value - gain.half:.5f} to {gain.value + gain.half:.5f}, could reach "
        f"{numbers[check.of].printed}; the text chooses b_pr by (2.3), here {by_equation:.5f}."
    )


def _notes_on_steps(checks: list[Follows | Allows], numbers: Numbers) -> dict[str, str]:
    """Say what δ_Pr depends on, or that it is more than (2.3) can move P_r by in one step."""
    notes = {}
    for check in checks:
        if isinstance(check, Allows) and "delta_P_r" in check.of:
            limit, _, _ = check.most.range(numbers)
            least, _ = numbers[check.of].compatible
            notes[check.of] = why_unchecked(check.of)
            if least > limit:
                notes[check.of] = (
                    "Suspicious: with the parameters as printed, (2.3) moves P_r by at most "
                    f"{limit:.2e} in one step."
                )
    return notes


def _notes_on_bounds(numbers: Numbers) -> dict[str, str]:
    """Say which p-value is bounded otherwise than most are, "<.0005"."""
    bounds = {id: x.printed for id, x in numbers.items() if "/pairs." in id and x.is_bound}
    ((usual, _),) = Counter(bounds.values()).most_common(1) or [("", 0)]
    note = f"Suspicious: every other bound of its kind is printed {usual}; probably a zero is "
    return {id: f"{note}missing." for id, text in bounds.items() if text != usual}


def _note_on_spread(numbers: Numbers) -> dict[str, str]:
    """Say whose thresholds of Table 2.3 spread most, one threshold at a time."""
    widest = {
        t: max(PARTICIPANTS, key=lambda p: numbers[f"table_2.3/TSC_{t}.sd/{p}"].value) for t in "lu"
    }
    alone = "; ".join(f"for TSC_{t} alone it is participant {p}" for t, p in widest.items())
    return {"section_2_4_1_3/higher_sd": f"Largest for both thresholds together; {alone}."}


def _chosen_thresholds(numbers: Numbers) -> list[Row]:
    """Return remarks on the thresholds that Section 2.5 chooses for the pilot operator."""
    ids = {name: f"pilot/{name}" for name in (*LIMIT_INPUTS, "b_pr")}
    lower = Formula("TSC_lb", lambda v: limits(v.named(*LIMIT_INPUTS))["TSC_lb"], ids=ids)
    upper = Formula("TSC_ub", lambda v: upper_limit(v, "b_pr"), ids=ids, as_printed=("b_pr",))
    limit, least, most = upper.range(numbers)
    allowed = (
        f"The pilot's own numbers give TSC_ub = {limit:.3f} by (2.10), from {least:.3f} to "
        f"{most:.3f} within rounding, and TSC_lb = {lower.range(numbers)[0]:.3f}."
    )
    over = "Suspicious: above the limit under which Theorem 1 guarantees switching."
    chosen = [numbers[f"section_2_5/{name}"] for name in ("TSC_l_0", "TSC_u_0", "TSC_ld", "TSC_ud")]
    return [
        row_about(x, f"{over if x.value > most else 'Chosen by the author.'} {allowed}")
        for x in chosen
    ]


def _captured_thresholds(numbers: Numbers) -> list[Row]:
    """Return remarks on upper thresholds of Table 2.3 above TSC_ub."""
    rows = []
    for p in PARTICIPANTS:
        upper, limit = numbers[f"table_2.3/TSC_u.mean/{p}"], numbers[f"table_2.1/TSC_ub/{p}"]
        if upper.value > limit.value:
            above = (
                f"{why_unchecked(upper.id)} It lies above TSC_ub = {limit.printed} of Table 2.1, "
                "so that Theorem 1 does not cover this participant's own switching (its condition "
                "is sufficient, not necessary)."
            )
            rows.append(row_about(upper, above))
    return rows


def _heaviest_handle(section: str, numbers: Numbers) -> Row:
    """Return a remark on (3.10) at rest, B ≥ M Λ."""
    damping, rate = numbers[f"{section}/B"], numbers[f"{section}/Lambda"]
    grams = 1000.0 * damping.value / rate.value
    weight = (
        f"(3.10) needs B ≥ MΛ: with B = {damping.printed} and Λ = {rate.printed} the handle may "
        f"weigh {grams:.3g} g"
    )
    if grams < 50.0:  # no handle of a haptic device is so light
        weight = f"Suspicious: {weight}, less than any that a hand holds"
    return row_about(damping, f"{weight}; its mass is not printed.")


def remarks(numbers: Numbers) -> list[Row]:
    """Return the remarks on numbers that no other determines."""
    return [
        *_chosen_thresholds(numbers),
        *_captured_thresholds(numbers),
        *(_heaviest_handle(section, numbers) for section in ("section_3_8_1", "section_3_9")),
    ]


def _rank(number: str, numbers: Numbers) -> Follows:
    """Return the check of a rank in Table 3.1: 1 is the best, or the worst where that is said."""
    scheme, measure = number.split("/")[1].split("_", 1)
    ids = {f"x_{name}": f"table_3.1/{name}/{measure}_mean" for name in SCHEMES}
    highest = HIGHER_IS_BETTER[measure] != (numbers[number].printed == "worst")
    sign = 1 if highest else -1
    order = sorted(SCHEMES, key=lambda c: numbers[ids[f"x_{c}"]].value, reverse=highest)
    means = ", ".join(f"{c} {numbers[ids[f'x_{c}']].printed}" for c in order)

    def rank(v: Any) -> np.ndarray:
        this = getattr(v, f"x_{scheme}")
        return 1.0 + (sign * v.x > sign * this).sum(axis=0)

    return Follows(
        f"rank of {scheme}, {'highest' if highest else 'lowest'} first",
        rank,
        ids=ids,
        of=number,
        note=f"In order: {means}.",
    )


def _restated(id: str, first: str, where: str, numbers: Numbers) -> Row:
    """
    Return whether a number printed in a second place is the one of the first, or that one rounded.
    """
    number, source = numbers[id], numbers[first]
    here, there = Decimal(number.printed), Decimal(source.printed)
    same = here in (there.quantize(here, rule) for rule in ROUNDINGS)
    reason = f"{where} has {source.printed}."
    if not same:
        rounded = there.quantize(here, ROUND_HALF_UP)
        neither = "neither is the other one rounded"
        why = f"{source.printed} rounds to {rounded}" if rounded != there else neither
        reason = (
            f"{reason[:-1]}, here {number.printed} is printed: one of the two is wrong, as {why}."
        )
    return row_about(
        number,
        reason,
        "reproduced" if same else "differs",
        (float(there),) * 3,
        formula="the same number in two places",
        inputs=f"{source.printed} ({source.id})",
    )


def statement_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of ranks, and of numbers that are printed twice."""
    findings: list[Finding] = []
    for id in numbers:
        if id.startswith("section_3_8_3/"):
            findings.append(_rank(id, numbers))
        elif id.startswith("figure_2_18/"):
            first = id.replace("figure_2_18", "section_2_5")
            findings.append(_restated(id, first, "The text of Section 2.5", numbers))
        elif id.startswith("appendix_a/state/"):
            first = id.replace("state", "model")
            findings.append(_restated(id, first, "The transfer function", numbers))
    return findings


def _by_range(number: str, after: str, before: str) -> Follows:
    """Return the check of a difference in % of the range of P_r, or relative to the first."""
    ends = {end: f"remark_7/{end}" for end in ("P_r_min", "P_r_max")}
    relative = Formula(
        "100 (after − before)/(before − P_r_min)",
        lambda v: 100 * (v.after - v.before) / (v.before - v.P_r_min),
        "relative change of (2.39)",
        {"after": after, "before": before, **ends},
    )
    return Follows(
        "100 (after − before)/(P_r_max − P_r_min)",
        lambda v: 100 * (v.after - v.before) / (v.P_r_max - v.P_r_min),
        "difference of two values of (2.39)",
        relative.ids,
        of=number,
        conventions=(relative,),
    )


def _in_points(relative: Follows, scale: float, numbers: Numbers) -> Follows:
    """Return the check of a difference times `scale`, 100 for shares, or of a relative change."""
    would, _, _ = relative.range(numbers)
    times = "" if scale == 1.0 else f"{scale:g} "
    return replace(
        relative,
        text=f"{times}|after − before|",
        compute=lambda v: scale * abs(v.after - v.before),
        label="percentage points" if times else "difference in units of the measure, printed as %",
        conventions=(relative,),
        note="Printed with a % sign, which reads as a relative change; that would be "
        f"{would:.1f} %.",
    )


def _as_change(relative: Follows, numbers: Numbers) -> Follows:
    """
    Return the check of a relative change; a mean of two decimals may have been used with three.
    """
    after = relative.ids["after"]
    mean, condition = numbers[after], after.partition("/")[2].removeprefix("mean.")
    finer = [mean.value + k / 1000 for k in (-1, 1, -2, 2, -3, 3, -4, 4) if mean.decimals == 2]

    def with_mean(value: float) -> Formula:
        label = f"the mean of {condition} was {value:.3f}, printed as {mean.printed}"
        return replace(relative, label=label, changed={"after": value})

    return replace(relative, explanations=tuple(map(with_mean, finer)))


def _claim(number: str, reading: str, after: str, before: str, numbers: Numbers) -> Follows:
    """Return the check of a claim by its reading."""
    if reading == "range":
        return _by_range(number, after, before)
    ids = {"after": after, "before": before}
    relative = Follows(CHANGE, change, "relative change", ids, of=number)
    if reading == "relative":
        return _as_change(relative, numbers)
    return _in_points(relative, 100.0 if reading == "share" else 1.0, numbers)


def claim_checks(numbers: Numbers) -> list[Follows]:
    """Return the checks of the printed percentages and differences."""
    mean = "teleop.tlx/mean.{}".format
    return [
        *(
            _claim(claim.id, reading, after, before, numbers)
            for claim, reading, after, before in claims()
            if reading
        ),
        _claim("section_3_1/workload", "points", mean("TMIG"), mean("MMI"), numbers),
    ]
