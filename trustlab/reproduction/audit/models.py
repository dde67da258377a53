"""
The audit of Tables 2.1-2.3 and the pilot operator: rates, limits, bounds and thresholds of the TSC
model.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from trustlab.allocation.limits import limits_as_printed
from trustlab.allocation.steady_state import performance_as_printed, utilization_as_printed
from trustlab.models.robot import gain_of_human_performance
from trustlab.models.tsc import TscConstants, performance_weights
from trustlab.reproduction.audit.catalogue import PARTICIPANTS, why_unchecked
from trustlab.reproduction.audit.verdict import Check, Finding, Formula, Numbers, Possible, Remark

PERFORMANCE = ("P_r_min", "P_r_max", "P_h_min", "P_h_max")
# The target of a strict inequality, as a difference that must be positive.
HOLDS = (1e-12, np.inf)


def robot_gain(v: dict) -> np.ndarray:
    """Return b_pr of (2.3) from a_pr, P_r_min, P_r_max and P_h_max."""
    return gain_of_human_performance(v["a_pr"], v["P_r_min"], v["P_r_max"], v["P_h_max"])


def constants(v: dict) -> TscConstants:
    """
    Return the constants of the model at arrays of printed parameters; b_pr of (2.3) where it is not
    among them.
    """
    a_T, b_T = performance_weights(*(v[name] for name in PERFORMANCE))
    return TscConstants(
        a_r=v.get("a_r", np.nan),
        beta=np.nan,  # no limit and no bound depends on it
        p_h_min=v["P_h_min"],
        p_h_max=v["P_h_max"],
        a_pr=v["a_pr"],
        b_pr=v.get("b_pr", robot_gain(v)),
        p_r_min=v["P_r_min"],
        p_r_max=v["P_r_max"],
        a_T=a_T,
        b_T=b_T,
    )


def largest_step(v: dict, sign: float = 1.0) -> np.ndarray:
    """Return a_T δ_Pr + b_T δ_Ph (Remark 3); with sign −1 the magnitude of their difference."""
    a_T, b_T = performance_weights(*(v[name] for name in PERFORMANCE))
    return np.abs(a_T * v["delta_P_r"] + sign * b_T * v["delta_P_h"])


def limits(v: dict) -> dict[str, np.ndarray]:
    """Return TSC_lb and TSC_ub, (2.9)-(2.10), and b_pr of (2.3)."""
    lower, upper = limits_as_printed(constants(v), v["delta_P_h"])
    return {"TSC_lb": lower, "TSC_ub": upper, "b_pr": robot_gain(v)}


def bounds(v: dict) -> dict[str, np.ndarray]:
    """
    Return P_rl, P_ru (2.15) and r_l, r_u (2.33).

    With b_pr among the parameters, c of (2.20) is b_pr P_h/(1 − a_pr); P_rl and P_ru need neither
    a_pr nor a_r.
    """
    v = {"a_pr": np.nan, "a_r": np.nan} | v
    rise = v["b_pr"] * v["P_h_max"] / (1.0 - v["a_pr"]) if "b_pr" in v else None
    p = performance_as_printed(constants(v), v["TSC_l"], v["TSC_u"], v["delta_TSC"], rise)
    r = utilization_as_printed(
        v["a_r"], p.dwell_manual_low, p.dwell_manual_high, p.dwell_autonomous_high
    )
    r_low, r_high = (np.where(p.p_r_low < p.p_r_high, x, np.nan) for x in r)
    return {"P_rl": p.p_r_low, "P_ru": p.p_r_high, "r_l": r_low, "r_u": r_high}


def _ids(names: Iterable[str], column: str) -> dict[str, str]:
    """Return symbol to id for a participant or the pilot."""
    if column == "pilot":
        return {name: f"pilot/{name}" for name in names}
    table = {name: "2.2" if name in ("TSC_l", "TSC_u") else "2.1" for name in names}
    return {name: f"table_{table[name]}/{name}/{column}" for name in names}


def column_formulas(column: str) -> dict[str, Formula]:
    """Return the formulas of Table 2.1 for one participant, or for the pilot operator."""
    used = _ids((*PERFORMANCE, "a_pr", "delta_P_h"), column)
    gain = _ids(("a_pr", "P_r_min", "P_r_max", "P_h_max"), column)
    steps = _ids((*PERFORMANCE, "delta_P_r", "delta_P_h"), column)
    upper = Formula("a'_3 P_h + b'_3 (2.10)", used, lambda v: limits(v)["TSC_ub"])
    return {
        "b_r": Formula.of("1 - a_r", _ids(("a_r",), column)),
        "b_pr": Formula("(1 − a_pr)(P_r_max − P_r_min)/P_h_max", gain, robot_gain),
        "delta_TSC": Formula("a_T δ_Pr + b_T δ_Ph", steps, largest_step),
        "TSC_lb": Formula("a_T b'_1 − b_T P_h_min (2.9)", used, lambda v: limits(v)["TSC_lb"]),
        "TSC_ub": with_printed_gain(upper, column, "b_pr as printed"),
        "TSC_ub by (2.3)": replace(
            upper, label="b_pr of (2.3), not rounded; it makes TSC_ub = −TSC_lb"
        ),
    }


def with_printed_gain(formula: Formula, column: str, label: str) -> Formula:
    """
    Return a formula that takes the printed b_pr of a participant or the pilot, and not that of
    (2.3).

    It is not varied within its rounding on its own: (2.3) ties it to the other parameters.
    """
    inputs = {**formula.inputs, **_ids(("b_pr",), column)}
    return replace(formula, inputs=inputs, label=label, as_printed=("b_pr",))


def bound_formulas(p: str) -> dict[str, Formula]:
    """Return the formulas of Table 2.2 for one participant."""
    for_range = _ids((*PERFORMANCE, "delta_TSC", "TSC_l", "TSC_u"), p)
    for_rate = _ids((*PERFORMANCE, "a_pr", "a_r", "delta_TSC", "TSC_l", "TSC_u"), p)
    return {
        "P_rl": Formula("P_rl of (2.15)", for_range, lambda v: bounds(v)["P_rl"]),
        "P_ru": Formula("P_ru of (2.15)", for_range, lambda v: bounds(v)["P_ru"]),
        "r_l": Formula("r_l of (2.33)", for_rate, lambda v: bounds(v)["r_l"]),
        "r_u": Formula("r_u of (2.33)", for_rate, lambda v: bounds(v)["r_u"]),
    }


def upper_limit_check(p: str) -> Check:
    """Return the check of TSC_ub (2.10), with b_pr as printed and as (2.3) gives it."""
    formulas = column_formulas(p)
    exact = formulas["TSC_ub by (2.3)"]
    others = [q for q in PARTICIPANTS if q != p]
    theirs = [with_printed_gain(exact, q, f"the b_pr of participant {q} was used") for q in others]
    return Check(f"table_2.1/TSC_ub/{p}", formulas["TSC_ub"], (exact,), tuple(theirs))


def _untied_gain(check: Check, tied: Formula, numbers: Numbers) -> str:
    """
    Return a note if the printed limit needs a b_pr that rounds as printed but violates (2.3); else
    an empty text.
    """
    printed, gain = numbers[check.number], numbers[check.formula.inputs["b_pr"]]
    free = replace(check.formula, as_printed=())
    if any(way.meets(printed, numbers) for way in (check.formula, *check.conventions)):
        return ""
    if not free.meets(printed, numbers):
        return ""
    by_equation, _, _ = tied.range(numbers)
    return (
        f"Only a b_pr that does not obey (2.3) and still rounds to {gain.printed}, from "
        f"{gain.value - gain.half:.5f} to {gain.value + gain.half:.5f}, could reach "
        f"{printed.printed}; the text chooses b_pr by (2.3), here {by_equation:.5f}."
    )


def _participant(p: str, numbers: Numbers) -> list[Check]:
    """Return the checks of one participant's columns of Tables 2.1 and 2.2."""
    one, two = column_formulas(p), bound_formulas(p)
    limit, _, _ = one["TSC_ub"].range(numbers)
    chosen, below = numbers[f"table_2.2/TSC_u/{p}"], ""
    if limit < chosen.value:
        below = (
            f"The chosen TSC_u = {chosen.printed} of Table 2.2 lies above TSC_ub = "
            f"{limit:.3f} as recomputed."
        )
    upper = upper_limit_check(p)
    minus = Formula(
        "a_T δ_Pr − b_T δ_Ph",
        one["delta_TSC"].inputs,
        lambda v: largest_step(v, -1.0),
        "|a_T δ_Pr − b_T δ_Ph| was taken as it stands in Remark 3, whose maximum is the sum",
    )
    rise = "c of (2.20) as b_pr P_h/(1 − a_pr) with b_pr as printed"
    return [
        *(Check(f"table_2.1/{name}/{p}", one[name]) for name in ("b_r", "b_pr", "TSC_lb")),
        Check(f"table_2.1/delta_TSC/{p}", one["delta_TSC"], explanations=(minus,)),
        replace(upper, note=f"{below} {_untied_gain(upper, one['b_pr'], numbers)}".strip()),
        *(Check(f"table_2.2/{name}/{p}", two[name]) for name in ("P_rl", "P_ru")),
        *(
            Check(f"table_2.2/{name}/{p}", two[name], (with_printed_gain(two[name], p, rise),))
            for name in ("r_l", "r_u")
        ),
        _encloses_beta(p),
        _inside_limits(p, below),
    ]


def _encloses_beta(p: str) -> Check:
    ids = {"β": f"table_2.1/beta/{p}", "r_l": f"table_2.2/r_l/{p}", "r_u": f"table_2.2/r_u/{p}"}
    gap = Formula(
        "min(β − r_l, r_u − β)", ids, lambda v: np.minimum(v["β"] - v["r_l"], v["r_u"] - v["β"])
    )
    id, quantity = "section_2_4_1_2/enclose_beta", f"r_l ≤ β ≤ r_u, participant {p}"
    return Check(id, gap, suffix=f"/{p}", quantity=quantity, target=(0.0, np.inf))


def _inside_limits(p: str, note: str) -> Check:
    names = ("TSC_lb", "TSC_l", "TSC_u", "TSC_ub")

    def least_gap(v: dict) -> np.ndarray:
        return np.diff(np.stack([v[name] for name in names]), axis=0).min(axis=0)

    order = " < ".join(names)
    gap = Formula(f"least gap in {order}", _ids(names, p), least_gap)
    id, quantity = "section_2_4_1_2/limits", f"{order}, participant {p}"
    return Check(id, gap, suffix=f"/{p}", quantity=quantity, note=note, target=HOLDS)


def _largest_robot_step(column: str, numbers: Numbers) -> Possible:
    """
    Return the check that δ_Pr is at most what (2.3) can move P_r by in one step, at either end of
    its range.
    """
    id = _ids(("delta_P_r",), column)["delta_P_r"]
    most = Formula.of(
        "(1 - a_pr) * (P_r_max - P_r_min)", _ids(("a_pr", "P_r_min", "P_r_max"), column)
    )
    limit, _, _ = most.range(numbers)
    least, _ = numbers[id].compatible
    note = why_unchecked(id)
    if least > limit:
        note = (
            "Suspicious: with the parameters as printed, (2.3) moves P_r by at most "
            f"{limit:.2e} in one step."
        )
    return Possible(id, Formula.of("0", {}), most, note)


def _captured(p: str, numbers: Numbers) -> list[Check | Remark]:
    """Return the checks of one participant's thresholds in Table 2.3."""
    ids = {f"{t}_{s}": f"table_2.3/TSC_{t}.{s}/{p}" for t in ("l", "u") for s in ("mean", "sd")}
    apart = p != "3"

    def apart_by(v: dict) -> np.ndarray:
        return v["u_mean"] - v["u_sd"] - v["l_mean"] - v["l_sd"]

    gap = Formula("(μ_u − σ_u) − (μ_l + σ_l)", ids, apart_by)
    check = Check(
        "section_2_4_1_3/follow" if apart else "section_2_4_1_3/not_distinguishable",
        gap,
        suffix=f"/{p}" if apart else "",
        quantity=f"μ ± σ of TSC_l and TSC_u {'apart' if apart else 'overlap'}, participant {p}",
        target=(0.0, np.inf) if apart else (-np.inf, 0.0),
    )
    upper, limit = numbers[ids["u_mean"]], numbers[f"table_2.1/TSC_ub/{p}"]
    if upper.value <= limit.value:
        return [check]
    above = (
        f"{why_unchecked(upper.id)} It lies above TSC_ub = {limit.printed} of Table 2.1, so that "
        "Theorem 1 does not cover this participant's own switching (its condition is sufficient, "
        "not necessary)."
    )
    return [check, Remark(upper.id, above)]


def _spread_of_captured(numbers: Numbers) -> Check:
    """Return the check that participant 3 has the greatest standard deviations in Table 2.3."""
    sds = {f"{t}{p}": f"table_2.3/TSC_{t}.sd/{p}" for t in ("l", "u") for p in PARTICIPANTS}

    def widest(t: str) -> str:
        return max(PARTICIPANTS, key=lambda p: numbers[sds[f"{t}{p}"]].value)

    def excess(v: dict) -> np.ndarray:
        total = {p: v[f"l{p}"] + v[f"u{p}"] for p in PARTICIPANTS}
        return total.pop("3") - np.maximum.reduce(list(total.values()))

    alone = "; ".join(f"for TSC_{t} alone it is participant {widest(t)}" for t in ("l", "u"))
    return Check(
        "section_2_4_1_3/higher_sd",
        Formula("σ_l + σ_u of participant 3 less the greatest of the others", sds, excess),
        target=HOLDS,
        note=f"Largest for both thresholds together; {alone}.",
    )


def _pilot(numbers: Numbers) -> list[Finding]:
    """
    Return the checks of the pilot operator, and of the thresholds that Section 2.5 chooses for
    them.
    """
    f = column_formulas("pilot")
    lower, _, _ = f["TSC_lb"].range(numbers)
    upper, least, most = f["TSC_ub"].range(numbers)
    found = (
        f"The pilot's own numbers give TSC_ub = {upper:.3f} by (2.10), from {least:.3f} to "
        f"{most:.3f} within rounding, and TSC_lb = {lower:.3f}."
    )
    over = "Suspicious: above the limit under which Theorem 1 guarantees switching. "
    by_author = "Chosen by the author. "
    chosen = [f"section_2_5/{name}" for name in ("TSC_l_0", "TSC_u_0", "TSC_ld", "TSC_ud")]
    return [
        _largest_robot_step("pilot", numbers),
        Check("pilot/b_r", f["b_r"]),
        Check("pilot/b_pr", f["b_pr"]),
        Check("claim/remark_3/delta_tsc_of_the_pilot_operator", f["delta_TSC"]),
        *(Remark(id, f"{over if numbers[id].value > most else by_author}{found}") for id in chosen),
    ]


def model_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of Tables 2.1-2.3 and of the pilot operator."""
    checks: list[Finding] = []
    for p in PARTICIPANTS:
        checks += [
            *_participant(p, numbers),
            _largest_robot_step(p, numbers),
            *_captured(p, numbers),
        ]
    return [*checks, _spread_of_captured(numbers), *_pilot(numbers)]
