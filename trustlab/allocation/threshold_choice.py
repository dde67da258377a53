"""Choosing thresholds, Algorithm 1 as an optimisation."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from trustlab.allocation.cycle.invariant_bounds import InvariantBounds, invariant_bounds
from trustlab.allocation.cycle.limit_cycle import LimitCycle, limit_cycle
from trustlab.allocation.cycle.phases import resampled, watched
from trustlab.allocation.decision.posterior_choice import (
    PosteriorChoice,
    check_objective,
    choose_under_posterior,
    objective_of,
)
from trustlab.allocation.decision.steady import survey
from trustlab.allocation.limits import ThresholdLimits, check_thresholds, threshold_limits
from trustlab.identification.posterior.result import Posterior
from trustlab.identification.result import FitResult
from trustlab.models.checks import finite_number, flag, of_class, open_unit, warn, whole_number
from trustlab.models.display import Result, axes_or_new
from trustlab.models.tsc import TscModel


@dataclass(frozen=True, eq=False, repr=False)
class ThresholdChoice(Result):
    """
    Chosen thresholds, the motion that they lead to, and the alternatives.

    Parameters
    ----------
    lower, upper : float
        TSC_l and TSC_u.
    cycle : LimitCycle
        The steady motion they lead to.
    bounds : InvariantBounds
        Bounds for every trajectory under them.
    limits : ThresholdLimits
        TSC_lb and TSC_ub that the search kept to, at the `delta_p_h` given (0 if none was);
        `.delta_p_h` says which.
    encloses_beta : bool
        Whether the steady utilization encloses β.
    message : str
        How the choice was made, and where it lies relative to the limits at the δ_Ph that the model
        itself gives.
    candidates : pandas.DataFrame
        All pairs that were tried: lower, upper, r_low, r_high, mean_r, p_r_high, mean_p_r,
        encloses_beta, on_front.
    model : TscModel
        The model.
    """

    lower: float
    upper: float
    cycle: LimitCycle
    bounds: InvariantBounds
    limits: ThresholdLimits
    encloses_beta: bool
    message: str
    candidates: pd.DataFrame
    model: TscModel

    @property
    def model_limits(self) -> ThresholdLimits:
        """`threshold_limits(model)`: TSC_lb and TSC_ub at the model's own δ_Ph, narrower."""
        return threshold_limits(self.model)

    def front(self) -> pd.DataFrame:
        """Return the Pareto front: pairs beaten by no pair in performance and utilization."""
        return self.candidates[self.candidates["on_front"]].sort_values("mean_r", ignore_index=True)

    @property
    def title(self) -> str:
        """The pair."""
        return f"TSC_l = {self.lower:.4f}, TSC_u = {self.upper:.4f}"

    def table(self) -> pd.DataFrame:
        """Return the ranges of the steady motion and the bounds for every trajectory."""
        cycle = self.cycle.table()
        bounds = self.bounds.table()
        return cycle.assign(bound_low=bounds["low"], bound_high=bounds["high"])

    def plot(self):
        """
        Plot mean performance and utilization over feasible pairs, the choice, and the front.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (3,)
        """
        axes = axes_or_new(columns=3, figsize=(10, 3.4))
        titles = {"mean_p_r": "mean robot performance", "mean_r": "mean utilization r"}
        for axis, (name, title) in zip(axes, titles.items(), strict=False):
            points = axis.scatter(
                "lower",
                "upper",
                c=name,
                data=self.candidates,
                s=14,
                marker="s",
                label="feasible pair",
            )
            axis.plot(self.lower, self.upper, "k*", ms=12, label="choice")
            axis.set(
                xlabel="lower threshold $TSC_l$", ylabel="upper threshold $TSC_u$", title=title
            )
            axis.legend(loc="lower right", fontsize="small")
            axis.figure.colorbar(points, ax=axis)
        trade_off = axes[2]
        means = ("mean_r", "mean_p_r")
        trade_off.plot(
            *means, "-", data=self.front(), color="C1", lw=1.5, zorder=4, label="Pareto front"
        )
        style = {"s": 24, "color": "0.65", "lw": 0, "zorder": 3}
        trade_off.scatter(*means, data=self.candidates, label="feasible pairs", **style)
        trade_off.plot(self.cycle.mean_r, self.cycle.mean_p_r, "k*", ms=12, label="choice")
        trade_off.axvline(self.model.human.beta, color="k", lw=0.8, ls=":", label="β")
        trade_off.set(xlabel="mean utilization", ylabel="mean robot performance", title="trade-off")
        trade_off.legend(fontsize="small")
        return axes


def choose_thresholds(
    tsc: TscModel | FitResult | Posterior,
    delta_p_h: float = 0.0,
    margin: float = 0.1,
    points: int | None = None,
    objective: str | float = "peak",
    confidence: float = 0.95,
    enclose_beta: bool = True,
) -> ThresholdChoice | PosteriorChoice:
    """
    Choose thresholds by Algorithm 1: utilization encloses β, performance is near its best.

    All pairs of a grid within the limits, less a margin, are followed to their steady cycle. Among
    those whose range of utilization encloses β the one with the greatest highest performance is
    taken, ties by mean performance.

    Parameters
    ----------
    tsc : TscModel, FitResult or Posterior
        The model, or a fit of one by `fit_tsc`: where its `success` is False, a warning and the
        choice give its `message`. Of a posterior (`sample_posterior`) every draw is followed, and
        pairs are offered that do what is asked with a probability of `confidence`.
    delta_p_h : float
        δ_Ph for the limits that the search keeps to. 0 takes them as TSC settles; whether a pair
        keeps switching is then seen from its cycle. This is not the default of `threshold_limits`,
        see Notes.
    margin : float
        Distance to keep from either limit, as a share of TSC_ub − TSC_lb, in (0, 0.5); of no effect
        for a posterior, whose probabilities take its place.
    points : int, optional
        Grid points along each threshold, 4 to 500; 24, and 14 for a posterior, when not given.
    objective : {"peak", "mean"} or float
        What is to be great among the pairs that enclose β: "peak", the highest robot performance,
        as printed; "mean", mean robot performance; or a weight w in [0, 1] for w · robot
        performance + (1 − w) · human performance, both mean and in points of (2.39). For the
        printed people the peak costs 9 to 27 points of mean robot performance, and puts β at the
        edge of the range.
    confidence : float
        For a posterior: the probability that a pair must have to be offered, in (0, 1).
    enclose_beta : bool
        For a posterior: whether the steady utilization must enclose β.

    Returns
    -------
    ThresholdChoice or, for a posterior, PosteriorChoice

    Raises
    ------
    ValueError
        If an argument is out of range, or the limits leave no room (Remark 4: says what to change).

    Notes
    -----
    `threshold_limits(tsc)` takes δ_Ph from the model unless told otherwise. Its limits are narrower
    than those searched here at δ_Ph = 0, or there are none at all, and for all printed models the
    pair chosen here lies outside of them: Theorem 1, which is sufficient and not necessary, then
    does not promise that the rule keeps switching. What the choice rests on is the exact cycle,
    `.cycle`, and the bounds for every trajectory, `.bounds`. `.limits` are the limits searched,
    `.model_limits` those at the model's δ_Ph; `.message` says where the pair lies relative to both.
    To stay within the latter give delta_p_h=threshold_limits(tsc).delta_p_h.

    Examples
    --------
    >>> import trustlab as tl
    >>> choice = tl.choose_thresholds(tl.published_models()["2"])
    >>> round(choice.lower, 3), round(choice.upper, 3)
    (-0.057, 0.439)
    """
    open_unit("confidence", confidence)
    flag("enclose_beta", enclose_beta)
    if isinstance(tsc, Posterior):
        return choose_under_posterior(tsc, confidence, objective, enclose_beta, points or 14)
    check_objective(objective)
    margin = finite_number("margin", margin)
    if not 0.0 < margin < 0.5:
        raise ValueError(f"margin must lie in (0, 0.5), got {margin}")
    points = whole_number("points", 24 if points is None else points, least=4, most=500)
    if isinstance(tsc, FitResult):
        return _chosen_from_fit(tsc, delta_p_h, margin, points, objective)
    return _chosen(tsc, delta_p_h, margin, points, objective)


def _chosen(
    tsc: TscModel, delta_p_h: float, margin: float, points: int, objective: str | float
) -> ThresholdChoice:
    """Return the best pair of a grid for a model."""
    of_class("tsc", tsc, TscModel)
    limits = threshold_limits(tsc, delta_p_h)
    if not limits.feasible:
        check_thresholds(tsc, 0.0, 1.0, limits)
    span = limits.upper - limits.lower
    grid = np.linspace(limits.lower + margin * span, limits.upper - margin * span, points)
    pairs = [(lower, upper) for i, lower in enumerate(grid) for upper in grid[i + 1 :]]
    survey = resampled(tsc)
    cycles = [
        limit_cycle(survey, low, high, starts=1)
        for low, high in watched(pairs, "choose thresholds")
    ]
    names = ["lower", "upper", "r_low", "r_high", "mean_r", "p_r_high", "mean_p_r"]
    rows = [[getattr(cycle, name) for name in names] for cycle in cycles if cycle.exists]
    table = pd.DataFrame(rows, columns=names)
    if table.empty:
        raise ValueError(
            f"under none of the pairs between {grid[0]:.4f} and {grid[-1]:.4f} does control keep "
            "changing hands"
        )
    table["encloses_beta"] = (table["r_low"] <= tsc.human.beta) & (
        tsc.human.beta <= table["r_high"]
    )
    table["on_front"] = _front(table["mean_r"].to_numpy(), table["mean_p_r"].to_numpy())
    inside = table[table["encloses_beta"]]
    if not inside.empty:
        best = _best(tsc, inside, objective)
        message = (
            "Utilization encloses β; of all pairs for which it does, this one reaches the "
            f"{REACHED.get(str(objective), 'greatest weighted performance')}."
        )
    else:
        gap = np.maximum(tsc.human.beta - table["r_high"], table["r_low"] - tsc.human.beta)
        best = gap.idxmin()
        message = (
            f"No pair between {grid[0]:.4f} and {grid[-1]:.4f} makes utilization enclose β = "
            f"{tsc.human.beta:g}; this one comes nearest, within {gap[best]:.3f}. Allow a smaller "
            "margin for more."
        )
    lower = float(table.loc[best, "lower"])
    upper = float(table.loc[best, "upper"])
    cycle = limit_cycle(tsc, lower, upper)
    bounds = invariant_bounds(tsc, lower, upper)
    message += _beside_limits(tsc, lower, upper, limits)
    if survey is not tsc:
        message += (
            " Candidates were compared at a longer sample time, as the model's time "
            "constants are very long."
        )
    return ThresholdChoice(
        lower, upper, cycle, bounds, limits, not inside.empty, message, table, tsc
    )


def _chosen_from_fit(
    fit: FitResult, delta_p_h: float, margin: float, points: int, objective: str | float
) -> ThresholdChoice:
    """Return the best pair for a fit's model, with the fit's doubts."""
    model = of_class("tsc", fit.model, TscModel)
    if fit.success:
        return _chosen(model, delta_p_h, margin, points, objective)
    try:
        choice = _chosen(model, delta_p_h, margin, points, objective)
    except ValueError as error:
        # The model is not to be used, so that advice on how to change it would mislead.
        raise ValueError(
            f"the fit is why there are no thresholds, it has success = False: {fit.message} With "
            "posterior = trustlab.sample_posterior(sessions), choose_thresholds(posterior) offers "
            "thresholds with a probability, or says what to record."
        ) from error
    doubt = f"Thresholds of a model whose fit has success = False: {fit.message}"
    warn(doubt)
    return replace(choice, message=f"{doubt} {choice.message}")


REACHED = {"peak": "highest performance", "mean": "greatest mean performance"}


def _best(tsc: TscModel, table: pd.DataFrame, objective: str | float):
    """Return the row of a table of pairs with the greatest objective."""
    if isinstance(objective, str):
        order = ["p_r_high", "mean_p_r"] if objective == "peak" else ["mean_p_r", "p_r_high"]
        return table.sort_values(order, ascending=False, kind="stable").index[0]
    motions = survey([tsc], table[["lower", "upper"]].to_numpy())
    return table.index[int(np.argmax(objective_of(motions, [tsc], objective)[0]))]


def _beside_limits(tsc: TscModel, lower: float, upper: float, limits: ThresholdLimits) -> str:
    """
    Say where a pair lies relative to the limits of the search and to those at the model's own δ_Ph.
    """
    model_limits = threshold_limits(tsc)
    if model_limits.contains(lower, upper):
        return (
            f" Limits searched: {limits}. The pair also keeps those at the model's own δ_Ph: "
            f"{model_limits}."
        )
    return (
        f" Limits searched: {limits}. Theorem 1 does not cover the pair at the model's own δ_Ph: "
        f"{model_limits}. Whether it keeps switching is seen from its cycle, not from the limits."
    )


def _front(cost: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Return the points that no other point beats in both cost and gain."""
    order = np.lexsort((-gain, cost))
    best_before = np.maximum.accumulate(np.r_[-np.inf, gain[order]])[:-1]
    front = np.empty(cost.size, dtype=bool)
    front[order] = gain[order] > best_before
    return front
