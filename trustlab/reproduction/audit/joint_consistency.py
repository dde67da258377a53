"""Whether one set of parameters can give a participant's limits and bounds (Tables 2.1, 2.2)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from trustlab.reproduction.audit.catalogue import PARTICIPANTS
from trustlab.reproduction.audit.check import NOTHING, Numbers, Row, listing, row_about
from trustlab.reproduction.audit.equations import (
    LIMIT_INPUTS,
    PERFORMANCE,
    bounds,
    limits,
)
from trustlab.reproduction.audit.remarks import related

LIMITS = ("TSC_lb", "TSC_ub", "b_pr")
BOUNDS = ("P_rl", "P_ru", "r_l", "r_u")
# Cap on a misfit, in half units; also the misfit of an output that cannot be computed.
FARTHEST = 1e3


@dataclass(frozen=True)
class JointCheck:
    """
    Several printed outputs that should come from one set of parameters.

    `inputs` and `outputs` map symbols to ids; each function of `readings` computes all outputs from
    arrays of inputs, and one of them is enough.
    """

    numbers: Numbers
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    readings: tuple[Callable[[dict], dict], ...]

    def at_printed(self) -> dict[str, np.ndarray]:
        """Return the inputs as printed."""
        return {name: np.asarray(self.numbers[id].value) for name, id in self.inputs.items()}

    def misfit(self, computed: Mapping[str, np.ndarray], names: tuple[str, ...] = ()) -> np.ndarray:
        """Return by how many half units the worst output lies beyond its rounding, or 0."""
        worst = np.asarray(0.0)
        for name in names or self.outputs:
            number = self.numbers[self.outputs[name]]
            miss = np.maximum(np.abs(computed[name] - number.value) / number.half - 1.0, 0.0)
            worst = np.maximum(
                worst, np.where(np.isnan(miss), FARTHEST, np.minimum(miss, FARTHEST))
            )
        return worst

    def least_misfit(self, **fixed: float) -> float:
        """
        Search the box of rounding, but for `fixed` inputs, for the parameters that miss least.
        """
        least = FARTHEST
        for compute in self.readings:
            least = min(least, self._search(compute, fixed))
            if least == 0.0:
                break
        return least

    def _search(self, compute: Callable[[dict], dict], fixed: Mapping[str, float]) -> float:
        from scipy.optimize import differential_evolution

        names = [name for name in self.inputs if name not in fixed]
        middle = np.array([self.numbers[self.inputs[name]].value for name in names])
        half = np.array([self.numbers[self.inputs[name]].half for name in names])

        def miss(point: np.ndarray) -> np.ndarray:
            values = dict(zip(names, middle[:, None] + half[:, None] * point, strict=True))
            values |= {name: np.full(point.shape[1], value) for name, value in fixed.items()}
            return self.misfit(compute(values))

        if miss(np.zeros((len(names), 1))).item() == 0.0:
            return 0.0
        # A global search: the misfit has steps, as dwell times are whole numbers, and is flat where
        # all outputs fit.
        result = differential_evolution(
            miss,
            [(-1.0, 1.0)] * len(names),
            rng=0,
            maxiter=300,
            popsize=12,
            tol=1e-6,
            polish=False,
            vectorized=True,
            updating="deferred",
            callback=lambda x, convergence: miss(x[:, None]).item() == 0.0,
        )
        return float(result.fun)

    def row(self, explain: Callable[["JointCheck"], str]) -> Row:
        """Return the verdict; `explain` says what would give the outputs where they do not fit."""
        names, miss = ", ".join(self.outputs), self.least_misfit()
        verdict = "within rounding" if miss == 0.0 else "differs" if miss > 1.0 else "not checkable"
        reason = f"{names} can all come from one set of parameters that round as printed."
        if miss > 0.0:
            reason = (
                f"{'' if verdict == 'differs' else 'Suspicious: '}{names} cannot all come from "
                "one set of parameters that round as printed; the nearest found still miss one "
                f"of them by {miss:.2g} half units beyond its rounding. {explain(self)}"
            )
        return self.described(verdict, reason)

    def described(self, verdict: str, reason: str) -> Row:
        """Return a row with this verdict under the id of the second output."""
        _, anchor, *_ = self.outputs.values()
        names = ", ".join(self.outputs)
        formula, inputs = f"{names} from one set of parameters", listing(self.inputs, self.numbers)
        id, quantity = f"{anchor}/column", f"{names} at once"
        printed = ", ".join(self.numbers[id].printed for id in self.outputs.values())
        number = self.numbers[anchor]
        return row_about(number, verdict, reason, NOTHING, formula, inputs, id, quantity, printed)


def _limit_row(numbers: Numbers, p: str) -> Row:
    inputs = {name: f"table_2.1/{name}/{p}" for name in LIMIT_INPUTS}
    outputs = {name: f"table_2.1/{name}/{p}" for name in LIMITS}
    gain = numbers[outputs["b_pr"]].value
    with_gain = (lambda v: limits(v | {"b_pr": gain}), limits)  # b_pr as printed, then by (2.3)
    check = JointCheck(numbers, inputs, outputs, with_gain)
    if related(f"table_2.1/TSC_ub/{p}", numbers).row(numbers).verdict == "differs":
        return check.described("not checkable", "TSC_ub alone does not follow; see its own row.")
    return check.row(_finer_rate)


def _finer_rate(check: JointCheck) -> str:
    """Say which a_pr with one more digit gives both limits, if one does."""
    rate, (compute, _) = check.numbers[check.inputs["a_pr"]], check.readings
    for k in sorted(range(-5, 6), key=abs):
        a_pr = rate.value + k * 10.0 ** -(rate.decimals + 1)
        computed = compute(check.at_printed() | {"a_pr": np.asarray(a_pr)})
        if check.misfit(computed, ("TSC_lb", "TSC_ub")) == 0.0:
            return (
                f"Both limits follow from a_pr = {a_pr:.{rate.decimals + 1}f} (printed: "
                f"{rate.printed}), from which (2.3) gives b_pr = {float(computed['b_pr']):.2g}."
            )
    return ""


def _bound_row(numbers: Numbers, p: str, limits_fit: bool) -> Row:
    """Return the row of Table 2.2, with the limits of Table 2.1 where these fit by themselves."""
    inputs = {name: f"table_2.1/{name}/{p}" for name in (*PERFORMANCE, "a_pr", "a_r", "delta_TSC")}
    inputs |= {name: f"table_2.2/{name}/{p}" for name in ("TSC_l", "TSC_u")}
    outputs = {name: f"table_2.2/{name}/{p}" for name in BOUNDS}
    if limits_fit:
        inputs["delta_P_h"] = f"table_2.1/delta_P_h/{p}"
        outputs |= {name: f"table_2.1/{name}/{p}" for name in LIMITS}
    gain = numbers[f"table_2.1/b_pr/{p}"].value

    def compute(v: dict, rise_from_gain: bool) -> dict:
        with_gain = v | {"b_pr": gain}
        computed = bounds(with_gain if rise_from_gain else v)
        return computed | limits(with_gain) if limits_fit else computed

    # c of (2.20) as it is, then as b_pr P_h/(1 − a_pr) with b_pr as printed.
    readings = (lambda v: compute(v, False)), (lambda v: compute(v, True))
    return JointCheck(numbers, inputs, outputs, readings).row(_other_thresholds)


def _other_thresholds(check: JointCheck) -> str:
    """Say which thresholds, of two decimals, give the column, if any do."""
    point, grid = check.at_printed(), np.arange(-100, 101) / 100.0
    # P_rl depends on TSC_l alone and P_ru on TSC_u alone, so that few pairs are left to search.
    low = grid[check.misfit(bounds(point | {"TSC_l": grid}), ("P_rl",)) == 0.0]
    high = grid[check.misfit(bounds(point | {"TSC_u": grid}), ("P_ru",)) == 0.0]
    pairs = [(lower, upper) for lower in low.tolist() for upper in high.tolist() if lower < upper]

    def away(pair: tuple[float, float]) -> float:
        thresholds = dict(zip(("TSC_l", "TSC_u"), map(np.asarray, pair), strict=True))
        return float(check.misfit(bounds(point | thresholds), BOUNDS))

    first = JointCheck(check.numbers, check.inputs, check.outputs, check.readings[:1])
    for lower, upper in sorted(pairs, key=away):
        if first.least_misfit(TSC_l=lower, TSC_u=upper) == 0.0:
            return (
                "They follow, within the rounding of the other parameters, from TSC_l = "
                f"{lower:.2f} and TSC_u = {upper:.2f}: probably the thresholds printed are not "
                "those the column was computed from."
            )
    return ""


def joint_rows(numbers: Numbers) -> list[Row]:
    """Return whether limits and bounds fit together, two rows for every participant."""
    rows = []
    for p in PARTICIPANTS:
        limit_row = _limit_row(numbers, p)
        rows += [limit_row, _bound_row(numbers, p, limit_row.verdict == "within rounding")]
    return rows
