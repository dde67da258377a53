"""What the audit says beside a verdict where numbers decide the words; and remarks on settings."""

from collections import Counter
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from trustlab.reproduction.audit.catalogue import (
    PARTICIPANTS,
    conditions_of,
    study_names,
    why_unchecked,
)
from trustlab.reproduction.audit.check import Check, Finding, Formula, Numbers, Possible, Remark
from trustlab.reproduction.audit.equations import LIMIT_INPUTS, limits
from trustlab.reproduction.audit.relations import chi2_of_epsilon, relations, upper_limit
from trustlab.studies.anova import mauchly_p_value


def related(number: str, numbers: Numbers) -> Check:
    """Return the first relation that a number follows from."""
    return next(check for check in relations(numbers, number) if isinstance(check, Check))


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
        replace(check, note=f"{notes[id]} {check.note}".strip()) if id in notes else check
        for check in checks
        for id in [check.number + (check.suffix if isinstance(check, Check) else "")]
    ]


def _notes_on_limits(numbers: Numbers) -> dict[str, str]:
    """Say where the chosen TSC_u lies above TSC_ub, and where b_pr breaks (2.3)."""
    notes = {}
    for p in PARTICIPANTS:
        id = f"table_2.1/TSC_ub/{p}"
        if id not in numbers:
            continue
        check = related(id, numbers)
        chosen = numbers[f"table_2.2/TSC_u/{p}"]
        limit, _, _ = check.formula.range(numbers)
        below = ""
        if limit < chosen.value:
            below = (
                f"The chosen TSC_u = {chosen.printed} of Table 2.2 lies above TSC_ub = "
                f"{limit:.3f} as recomputed."
            )
        notes[f"section_2_4_1_2/limits/{p}"] = below
        notes[id] = f"{below} {_untied_gain(check, p, numbers)}".strip()
    return notes


def _untied_gain(check: Check, p: str, numbers: Numbers) -> str:
    """Say so if the printed limit needs a b_pr that rounds as printed but violates (2.3)."""
    printed, gain = numbers[check.number], numbers[f"table_2.1/b_pr/{p}"]
    untied = replace(check.formula, as_printed=())
    if any(way.meets(printed, numbers) for way in (check.formula, *check.conventions)):
        return ""
    if not untied.meets(printed, numbers):
        return ""
    by_equation, _, _ = related(gain.id, numbers).formula.range(numbers)
    return (
        f"Only a b_pr that does not obey (2.3) and still rounds to {gain.printed}, from "
        f"{gain.value - gain.half:.5f} to {gain.value + gain.half:.5f}, could reach "
        f"{printed.printed}; the text chooses b_pr by (2.3), here {by_equation:.5f}."
    )


def _notes_on_steps(checks: list, numbers: Numbers) -> dict[str, str]:
    """Say what δ_Pr depends on, or that it is more than (2.3) can move P_r by in one step."""
    notes = {}
    for check in checks:
        if isinstance(check, Possible) and "delta_P_r" in check.number:
            limit, _, _ = check.most.range(numbers)
            least, _ = numbers[check.number].compatible
            notes[check.number] = why_unchecked(check.number)
            if least > limit:
                notes[check.number] = (
                    "Suspicious: with the parameters as printed, (2.3) moves P_r by at most "
                    f"{limit:.2e} in one step."
                )
    return notes


def _notes_on_bounds(numbers: Numbers) -> dict[str, str]:
    """Say which p-value is bounded otherwise than most are, "<.0005"."""
    bounds = {id: x.printed for id, x in numbers.items() if "/pairs." in id and x.is_bound}
    usual = max(Counter(bounds.values()).items(), key=lambda item: item[1], default=("", 0))[0]
    note = f"Suspicious: every other bound of its kind is printed {usual}; probably a zero is "
    return {id: f"{note}missing." for id, text in bounds.items() if text != usual}


def _note_on_spread(numbers: Numbers) -> dict[str, str]:
    """Say whose thresholds of Table 2.3 spread most, one threshold at a time."""
    if "table_2.3/TSC_l.sd/1" not in numbers:
        return {}
    widest = {
        t: max(PARTICIPANTS, key=lambda p: numbers[f"table_2.3/TSC_{t}.sd/{p}"].value) for t in "lu"
    }
    alone = "; ".join(f"for TSC_{t} alone it is participant {p}" for t, p in widest.items())
    return {"section_2_4_1_3/higher_sd": f"Largest for both thresholds together; {alone}."}


def _chosen_thresholds(numbers: Numbers) -> list[Remark]:
    """Return remarks on the thresholds that Section 2.5 chooses for the pilot operator."""
    ids = {
        name: f"pilot/{name}" for name in ("P_r_min", "P_r_max", "P_h_min", "P_h_max", "delta_P_h")
    }
    ids |= {"a_pr": "pilot/a_pr", "b_pr": "pilot/b_pr"}
    lower = Formula("TSC_lb", lambda v: limits(v.named(*LIMIT_INPUTS))["TSC_lb"], ids)
    upper = Formula("TSC_ub", lambda v: upper_limit(v, "b_pr"), ids, as_printed=("b_pr",))
    limit, least, most = upper.range(numbers)
    allowed = (
        f"The pilot's own numbers give TSC_ub = {limit:.3f} by (2.10), from {least:.3f} to "
        f"{most:.3f} within rounding, and TSC_lb = {lower.range(numbers)[0]:.3f}."
    )
    over = "Suspicious: above the limit under which Theorem 1 guarantees switching."
    remarks = []
    for name in ("TSC_l_0", "TSC_u_0", "TSC_ld", "TSC_ud"):
        id = f"section_2_5/{name}"
        first = over if numbers[id].value > most else "Chosen by the author."
        remarks.append(Remark(id, f"{first} {allowed}"))
    return remarks


def _captured_thresholds(numbers: Numbers) -> list[Remark]:
    """Return remarks on upper thresholds of Table 2.3 above TSC_ub."""
    remarks = []
    for p in PARTICIPANTS:
        upper, limit = numbers[f"table_2.3/TSC_u.mean/{p}"], numbers[f"table_2.1/TSC_ub/{p}"]
        if upper.value > limit.value:
            above = (
                f"{why_unchecked(upper.id)} It lies above TSC_ub = {limit.printed} of Table 2.1, "
                "so that Theorem 1 does not cover this participant's own switching (its condition "
                "is sufficient, not necessary)."
            )
            remarks.append(Remark(upper.id, above))
    return remarks


def _chi2(v: Any, k: int, greatest: bool) -> np.ndarray:
    """Return the least or greatest χ² that an ε leaves."""
    return chi2_of_epsilon(v.ε, v.n, k, greatest)


def _unprinted_sphericity(numbers: Numbers) -> list[Remark]:
    """Return remarks on tests of sphericity whose χ² is not printed, from the ε that is."""
    remarks = []
    for name in study_names(numbers):
        if f"{name}/epsilon" not in numbers or f"{name}/mauchly.chi2" in numbers:
            continue
        k = len(conditions_of(name))
        ids = {"ε": f"{name}/epsilon", "n": f"{name}/n"}
        least, most = (
            Formula("χ²", partial(_chi2, k=k, greatest=greatest), ids) for greatest in (False, True)
        )
        _, low, _ = least.range(numbers)
        _, _, high = most.range(numbers)
        n = numbers[ids["n"]].value
        p_low, p_high = (float(mauchly_p_value(chi2, n, k)) for chi2 in (high, low))
        reason = (
            f"χ² is not printed; ε = {numbers[ids['ε']].printed} leaves χ² from {low:.1f} to "
            f"{high:.1f}, that is p from {p_low:.2g} to {p_high:.2g}."
        )
        remarks.append(Remark(f"{name}/sphericity", reason))
    return remarks


def _heaviest_handle(section: str, numbers: Numbers) -> Remark:
    """Return a remark on (3.10) at rest, B ≥ M Λ."""
    damping, rate = numbers[f"{section}/B"], numbers[f"{section}/Lambda"]
    grams = 1000.0 * damping.value / rate.value
    weight = (
        f"(3.10) needs B ≥ MΛ: with B = {damping.printed} and Λ = {rate.printed} the handle may "
        f"weigh {grams:.3g} g"
    )
    if grams < 50.0:  # no handle of a haptic device is so light
        weight = f"Suspicious: {weight}, less than any that a hand holds"
    return Remark(damping.id, f"{weight}; its mass is not printed.")


def _rate_of_correction(numbers: Numbers) -> Remark:
    """Return a remark on how long the printed change of thresholds takes."""
    section = "section_2_5/TSC_{}".format
    changes = [
        abs(numbers[section(f"{end}d")].value - numbers[section(f"{end}_0")].value) for end in "lu"
    ]
    minutes = 60.0 * max(changes) / numbers["section_2_5/c_b"].value
    chosen = (
        f"Chosen by the author. The printed change of thresholds takes at least {minutes:.1f} min "
        "at this rate; the length of the tests is not printed."
    )
    return Remark("section_2_5/c_b", chosen)


def remarks(numbers: Numbers) -> list[Remark]:
    """Return the remarks on numbers that no other determines."""
    return [
        *_chosen_thresholds(numbers),
        *_captured_thresholds(numbers),
        *_unprinted_sphericity(numbers),
        *(_heaviest_handle(section, numbers) for section in ("section_3_8_1", "section_3_9")),
        _rate_of_correction(numbers),
    ]
