"""Whether all limits and bounds of one participant can come from one set of parameters, in Tables 2.1 and 2.2."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from trustlab.reproduction.audit_checks import Numbers, Row
from trustlab.reproduction.audit_model_tables import (
    PARTICIPANTS,
    PERFORMANCE,
    printed_bounds,
    printed_limits,
    robot_gain,
    upper_limit_check,
)

__all__ = ["column_rows"]

LIMITS = ("TSC_lb", "TSC_ub", "b_pr")
BOUNDS = ("P_rl", "P_ru", "r_l", "r_u")
FITS = "within rounding"


def _misfit(numbers: Numbers, outputs: Mapping[str, str], found: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return by how many half units of its last digit the worst output misses; 0 where all round as printed."""
    worst = 0.0
    for name, id in outputs.items():
        number = numbers[id]
        miss = np.maximum(np.abs(found[name] - number.value) / number.half - 1.0, 0.0)
        worst = np.maximum(worst, np.where(np.isnan(miss), 1e3, np.minimum(miss, 1e3)))
    return worst


def _nearest(
    numbers: Numbers,
    inputs: Mapping[str, str],
    outputs: Mapping[str, str],
    compute: Callable[[dict], dict],
    fixed: Mapping[str, float],
) -> float:
    """Search the box of rounding for the parameters that miss least; return the least miss, in half units."""
    from scipy.optimize import differential_evolution

    names = [name for name in inputs if name not in fixed]
    middle = np.array([numbers[inputs[name]].value for name in names])
    half = np.array([numbers[inputs[name]].half for name in names])

    def miss(point: np.ndarray) -> np.ndarray:
        values = dict(zip(names, middle[:, None] + half[:, None] * point, strict=True))
        values |= {name: np.full(point.shape[1], value) for name, value in fixed.items()}
        return _misfit(numbers, outputs, compute(values))

    if miss(np.zeros((len(names), 1)))[0] == 0.0:
        return 0.0
    result = differential_evolution(
        lambda z: miss(z.reshape(len(names), -1)) if z.ndim == 2 else float(miss(z[:, None])[0]),
        [(-1.0, 1.0)] * len(names),
        rng=0,
        maxiter=300,
        popsize=12,
        tol=1e-6,
        polish=False,
        vectorized=True,
        updating="deferred",
        callback=lambda x, convergence: bool(miss(x[:, None])[0] == 0.0),
    )
    return float(result.fun)


def _limits(v: dict) -> dict[str, np.ndarray]:
    lower, upper = printed_limits(v)
    return {"TSC_lb": lower, "TSC_ub": upper, "b_pr": robot_gain(v)}


def _row(numbers: Numbers, p: str, outputs: Mapping[str, str], inputs, miss: float, odd: str) -> Row:
    names = ", ".join(outputs)
    anchor = numbers[list(outputs.values())[1]]
    if miss == 0.0:
        verdict, reason = FITS, f"{names} can all come from one set of parameters that round as printed."
    else:
        verdict = "differs" if miss > 1.0 else "not checkable"
        reason = (
            f"{'' if verdict == 'differs' else 'Suspicious: '}{names} cannot all come from one set of parameters that round as "
            f"printed; the nearest found still miss one of them by {miss:.2g} half units beyond its rounding. {odd}"
        ).strip()
    return Row(
        f"{anchor.id}/column",
        anchor.where,
        f"{names} at once",
        ", ".join(numbers[id].printed for id in outputs.values()),
        np.nan,
        np.nan,
        np.nan,
        verdict,
        reason,
        f"{names} from one set of parameters",
        "; ".join(f"{name} = {numbers[id].printed} ({id})" for name, id in inputs.items()),
    )


def _limit_row(numbers: Numbers, p: str) -> Row:
    inputs = {name: f"table_2.1/{name}/{p}" for name in (*PERFORMANCE, "a_pr", "delta_P_h")}
    outputs = {name: f"table_2.1/{name}/{p}" for name in LIMITS}
    used = {"b_pr": numbers[outputs["b_pr"]].value}
    if upper_limit_check(p).row(numbers).verdict == "differs":
        row = _row(numbers, p, outputs, inputs, 0.0, "")
        return replace(row, verdict="not checkable", reason="TSC_ub alone does not follow; see its own row.")
    miss = min(_nearest(numbers, inputs, outputs, _limits, fixed) for fixed in (used, {}))
    return _row(numbers, p, outputs, inputs, miss, _finer_rate(numbers, inputs, outputs, used))


def _finer_rate(numbers: Numbers, inputs, outputs, used) -> str:
    """Say which a_pr with one more digit gives both limits, if one does."""
    rate = numbers[inputs["a_pr"]]
    middle = {name: np.asarray(numbers[id].value) for name, id in inputs.items()} | used
    limits = {name: outputs[name] for name in ("TSC_lb", "TSC_ub")}
    for k in sorted(range(-5, 6), key=abs):
        a_pr = rate.value + k * 10.0 ** -(rate.decimals + 1)
        found = _limits(middle | {"a_pr": np.asarray(a_pr)})
        if _misfit(numbers, limits, found) == 0.0:
            return (
                f"Both limits follow from a_pr = {a_pr:.{rate.decimals + 1}f} (printed: {rate.printed}), from which (2.3) gives "
                f"b_pr = {float(found['b_pr']):.2g}."
            )
    return ""


def _bound_row(numbers: Numbers, p: str, limits_fit: bool) -> Row:
    inputs = {name: f"table_2.1/{name}/{p}" for name in (*PERFORMANCE, "a_pr", "a_r", "delta_TSC")}
    inputs |= {name: f"table_2.2/{name}/{p}" for name in ("TSC_l", "TSC_u")}
    outputs = {name: f"table_2.2/{name}/{p}" for name in BOUNDS}
    if limits_fit:
        inputs["delta_P_h"] = f"table_2.1/delta_P_h/{p}"
        outputs |= {name: f"table_2.1/{name}/{p}" for name in LIMITS}
    gain = numbers[f"table_2.1/b_pr/{p}"].value
    miss, odd = np.inf, ""
    for compute in _both(gain, limits_fit):
        miss = min(miss, _nearest(numbers, inputs, outputs, compute, {}))
        if miss == 0.0:
            break
    if miss > 0.0:
        odd = _other_thresholds(numbers, inputs, outputs, _both(gain, limits_fit)[0])
    return _row(numbers, p, outputs, inputs, miss, odd)


def _both(gain: float, limits_fit: bool) -> tuple[Callable[[dict], dict], ...]:
    """Return the bounds with c of (2.20) as it is, and as b_pr P_h/(1 − a_pr) with b_pr as printed."""

    def compute(v: dict, printed: bool) -> dict:
        with_gain = v | {"b_pr": np.full_like(np.asarray(v["a_pr"], dtype=float), gain)}
        found = printed_bounds(with_gain if printed else v)
        return found | _limits(with_gain) if limits_fit else found

    return (lambda v: compute(v, False)), (lambda v: compute(v, True))


def _other_thresholds(numbers: Numbers, inputs, outputs, compute) -> str:
    """Say which thresholds, of two decimals, give the column, if any do."""
    grid = np.arange(-100, 101) / 100.0
    middle = {name: np.full(grid.size, numbers[id].value) for name, id in inputs.items()}
    low = printed_bounds(middle | {"TSC_l": grid})["P_rl"]
    high = printed_bounds(middle | {"TSC_u": grid})["P_ru"]
    at = {
        name: np.flatnonzero(_misfit(numbers, {name: outputs[name]}, {name: found}) == 0.0)
        for name, found in (("P_rl", low), ("P_ru", high))
    }
    pairs = [(float(grid[i]), float(grid[j])) for i in at["P_rl"] for j in at["P_ru"] if grid[i] < grid[j]]
    point = {name: np.asarray(numbers[id].value) for name, id in inputs.items()}
    bounds = {name: outputs[name] for name in BOUNDS}

    def away(pair: tuple[float, float]) -> float:
        found = printed_bounds(point | {"TSC_l": np.asarray(pair[0]), "TSC_u": np.asarray(pair[1])})
        return float(_misfit(numbers, bounds, found))

    for lower, upper in sorted(pairs, key=away):
        if _nearest(numbers, inputs, outputs, compute, {"TSC_l": lower, "TSC_u": upper}) == 0.0:
            return (
                f"They follow, within the rounding of the other parameters, from TSC_l = {lower:.2f} and TSC_u = {upper:.2f}: "
                "probably the thresholds printed are not those the column was computed from."
            )
    return ""


def column_rows(numbers: Numbers) -> list[Row]:
    """
    Return, for every participant, whether the limits of Table 2.1 and the bounds of Table 2.2 fit together.

    Parameters
    ----------
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    """
    rows = []
    for p in PARTICIPANTS:
        limits = _limit_row(numbers, p)
        rows += [limits, _bound_row(numbers, p, limits.verdict == FITS)]
    return rows
