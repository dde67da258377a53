"""The audit of Tables 2.1-2.3 and the pilot operator: rates, limits, bounds and thresholds of the TSC model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trustlab.reproduction.audit_checks import Check, Formula, Numbers, Possible, Remark
from trustlab.reproduction.audit_gain import untied_gain_note

__all__ = [
    "PARTICIPANTS",
    "column_formulas",
    "gains",
    "model_checks",
    "printed_bounds",
    "printed_limits",
    "upper_limit_check",
]

PARTICIPANTS = ("1", "2", "3", "4", "5")
PERFORMANCE = ("P_r_min", "P_r_max", "P_h_min", "P_h_max")


def gains(v: dict) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a_T and b_T of (2.2).

    Parameters
    ----------
    v : dict
        P_r_min, P_r_max, P_h_min, P_h_max, as arrays.
    """
    scale = v["P_r_max"] * v["P_h_max"] - v["P_r_min"] * v["P_h_min"]
    return (v["P_h_max"] + v["P_h_min"]) / scale, (v["P_r_max"] + v["P_r_min"]) / scale


def delta_tsc(v: dict, sign: float = 1.0) -> np.ndarray:
    """
    Return a_T δ_Pr + b_T δ_Ph, Remark 3.

    Parameters
    ----------
    v : dict
        The performances, delta_P_r and delta_P_h.
    sign : float
        −1 for the magnitude of their difference.
    """
    a_t, b_t = gains(v)
    return np.abs(a_t * v["delta_P_r"] + sign * b_t * v["delta_P_h"])


def robot_gain(v: dict) -> np.ndarray:
    """
    Return b_pr = (1 − a_pr)(P_r,max − P_r,min)/P_h,max, (2.3).

    Parameters
    ----------
    v : dict
        a_pr, P_r_min, P_r_max and P_h_max.
    """
    return (1.0 - v["a_pr"]) * (v["P_r_max"] - v["P_r_min"]) / v["P_h_max"]


def printed_limits(v: dict) -> tuple[np.ndarray, np.ndarray]:
    """
    Return TSC_lb and TSC_ub, (2.9)-(2.10).

    Parameters
    ----------
    v : dict
        The performances, a_pr, delta_P_h, and b_pr; without b_pr that of (2.3).
    """
    a_t, b_t = gains(v)
    slack = b_t * v["delta_P_h"] / (1.0 - v["a_pr"])
    slope = a_t * v.get("b_pr", robot_gain(v)) / (1.0 - v["a_pr"]) - b_t
    lower = a_t * v["P_r_min"] + slack - b_t * v["P_h_min"]
    upper = a_t * v["P_r_min"] - slack + slope * np.where(slope < 0.0, v["P_h_max"], v["P_h_min"])
    return lower, upper


def _dwell(start: np.ndarray, end: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return ⌊ln(end/start)/ln a⌋, infinite where the end is never reached."""
    with np.errstate(all="ignore"):
        steps = np.floor(np.log(np.where(end > 0.0, end, 1.0) / start) / np.log(a))
    return np.where(end > 0.0, steps, np.inf)


def printed_bounds(v: dict) -> dict[str, np.ndarray]:
    """
    Return P_rl, P_ru (2.15) and r_l, r_u (2.33) with the dwell times (2.16), (2.20), (2.21).

    Parameters
    ----------
    v : dict
        The performances, a_pr, a_r, delta_TSC, TSC_l and TSC_u; with b_pr, c of (2.20) is b_pr P_h/(1 − a_pr).
    """
    a_t, b_t = gains(v)
    low = np.maximum((v["TSC_l"] - v["delta_TSC"] + b_t * v["P_h_min"]) / a_t, v["P_r_min"])
    high = np.minimum((v["TSC_u"] + v["delta_TSC"] + b_t * v["P_h_max"]) / a_t, v["P_r_max"])
    most = v["b_pr"] * v["P_h_max"] / (1.0 - v["a_pr"]) if "b_pr" in v else v["P_r_max"] - v["P_r_min"]
    least = most * v["P_h_min"] / v["P_h_max"]
    rest = _dwell(high - v["P_r_min"], low - v["P_r_min"], v["a_pr"])
    quick, slow = (_dwell(v["P_r_min"] + c - low, v["P_r_min"] + c - high, v["a_pr"]) for c in (most, least))
    a = np.minimum(v["a_r"], 1.0 - 1e-12)
    with np.errstate(all="ignore"):
        r_low = (1.0 - a**quick) * a**rest / (1.0 - a ** (quick + rest))
        r_high = (1.0 - a**slow) / (1.0 - a ** (slow + rest))
    wrong = low >= high
    return {
        "P_rl": low,
        "P_ru": high,
        "r_l": np.where(wrong, np.nan, r_low),
        "r_u": np.where(wrong, np.nan, r_high),
    }


def _ids(names: tuple[str, ...], column: str) -> dict[str, str]:
    """Return symbol to id for a participant or the pilot."""
    if column == "pilot":
        return {name: f"pilot/{name}" for name in names}
    table = {name: "2.2" if name in ("TSC_l", "TSC_u") else "2.1" for name in names}
    return {name: f"table_{table[name]}/{name}/{column}" for name in names}


def column_formulas(column: str) -> dict[str, Formula]:
    """
    Return the formulas of one participant's columns of Tables 2.1 and 2.2, or of the pilot operator's numbers.

    Parameters
    ----------
    column : str
        "1" … "5", or "pilot".
    """
    limits = (*PERFORMANCE, "a_pr", "delta_P_h")
    bounds = (*PERFORMANCE, "a_pr", "a_r", "delta_TSC", "TSC_l", "TSC_u")
    formulas = {
        "b_r": Formula("1 − a_r", _ids(("a_r",), column), lambda v: 1.0 - v["a_r"]),
        "b_pr": Formula(
            "(1 − a_pr)(P_r_max − P_r_min)/P_h_max",
            _ids(("a_pr", "P_r_min", "P_r_max", "P_h_max"), column),
            robot_gain,
        ),
        "delta_TSC": Formula(
            "a_T δ_Pr + b_T δ_Ph", _ids((*PERFORMANCE, "delta_P_r", "delta_P_h"), column), delta_tsc
        ),
        "TSC_lb": Formula(
            "a_T b'_1 − b_T P_h_min (2.9)", _ids(limits, column), lambda v: printed_limits(v)[0]
        ),
        "TSC_ub": Formula(
            "a'_3 P_h + b'_3 (2.10)",
            _ids((*limits, "b_pr"), column),
            lambda v: printed_limits(v)[1],
            "b_pr as printed",
            as_printed=("b_pr",),
        ),
    }
    if column != "pilot":
        for name, number in (("P_rl", "(2.15)"), ("P_ru", "(2.15)"), ("r_l", "(2.33)"), ("r_u", "(2.33)")):
            used = bounds if name.startswith("r_") else (*PERFORMANCE, "delta_TSC", "TSC_l", "TSC_u")
            compute = (
                (lambda v, name=name: printed_bounds(v)[name])
                if name.startswith("r_")
                else (lambda v, name=name: printed_bounds(v | {"a_pr": 0.99, "a_r": 0.99})[name])
            )
            formulas[name] = Formula(f"{name} of {number}", _ids(used, column), compute)
    return formulas


def upper_limit_check(p: str) -> Check:
    """
    Return the check of TSC_ub (2.10), with b_pr as printed and as (2.3) gives it.

    b_pr is not varied within its rounding on its own: (2.3) ties it to the other parameters. Where that alone would reach
    the printed limit, a note says so.

    Parameters
    ----------
    p : str
        The participant.
    """
    ub = column_formulas(p)["TSC_ub"]
    exact_b = Formula(
        ub.text,
        {k: v for k, v in ub.inputs.items() if k != "b_pr"},
        ub.compute,
        "b_pr of (2.3), not rounded; it makes TSC_ub = −TSC_lb",
    )
    neighbours = tuple(
        Formula(
            ub.text,
            dict(ub.inputs) | {"b_pr": f"table_2.1/b_pr/{q}"},
            ub.compute,
            f"the b_pr of participant {q} was used",
            as_printed=("b_pr",),
        )
        for q in PARTICIPANTS
        if q != p
    )
    return Check(f"table_2.1/TSC_ub/{p}", ub, (exact_b,), neighbours)


def _participant(p: str, numbers: Numbers) -> list:
    f = column_formulas(p)
    limit, chosen = f["TSC_ub"].range(numbers)[0], numbers[f"table_2.2/TSC_u/{p}"]
    below = (
        f"With TSC_ub = {limit:.3f} as recomputed, the chosen TSC_u = {chosen.printed} of Table 2.2 lies above it."
        if limit < chosen.value
        else ""
    )
    untied = untied_gain_note(upper_limit_check(p), f["b_pr"], numbers)
    minus = Formula(
        "a_T δ_Pr − b_T δ_Ph",
        f["delta_TSC"].inputs,
        lambda v: delta_tsc(v, -1.0),
        "|a_T δ_Pr − b_T δ_Ph| was taken as it stands in Remark 3, whose maximum is the sum",
    )
    printed_b = {
        name: Formula(
            f[name].text,
            dict(f[name].inputs) | {"b_pr": f"table_2.1/b_pr/{p}"},
            f[name].compute,
            "c of (2.20) as b_pr P_h/(1 − a_pr) with b_pr as printed",
            as_printed=("b_pr",),
        )
        for name in ("r_l", "r_u")
    }
    one, two = f"table_2.1/{{}}/{p}", f"table_2.2/{{}}/{p}"
    return [
        Check(one.format("b_r"), f["b_r"]),
        Check(one.format("b_pr"), f["b_pr"]),
        Check(one.format("delta_TSC"), f["delta_TSC"], explanations=(minus,)),
        Check(one.format("TSC_lb"), f["TSC_lb"]),
        replace(upper_limit_check(p), note=f"{below} {untied}".strip()),
        Check(two.format("P_rl"), f["P_rl"]),
        Check(two.format("P_ru"), f["P_ru"]),
        Check(two.format("r_l"), f["r_l"], (printed_b["r_l"],)),
        Check(two.format("r_u"), f["r_u"], (printed_b["r_u"],)),
        Check(
            "section_2_4_1_2/enclose_beta",
            Formula(
                "min(β − r_l, r_u − β)",
                {
                    "β": one.format("beta"),
                    "r_l": two.format("r_l"),
                    "r_u": two.format("r_u"),
                },
                lambda v: np.minimum(v["β"] - v["r_l"], v["r_u"] - v["β"]),
            ),
            suffix=f"/{p}",
            quantity=f"r_l ≤ β ≤ r_u, participant {p}",
            target=(0.0, np.inf),
        ),
        Check(
            "section_2_4_1_2/limits",
            Formula(
                "least gap in TSC_lb < TSC_l < TSC_u < TSC_ub",
                {
                    "TSC_lb": one.format("TSC_lb"),
                    "TSC_l": two.format("TSC_l"),
                    "TSC_u": two.format("TSC_u"),
                    "TSC_ub": one.format("TSC_ub"),
                },
                lambda v: np.minimum.reduce(
                    [v["TSC_l"] - v["TSC_lb"], v["TSC_u"] - v["TSC_l"], v["TSC_ub"] - v["TSC_u"]]
                ),
            ),
            suffix=f"/{p}",
            quantity=f"TSC_lb < TSC_l < TSC_u < TSC_ub, participant {p}",
            note=below,
            target=(1e-12, np.inf),
        ),
    ]


def _largest_step(column: str, numbers: Numbers) -> Possible:
    """Return the check that δ_Pr is at most what (2.3) can move P_r by in one step, at either end of its range."""
    start = "pilot" if column == "pilot" else "table_2.1"
    id = f"{start}/delta_P_r" + ("" if column == "pilot" else f"/{column}")
    most = Formula(
        "(1 − a_pr)(P_r_max − P_r_min)",
        _ids(("a_pr", "P_r_min", "P_r_max"), column),
        lambda v: (1.0 - v["a_pr"]) * (v["P_r_max"] - v["P_r_min"]),
    )
    limit = most.range(numbers)[0]
    odd = (
        f"Suspicious: with the parameters as printed, (2.3) moves P_r by at most {limit:.2e} in one step."
        if numbers[id].compatible[0] > limit
        else "Depends on the stretch of the fitted curve that was used, which is not printed."
    )
    return Possible(id, Formula("0", {}, lambda v: np.array(0.0)), most, note=odd)


def _captured(numbers: Numbers) -> list:
    checks = []
    for p in PARTICIPANTS:
        ids = {
            f"{t}_{s}": f"table_2.3/TSC_{t}.{s}/{p}" for t in ("l", "u") for s in ("mean", "sd")
        }  # e.g. l_mean
        apart = p != "3"
        checks.append(
            Check(
                "section_2_4_1_3/follow" if apart else "section_2_4_1_3/not_distinguishable",
                Formula(
                    "(μ_u − σ_u) − (μ_l + σ_l)",
                    ids,
                    lambda v: v["u_mean"] - v["u_sd"] - v["l_mean"] - v["l_sd"],
                ),
                suffix=f"/{p}" if apart else "",
                quantity=f"μ ± σ of TSC_l and TSC_u {'apart' if apart else 'overlap'}, participant {p}",
                target=(0.0, np.inf) if apart else (-np.inf, 0.0),
            )
        )
        upper, limit = numbers[f"table_2.3/TSC_u.mean/{p}"], numbers[f"table_2.1/TSC_ub/{p}"]
        above = (
            f" It lies above TSC_ub = {limit.printed} of Table 2.1, so that Theorem 1 does not cover this participant's "
            "own switching (its condition is sufficient, not necessary)."
            if upper.value > limit.value
            else ""
        )
        for name in ("TSC_l.mean", "TSC_l.sd", "TSC_u.mean", "TSC_u.sd"):
            checks.append(
                Remark(
                    f"table_2.3/{name}/{p}",
                    "Captured from switches that are not printed." + (above if name == "TSC_u.mean" else ""),
                )
            )
    sds = {f"{t}{p}": f"table_2.3/TSC_{t}.sd/{p}" for t in ("l", "u") for p in PARTICIPANTS}
    alone = "; ".join(
        f"for TSC_{t} alone it is participant {max(PARTICIPANTS, key=lambda p: numbers[sds[f'{t}{p}']].value)}"
        for t in ("l", "u")
    )
    checks.append(
        Check(
            "section_2_4_1_3/higher_sd",
            Formula(
                "σ_l + σ_u of participant 3 less the greatest of the others",
                sds,
                lambda v: v["l3"] + v["u3"] - np.maximum.reduce([v[f"l{p}"] + v[f"u{p}"] for p in "1245"]),
            ),
            target=(1e-12, np.inf),
            note=f"Largest for both thresholds together; {alone}.",
        )
    )
    return checks


def _pilot(numbers: Numbers) -> list:
    f = column_formulas("pilot")
    low, high = (f[name].range(numbers) for name in ("TSC_lb", "TSC_ub"))
    odd = (
        f"The pilot's own numbers give TSC_ub = {high[0]:.3f} by (2.10), from {high[1]:.3f} to {high[2]:.3f} within rounding, "
        f"and TSC_lb = {low[0]:.3f}."
    )
    over = "Suspicious: above the limit under which Theorem 1 guarantees switching. "
    checks = [
        _largest_step("pilot", numbers),
        Check("pilot/b_r", f["b_r"]),
        Check("pilot/b_pr", f["b_pr"]),
        Check("claim/remark_3/delta_tsc_of_the_pilot_operator", f["delta_TSC"]),
    ]
    for name in ("TSC_l_0", "TSC_u_0", "TSC_ld", "TSC_ud"):
        value = numbers[f"section_2_5/{name}"].value
        checks.append(
            Remark(
                f"section_2_5/{name}",
                (over if value > high[2] else "Chosen by the author. ") + odd,
            )
        )
    return checks


def model_checks(numbers: Numbers) -> list:
    """
    Return the checks of Tables 2.1-2.3 and of the pilot operator.

    Parameters
    ----------
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    """
    checks = [check for p in PARTICIPANTS for check in _participant(p, numbers)]
    for p in PARTICIPANTS:
        checks.append(_largest_step(p, numbers))
        for name in (*PERFORMANCE, "a_r", "beta", "a_pr", "delta_P_h"):
            why = (
                "Depends on the stretch of the fitted curve that was used, which is not printed."
                if name.startswith("delta")
                else "Identified from a session that is not printed."
            )
            checks.append(Remark(f"table_2.1/{name}/{p}", why))
        checks += [
            Remark(f"table_2.2/{name}/{p}", "Chosen by the author (Algorithm 1).")
            for name in ("TSC_l", "TSC_u")
        ]
    return checks + _captured(numbers) + _pilot(numbers)
