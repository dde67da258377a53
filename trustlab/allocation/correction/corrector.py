"""Correcting an operator's thresholds step by step, Section 2.5, by an engine chosen by name."""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import Any

from trustlab.allocation.correction.casadi_engine import CasadiEngine
from trustlab.allocation.correction.exact import ExactEngine
from trustlab.allocation.correction.incentive import incentive_box, within_range
from trustlab.allocation.correction.plan import CorrectionPlan
from trustlab.allocation.limits import threshold_limits
from trustlab.allocation.steady import limit_cycle
from trustlab.models.checks import (
    between,
    in_order,
    of_class,
    one_of,
    positive,
    shown,
    warn,
    whole_number,
)
from trustlab.models.tsc import TscModel

ENGINES: dict[str, Any] = {"exact": ExactEngine, "casadi": CasadiEngine}


class TargetWarning(UserWarning):
    """Target thresholds lie outside the limits of Theorem 1, yet simulations keep switching."""


class ThresholdCorrector:
    """
    Model predictive control of both thresholds, (2.40)-(2.44).

    At each step the corrections of the next N steps are chosen that minimize Σ (TSC_u − TSC_ud)² +
    (TSC_l − TSC_ld)², within what the operator can be expected to accept (2.42), the thresholds
    staying between where they are and their targets; the first correction is applied.

    Parameters
    ----------
    tsc : TscModel
        The operator's and the robot's model.
    target : (float, float)
        TSC_ld and TSC_ud.
    c_b : float
        Largest correction per step (2.42); positive.
    horizon : int
        N, how many steps to look ahead; from 1 to a million.
    engine : {"exact", "casadi"}
        "exact": branch and bound over the mode sequences, with a proved lower bound of the cost.
        "casadi": multiple shooting, for your own costs and constraints.
    incentive : callable, optional
        The bounds of correction in place of (2.42): takes r, p_r, c_b, p_min, p_max and returns the
        least and the greatest correction, in [−c_b, 0] and [0, c_b]. `incentive_box` when not
        given. The exact engine compiles your function into its search, which takes some seconds per
        corrector.
    **options : object
        Options of the engine, see `ExactEngine` and `CasadiEngine`.

    Raises
    ------
    ValueError
        If an argument is out of range, an option is unknown, or the rule does not keep switching
        under the target.

    Warns
    -----
    TargetWarning
        If the target lies outside the limits of Theorem 1, but its exact cycle exists from every
        start: the theorem is sufficient, not necessary, and the thresholds that Section 2.5 prints
        for the pilot operator are such a case.

    Notes
    -----
    That a threshold stays between its value now and its target is a condition beyond (2.42)-(2.44).
    It keeps corrections from moving an operator's thresholds the wrong way, and plans and lower
    bounds of the cost are those of the problem with it. Without it a plan can cost less: a
    threshold that first moves away from its target can bring on a switch which widens the bounds
    (2.42) of all later corrections. For the pilot operator at r = 0.97 and P_r = 0.389 in the
    manual mode, thresholds 0.2149 and 0.645, target (0.29, 0.72), c_b = 0.01 and N = 100, the
    optimum with the condition costs 0.8477, while lowering TSC_u for two steps first costs 0.5998
    in all.

    Examples
    --------
    >>> import trustlab as tl
    >>> model = tl.published_models()["2"]
    >>> corrector = tl.ThresholdCorrector(model, target=(0.05, 0.4), horizon=200)
    >>> step = corrector.step(r=0.7, p_r=0.33, lower=0.0, upper=0.35, mode=1)
    >>> round(step.c_l * 1e6, 3), step.suggestion, step.gap
    (2.409, -1, 0.0)
    """

    def __init__(
        self,
        tsc: TscModel,
        target: tuple[float, float],
        c_b: float = 1e-5,
        horizon: int = 200,
        engine: str = "exact",
        incentive: Callable | None = None,
        **options: Any,
    ):
        self.tsc = of_class("tsc", tsc, TscModel)
        self.target = check_target(tsc, target)
        self.c_b = positive("c_b", c_b)
        self.horizon = whole_number("horizon", horizon, most=1_000_000)
        kind = ENGINES[one_of("engine", engine, ENGINES)]
        unknown = sorted(set(options) - set(kind.options))
        if unknown:
            raise ValueError(
                f"the engine {engine!r} has no option {unknown[0]!r}; it has "
                f"{', '.join(kind.options)}"
            )
        self.incentive = incentive or incentive_box
        self.engine = kind(tsc, *self.target, self.c_b, self.horizon, self.incentive, **options)
        self._range = (tsc.robot.p_min, tsc.robot.p_max)

    def step(
        self, r: float, p_r: float, lower: float, upper: float, mode: int = 1
    ) -> CorrectionPlan:
        """
        Return the correction now, with the whole plan behind it.

        Parameters
        ----------
        r : float
            Utilization now, in [0, 1].
        p_r : float
            Robot performance now, within the model's range up to rounding.
        lower, upper : float
            TSC_l and TSC_u now, lower < upper, in [−1, 1] as TSC is.
        mode : int
            Mode before now: 1 manual, 0 autonomous.

        Returns
        -------
        CorrectionPlan
            With .c_l, .c_u, .suggestion, .cost, .cost_lower_bound, .gap, .status and the predicted
            trajectories.

        Raises
        ------
        ValueError
            If an argument is not a number or out of range.
        """
        began = perf_counter()
        r = between("r", r, 0.0, 1.0)
        p_r = within_range("p_r", p_r, *self._range)
        lower, upper = threshold_pair("threshold", (lower, upper))
        plan = self.engine.solve(r, p_r, lower, upper, check_mode(mode))
        return replace(plan, solve_time=perf_counter() - began)

    def __repr__(self) -> str:
        return (
            f"ThresholdCorrector(target={self.target}, c_b={self.c_b:g}, horizon={self.horizon}, "
            f"engine={self.engine.name!r})"
        )


def check_mode(mode: int) -> int:
    """Return a mode, 1 manual or 0 autonomous, as an int."""
    return whole_number("mode", mode, least=0, most=1)


def check_target(tsc: TscModel, target: tuple[float, float]) -> tuple[float, float]:
    """Return target thresholds if the rule keeps switching under them; warn outside Theorem 1."""
    lower, upper = threshold_pair("target", target)
    limits = threshold_limits(tsc, None)
    if limits.contains(lower, upper):
        return lower, upper
    where = f"target ({lower:g}, {upper:g}) lies outside the limits of Theorem 1, " + (
        str(limits) if limits.feasible else f"for there are {limits}"
    )
    cycle = limit_cycle(tsc, lower, upper)
    if not cycle.always:
        raise ValueError(
            f"{where}, and the rule does not keep switching under it: {cycle.reason}. Choose a "
            "target whose cycle exists (trustlab.limit_cycle), for example with "
            "trustlab.choose_thresholds(tsc)"
            + (", or between the limits" if limits.feasible else "")
        )
    warn(
        f"{where}, so the theorem does not promise that the rule keeps switching; its steady "
        "cycle does exist, from every start (trustlab.limit_cycle)",
        TargetWarning,
    )
    return lower, upper


def threshold_pair(name: str, pair: tuple[float, float]) -> tuple[float, float]:
    """Return two thresholds, lower and upper, as floats in [−1, 1], where TSC lies by (2.2)."""
    try:
        lower, upper = pair
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be two numbers, lower and upper, got {shown(pair)}"
        ) from None
    low = f"the lower {name}"
    high = f"the upper {name}"
    in_order(low, lower, high, upper)
    return between(low, lower, -1.0, 1.0), between(high, upper, -1.0, 1.0)
