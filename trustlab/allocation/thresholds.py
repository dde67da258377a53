"""Choosing thresholds by Algorithm 1: for a model, a fit of one, or a posterior."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.invariant import InvariantBounds, invariant_bounds
from trustlab.allocation.limits import ThresholdLimits, threshold_limits
from trustlab.allocation.ranges import RangeIntervals
from trustlab.allocation.steady import (
    HIGH,
    LOW,
    MEAN,
    P_R,
    LimitCycle,
    R,
    encloses_beta,
    grid_of_pairs,
    limit_cycle,
    points as points_of,
    survey,
)
from trustlab.identification.posterior.density import SHARED, physical
from trustlab.identification.posterior.result import Posterior, tsc_models
from trustlab.identification.result import FitResult
from trustlab.models.checks import (
    between,
    finite_number,
    flag,
    of_class,
    one_of,
    open_unit,
    warn,
    whole_number,
)
from trustlab.models.display import Result, axes_or_new
from trustlab.models.tsc import TscModel

# Draws of a posterior by which pairs are screened, with how much effort (`survey`), and pairs that
# are then followed sample by sample, with all draws, until one keeps its promise.
SCREENED = 300
EFFORT = 3e6
FOLLOWED = 6

# How many times as much data are considered where no pair is probable enough.
LONGER = (2, 4, 8, 16)

OBJECTIVES = {"peak": "highest robot performance", "mean": "greatest mean robot performance"}


@dataclass(frozen=True, eq=False, repr=False)
class ThresholdChoice(Result):
    """
    Chosen thresholds, or the reason why none are offered.

    Parameters
    ----------
    lower, upper : float
        TSC_l and TSC_u; where none are offered, those of the pair that comes nearest, or NaN where
        Theorem 1 leaves no room.
    probability : float
        Probability that the rule keeps switching and, where asked, that utilization encloses β,
        from β and from rest: share of all draws of a posterior, each followed sample by sample; 1
        or 0 for exactly this model; NaN for a fit, whose errors it leaves out, and where there is
        no pair. For every other start there is `.bounds`.
    encloses_beta : bool
        Whether the steady utilization encloses β; of a posterior, with the confidence asked for.
    message : str
        What is offered, how sure it is, and where it lies beside the limits of Theorem 1.
    reason : str
        Why nothing is offered, and what would help; empty where thresholds are offered.
    limits : ThresholdLimits
        TSC_lb and TSC_ub that the search kept to, medians over a posterior's draws.
    candidates : pandas.DataFrame
        All pairs that were tried: lower, upper, p_switches, p_encloses, and means over the models
        that keep switching of mean_r, p_r_high, mean_p_r and objective; on_front.
    tsc : TscModel or Posterior
        What they were chosen for; of a fit its model.
    """

    lower: float
    upper: float
    probability: float
    encloses_beta: bool
    message: str
    reason: str
    limits: ThresholdLimits
    candidates: pd.DataFrame
    tsc: TscModel | Posterior

    how_to_get = "trustlab.choose_thresholds(tsc) returns one"

    @property
    def offered(self) -> bool:
        """Whether thresholds are offered."""
        return not self.reason

    @cached_property
    def cycle(self) -> LimitCycle | RangeIntervals:
        """The steady motion that the thresholds lead to: `limit_cycle`."""
        return limit_cycle(self.tsc, self.lower, self.upper)

    @cached_property
    def bounds(self) -> InvariantBounds | RangeIntervals:
        """Bounds for every trajectory under the thresholds: `invariant_bounds`."""
        return invariant_bounds(self.tsc, self.lower, self.upper)

    @property
    def title(self) -> str:
        """Whether thresholds are offered."""
        return "Thresholds" if self.offered else "No thresholds offered"

    def front(self) -> pd.DataFrame:
        """Return the Pareto front: pairs beaten by no pair in performance and utilization."""
        return self.candidates[self.candidates["on_front"]].sort_values("mean_r", ignore_index=True)

    def table(self) -> pd.DataFrame:
        """Return ranges and means of the motion that the thresholds lead to; empty without any."""
        return self.candidates if np.isnan(self.lower) else self.cycle.table()

    def plot(self):
        """
        Plot probability and mean performance of every pair, and the choice.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (2,)
        """
        axes = axes_or_new(columns=2, sharey=True, figsize=(7.8, 3.8))
        panels = {
            "p_encloses": "probability of switching around β",
            "mean_p_r": "mean robot performance",
        }
        for axis, (name, title) in zip(axes, panels.items(), strict=True):
            ends = (0.0, 1.0) if name == "p_encloses" else (None, None)
            style = {"s": 14, "marker": "s", "vmin": ends[0], "vmax": ends[1]}
            shown = axis.scatter("lower", "upper", c=name, data=self.candidates, **style)
            axis.figure.colorbar(shown, ax=axis)
            axis.plot(self.lower, self.upper, "*", ms=14, color="C1", mec="k")
            words = "choice" if self.offered else "nearest"
            place = {"xytext": (0, 9), "textcoords": "offset points", "ha": "center"}
            axis.annotate(words, (self.lower, self.upper), **place)
            axis.set(xlabel="lower threshold $TSC_l$", title=title)
            axis.margins(0.08)
        axes[0].set_ylabel("upper threshold $TSC_u$")
        return axes


def choose_thresholds(
    tsc: TscModel | FitResult | Posterior,
    delta_p_h: float = 0.0,
    margin: float | None = None,
    points: int | None = None,
    objective: str | float = "peak",
    confidence: float | None = None,
    enclose_beta: bool = True,
) -> ThresholdChoice:
    """
    Choose thresholds by Algorithm 1: utilization encloses β, performance is near its best.

    All pairs of a grid within the limits, less a margin, are followed to their steady motion. Among
    those that keep switching around β the one with the greatest objective is taken; of a posterior,
    among those that do with a probability of `confidence`, by expectation.

    Parameters
    ----------
    tsc : TscModel, FitResult or Posterior
        The model; a fit of one by `fit_tsc`; or a posterior (`sample_posterior`), which alone gives
        a probability.
    delta_p_h : float
        δ_Ph of the limits of Theorem 1 that the search keeps to. 0 takes them as TSC settles;
        whether a pair keeps switching is then seen from its motion.
    margin : float, optional
        Distance to keep from either limit, as a share of TSC_ub − TSC_lb, in (0, 0.5); 0.1, and
        0.03 for a posterior, whose probability says what is safe, when not given.
    points : int, optional
        Grid points along each threshold, 4 to 500; 24, and 14 for a posterior, when not given.
    objective : {"peak", "mean"} or float
        What is to be great: "peak", the highest robot performance, as printed, ties by the mean; a
        weight w in [0, 1] for w · robot performance + (1 − w) · human performance, both mean and in
        points of (2.39); "mean" is w = 1. For the printed operators the peak costs 9 to 27 points
        of mean robot performance, and puts β at the edge of the range.
    confidence : float, optional
        For a posterior alone: the probability that a pair must have to be offered, in (0, 1); 0.95
        when not given.
    enclose_beta : bool
        Whether the steady utilization must enclose β; if not, the rule must keep switching.

    Returns
    -------
    ThresholdChoice

    Raises
    ------
    ValueError
        If an argument is out of range, or does nothing.

    Warns
    -----
    UserWarning
        If nothing is offered, or `success` of a fit is False; with the message.

    Notes
    -----
    Theorem 1 is sufficient and not necessary. At the δ_Ph that a model itself gives, `step_bounds`,
    its limits are narrower than at 0, or there are none, and for all printed models the pair chosen
    here lies outside of them; the message says so. To stay within them give that δ_Ph.

    Examples
    --------
    >>> import trustlab as tl
    >>> choice = tl.choose_thresholds(tl.published_models()["2"])
    >>> round(choice.lower, 3), round(choice.upper, 3), choice.probability
    (-0.057, 0.439, 1.0)
    """
    of_posterior = isinstance(tsc, Posterior)
    share = finite_number("margin", (0.03 if of_posterior else 0.1) if margin is None else margin)
    if not 0.0 < share < 0.5:
        raise ValueError(f"margin must lie in (0, 0.5), got {margin}")
    count = (14 if of_posterior else 24) if points is None else points
    count = whole_number("points", count, least=4, most=500)
    if not isinstance(objective, str):
        between("objective", objective, 0.0, 1.0)
    else:
        one_of("objective", objective, OBJECTIVES, "a weight in [0, 1]")
    flag("enclose_beta", enclose_beta)
    if confidence is not None and not of_posterior:
        raise ValueError(
            f"confidence = {confidence} would do nothing: of one model a pair keeps switching or "
            "does not; trustlab.sample_posterior gives a probability"
        )
    asked = 0.95 if confidence is None else open_unit("confidence", confidence)
    source: Any = tsc.model if isinstance(tsc, FitResult) else tsc
    models = source.models if isinstance(source, Posterior) else [of_class("tsc", source, TscModel)]
    limits = _limits_of(models, delta_p_h)
    if limits.feasible:
        span = limits.upper - limits.lower
        ends = limits.lower + share * span, limits.upper - share * span
        search = _Search(models, grid_of_pairs(*ends, count), objective, asked, enclose_beta)
        choice = _chosen(search, limits, tsc, source)
    else:
        reason = _no_room(models, limits)
        nothing = pd.DataFrame(columns=_Search.COLUMNS, dtype=float).astype({"on_front": bool})
        message = f"No thresholds: {reason}"
        values = np.nan, np.nan, np.nan, False, message, reason, limits, nothing
        choice = ThresholdChoice(*values, tsc=source)
    doubtful = isinstance(tsc, FitResult) and not tsc.success
    if isinstance(tsc, FitResult):
        choice = _of_fit(tsc, choice)
    if choice.reason or doubtful:
        warn(choice.message)
    return choice


def _chosen(
    search: "_Search",
    limits: ThresholdLimits,
    tsc: TscModel | FitResult | Posterior,
    source: TscModel | Posterior,
) -> ThresholdChoice:
    """Return the best pair of a search, or why it is not offered."""
    (lower, upper), holds, around = search.choose()
    probability = float(holds.mean())
    reason = ""
    if probability < search.asked:
        reason = search.reason(probability)
        reason += _what_would_help(tsc, search) if isinstance(tsc, Posterior) else ""
    return ThresholdChoice(
        lower=float(lower),
        upper=float(upper),
        probability=probability,
        encloses_beta=bool(around.mean() >= search.asked),
        message=f"No thresholds: {reason}"
        if reason
        else _offered(search, (lower, upper), limits, probability, tsc),
        reason=reason,
        limits=limits,
        candidates=search.table,
        tsc=source,
    )


def _of_fit(fit: FitResult, choice: ThresholdChoice) -> ThresholdChoice:
    """Return a choice without a probability, and with the doubts of the fit."""
    doubt = ""
    if not fit.success:
        doubt = (
            f"The fit has success = False: {fit.message} With posterior = "
            "trustlab.sample_posterior(sessions), choose_thresholds(posterior) offers thresholds "
            "with a probability, or says what to record. "
        )
    return replace(choice, probability=np.nan, message=doubt + choice.message)


# --- the search -----------------------------------------------------------------------------------


class _Search:
    """Pairs of thresholds and what models do under them."""

    COLUMNS = (
        *("lower", "upper", "p_switches", "p_encloses"),
        *("mean_r", "p_r_high", "mean_p_r", "objective", "on_front"),
    )

    def __init__(
        self,
        models: list[TscModel],
        pairs: np.ndarray,
        objective: str | float,
        asked: float,
        enclose: bool,
    ):
        self.models, self.pairs = models, pairs
        self.asked, self.enclose = asked, enclose
        self.objective = objective
        some = models[:SCREENED]
        self.motions = survey(some, pairs, EFFORT)
        self.switches = ~np.isnan(self.motions[:, :, R, LOW])
        encloses = encloses_beta(self.motions, some)
        self.holds = (encloses if enclose else self.switches).mean(axis=0)
        beta = np.array([tsc.human.beta for tsc in some])[:, None]
        apart = np.maximum(self.motions[:, :, R, LOW] - beta, beta - self.motions[:, :, R, HIGH])
        self.apart = _expected(np.maximum(apart, 0.0), self.switches)
        peak = _expected(self.motions[:, :, P_R, HIGH], self.switches)
        mean_r = _expected(self.motions[:, :, R, MEAN], self.switches)
        mean_p_r = _expected(self.motions[:, :, P_R, MEAN], self.switches)
        self.value = peak
        if objective != "peak":
            weight = 1.0 if objective == "mean" else float(objective)
            self.value = _expected(points_of(self.motions, some, weight), self.switches)
        columns = (*pairs.T, self.switches.mean(axis=0), encloses.mean(axis=0))
        columns += (mean_r, peak, mean_p_r, self.value, _front(mean_r, mean_p_r))
        self.table = pd.DataFrame(dict(zip(self.COLUMNS, columns, strict=True)))

    @property
    def condition(self) -> str:
        """What a pair is to do."""
        return "keeps switching around β" if self.enclose else "keeps switching"

    def choose(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the best pair that does what is asked, or comes nearest, and for which models it
        does, and encloses β; sample by sample and for all models.
        """
        able = self.holds >= self.asked
        mean = np.nan_to_num(self.table["mean_p_r"].to_numpy(), nan=-np.inf)
        value = np.nan_to_num(self.value, nan=-np.inf)
        apart = np.nan_to_num(self.apart, nan=np.inf)
        best_first = np.lexsort((-mean, -value))
        nearest_first = np.lexsort((apart, -self.holds))
        order = [*best_first[able[best_first]], *nearest_first[~able[nearest_first]]]
        best = None
        for k in order[: FOLLOWED if able.any() else 1]:
            pair = self.pairs[k : k + 1]
            motions = survey(self.models, pair)
            around = encloses_beta(motions, self.models)[:, 0]
            switches = ~np.isnan(motions[:, 0, R, LOW])
            if (around if self.enclose else switches).mean() >= self.asked:
                from_rest = survey(self.models, pair, rested=True)
                around &= encloses_beta(from_rest, self.models)[:, 0]
                switches &= ~np.isnan(from_rest[:, 0, R, LOW])
            holds = around if self.enclose else switches
            if best is None or holds.mean() > best[1].mean():
                best = self.pairs[k], holds, around
                self.exact = motions[:, 0]  # of the best pair
            if holds.mean() >= self.asked:
                break
        return best

    def reason(self, probability: float) -> str:
        """Say why no pair is offered."""
        low, high = self.pairs.min(), self.pairs.max()
        if not self.switches.any() or not (self.enclose or len(self.models) > 1):
            return (
                f"under no pair between {low:.3f} and {high:.3f} does control keep changing hands."
            )
        if len(self.models) > 1:
            alone = ""
            switching = (~np.isnan(self.exact[:, R, LOW])).mean()
            if self.enclose and switching >= self.asked:
                alone = (
                    f" (it keeps switching with {switching:.2f}, but not always around β: "
                    "enclose_beta=False asks for switching only)"
                )
            return (
                f"no pair between {low:.3f} and {high:.3f} was found that {self.condition} with "
                f"probability {self.asked:g}; the nearest does with {probability:.2f}{alone}. "
            )
        r_low, r_high, _ = self.exact[0, R]
        return (
            f"no pair between {low:.3f} and {high:.3f} makes the steady utilization enclose β = "
            f"{self.models[0].human.beta:.3g}; under the nearest it stays within {r_low:.3f} to "
            f"{r_high:.3f}. A smaller margin may come nearer; a wider range of robot performance "
            "moves the limits apart."
        )


def _expected(values: np.ndarray, switches: np.ndarray) -> np.ndarray:
    """Return means over the models that keep switching; NaN where none does."""
    count = switches.sum(axis=0)
    total = np.where(switches, values, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _front(cost: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Return the points that no other point beats in both cost and gain; never NaN."""
    order = np.lexsort((-gain, cost))
    best_before = np.fmax.accumulate(np.r_[-np.inf, gain[order]])[:-1]
    front = np.empty(cost.size, dtype=bool)
    front[order] = gain[order] > best_before
    return front


# --- words ----------------------------------------------------------------------------------------


def _limits_of(models: list[TscModel], delta_p_h: float) -> ThresholdLimits:
    """Return the limits of a model, or the medians of several."""
    limits = [threshold_limits(tsc, delta_p_h) for tsc in models[:SCREENED]]
    ends = [(each.lower, each.upper, each.delta_p_h) for each in limits]
    return ThresholdLimits(*np.median(ends, axis=0).tolist())


def _no_room(models: list[TscModel], limits: ThresholdLimits) -> str:
    """Say that Theorem 1 leaves no room, and what would make some."""
    some = models[:SCREENED]
    share = np.mean([threshold_limits(tsc, limits.delta_p_h).feasible for tsc in some])
    known = "no recording of this robot and operator can help"
    if share > 0.05:
        known = f"there is room in {share:.0%} of the draws, so that more data may show some"
    wider = "widen the range of robot performance (p_max − p_min)"
    settled = _limits_of(models, 0.0)
    if limits.delta_p_h > 0.0 and settled.feasible:
        wider += f", or take a smaller δ_Ph than {limits.delta_p_h:.3g}: at 0 there is room"
    return (
        f"Theorem 1 leaves no room at δ_Ph = {limits.delta_p_h:.3g}: TSC_ub = {limits.upper:.4f} "
        f"does not exceed TSC_lb = {limits.lower:.4f} (Remark 4); {known}. Remedy: {wider}."
    )


def _offered(
    search: _Search,
    pair: tuple[float, float],
    limits: ThresholdLimits,
    probability: float,
    tsc: TscModel | FitResult | Posterior,
) -> str:
    """Say what is offered, and how sure it is."""
    if isinstance(tsc, Posterior):
        sure = f"with probability {probability:.2f}"
        others = f" with at least {search.asked:g}"
    elif isinstance(tsc, FitResult):
        sure = "for the estimate alone (trustlab.sample_posterior gives a probability)"
        others = ""
    else:
        sure, others = "for exactly this model", ""
    best = OBJECTIVES.get(str(search.objective), "greatest weighted performance")
    sentences = [
        f"Thresholds {pair[0]:.3f} and {pair[1]:.3f}: the rule {search.condition} {sure}; of the "
        f"pairs that do{others} they reach the {best}."
    ]
    ends = {"lower": (pair[0], search.pairs.min()), "upper": (pair[1], search.pairs.max())}
    at_end = [name for name, (value, end) in ends.items() if value == end]
    if at_end:
        sentences.append(
            f"At the end of the range searched: the {' and the '.join(at_end)} threshold; a "
            "smaller margin allows more."
        )
    sentences.append(f"Limits: {limits}.")
    if len(search.models) == 1:
        (model,) = search.models
        own = threshold_limits(model, None)
        if not own.contains(*pair):
            sentences.append(
                f"Theorem 1 does not cover the pair at the model's own δ_Ph: {own}; that it keeps "
                "switching is seen from its motion."
            )
    return " ".join(sentences)


def _what_would_help(posterior: Posterior, search: _Search) -> str:
    """Say how much longer a recording would have to be, as if draws came nearer to their mean."""
    blocks = posterior.target.blocks
    minutes = blocks.measured.shape[1] * blocks.samples * blocks.step / 60.0
    changes = int(np.count_nonzero(np.diff(blocks.modes)))
    thetas = posterior.thetas[:SCREENED]
    apart = (thetas - thetas.mean(axis=0))[:, :SHARED]
    for times in (*LONGER, np.inf):
        nearer = thetas.copy()
        nearer[:, :SHARED] -= (1.0 - times**-0.5) * apart
        models = tsc_models(physical(nearer[: None if times < np.inf else 1], 0.1))
        motions = survey(models, search.pairs, EFFORT)
        holds = (
            encloses_beta(motions, models) if search.enclose else ~np.isnan(motions[:, :, R, LOW])
        )
        if holds.mean(axis=0).max() >= search.asked:
            break
    else:
        return (
            "No recording of this driving can help: even of the mean of the draws no pair does; "
            "widen the range of robot performance, or record phases that take utilization to both "
            "sides of β if that mean is in doubt."
        )
    if times < np.inf:
        return (
            f"Record about {times} times as much: {minutes * times:.0f} minutes with "
            f"{max(changes, 1) * times} switches."
        )
    return (
        f"More than {LONGER[-1]} times these {minutes:.0f} minutes would be needed: the mean of "
        "the draws is near the edge; record phases that take utilization to both sides of β."
    )
