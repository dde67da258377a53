"""Choosing thresholds by Algorithm 1: for a model, a fit of one, or a posterior."""

from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.invariant import InvariantBounds, invariant_bounds
from trustlab.allocation.limits import ThresholdLimits, limits_as_printed, threshold_limits
from trustlab.allocation.steady import (
    BOTH,
    EXACT,
    SCREEN,
    LimitCycle,
    grid_of_pairs,
    limit_cycle,
    survey,
)
from trustlab.identification.posterior.density import physical
from trustlab.identification.posterior.result import Posterior, tsc_models
from trustlab.identification.result import FitResult
from trustlab.models.checks import (
    between,
    flag,
    not_negative,
    of_class,
    one_of,
    open_unit,
    warn,
    whole_number,
)
from trustlab.models.display import Result, axes_or_new
from trustlab.models.tsc import TscConstants, TscModel

# Draws of a posterior by which pairs are screened, and how many pairs, the best and then the most
# probable, are followed sample by sample, with all draws, until one keeps its promise.
SCREENED = 200
FOLLOWED = 6

# How many of the best pairs are looked at under more data, at most.
NEAREST = 20

# Draws of a posterior over which a table gives medians, and the ends of its intervals.
DRAWS = 200
ENDS = {"": 0.5, "_ci_low": 0.025, "_ci_high": 0.975}

# How many times as much data are considered where no pair is probable enough.
LONGER = (2, 4, 8, 16)

PAIR = ["lower", "upper"]
COLUMNS = ["p_switches", "p_encloses", "mean_r", "p_r_high", "mean_p_r", "objective", "off_beta"]

# What is asked of a pair: a column of a survey, and words.
ENCLOSING = "p_encloses", "keeps switching around β"
SWITCHING = "p_switches", "keeps switching"

OF_A_FIT = "for the estimate alone (trustlab.sample_posterior gives a probability)"
UNSURE = (
    "The fit has success = False: {} With posterior = trustlab.sample_posterior(sessions), "
    "choose_thresholds(posterior) offers thresholds with a probability, or says what to record. {}"
)


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
        All pairs that were tried, the best first: lower, upper, p_switches, p_encloses, and means
        over the models that keep switching of mean_r, p_r_high, mean_p_r, objective and off_beta,
        how far utilization stays from β; negative where it encloses β.
    tsc : TscModel or Posterior
        What they were chosen for; of a fit its model.
    """

    title = "Thresholds"

    lower: float
    upper: float
    probability: float
    encloses_beta: bool
    message: str
    reason: str
    limits: ThresholdLimits
    candidates: pd.DataFrame
    tsc: Any

    @property
    def offered(self) -> bool:
        """Whether thresholds are offered."""
        return not self.reason

    @cached_property
    def cycle(self) -> LimitCycle:
        """The steady motion of a model under the thresholds: `limit_cycle`."""
        return limit_cycle(self._model(), self.lower, self.upper)

    @cached_property
    def bounds(self) -> InvariantBounds:
        """Bounds for every trajectory of a model under the thresholds: `invariant_bounds`."""
        return invariant_bounds(self._model(), self.lower, self.upper)

    def _model(self) -> TscModel:
        # Errors of attributes: who lists an object's members passes over them.
        if np.isnan(self.lower):
            raise AttributeError(f"there are no thresholds: {self.reason}")
        if not isinstance(self.tsc, TscModel):
            raise AttributeError(
                "a choice from a posterior has a table(); limit_cycle and invariant_bounds take "
                "one of the posterior's models"
            )
        return self.tsc

    def table(self) -> pd.DataFrame:
        """
        Return ranges and means of the motion that the thresholds lead to; empty without any.

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; columns low, high, mean. Of a posterior these are medians over 200
            draws, each with the ends of a 95 % interval, as in low, low_ci_low, low_ci_high.
        """
        if np.isnan(self.lower):
            return self.candidates
        if isinstance(self.tsc, TscModel):
            return self.cycle.table()
        pair, models = (self.lower, self.upper), self.tsc.models[:DRAWS]
        motions = pd.concat([limit_cycle(tsc, *pair).table() for tsc in models])
        parts = motions.groupby(level=0, sort=False)
        quantiles = {
            f"{name}{end}": parts[name].quantile(level)
            for name in motions
            for end, level in ENDS.items()
        }
        return pd.DataFrame(quantiles)

    def plot(self):
        """
        Plot probability and mean performance of every pair, and the choice, a star.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (2,)
        """
        axes = axes_or_new(columns=2, sharey=True, figsize=(7.8, 3.8))
        titles = {
            "p_encloses": "probability of switching around β",
            "mean_p_r": "mean robot performance",
        }
        for axis, (name, title) in zip(axes, titles.items(), strict=True):
            style = {"s": 14, "marker": "s"}
            shown = axis.scatter("lower", "upper", c=name, data=self.candidates, **style)
            axis.figure.colorbar(shown, ax=axis)
            axis.plot(self.lower, self.upper, "*", ms=14, color="C1", mec="k")
            axis.set(xlabel="lower threshold $TSC_l$", title=title)
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
        Distance to keep from either limit, as a share of TSC_ub − TSC_lb, from 0.001 to 0.49; 0.1,
        and 0.03 for a posterior, whose probability says what is safe, when not given.
    points : int, optional
        Grid points along each threshold, 4 to 500; 24, and 14 for a posterior, when not given.
    objective : {"peak", "mean"} or float
        What is to be great: "peak", the highest robot performance, as printed, ties by the mean; a
        weight w in [0, 1] for w · robot performance + (1 − w) · human performance, both mean and in
        points of (2.39); "mean" is w = 1. Against the best of all rules the peak costs the printed
        operators 9 to 27 points of mean robot performance.
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
        If nothing is offered, utilization does not enclose β, or `success` of a fit is False; with
        the message.

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
    share, count = (0.03, 14) if of_posterior else (0.1, 24)
    share = between("margin", share if margin is None else margin, 0.001, 0.49)
    count = whole_number("points", count if points is None else points, least=4, most=500)
    if isinstance(objective, str):
        one_of("objective", objective, ("peak", "mean"), "a weight in [0, 1]")
        weight = 1.0
    else:
        weight = between("objective", objective, 0.0, 1.0)
    aim, goal = ENCLOSING if flag("enclose_beta", enclose_beta) else SWITCHING
    if confidence is not None and not of_posterior:
        raise ValueError(
            f"confidence = {confidence} would do nothing: of one model a pair keeps switching or "
            "does not; trustlab.sample_posterior gives a probability"
        )
    asked = 0.95 if confidence is None else open_unit("confidence", confidence)
    fit = tsc if isinstance(tsc, FitResult) else None
    source: Any = fit.model if fit else tsc
    models = source.models if of_posterior else [of_class("tsc", source, TscModel)]
    limits, reason = _room(models, not_negative("delta_p_h", delta_p_h))
    lower = upper = probability = np.nan
    message, around, table = "", 0.0, pd.DataFrame(columns=PAIR + COLUMNS, dtype=float)
    if not reason:
        off = share * (limits.upper - limits.lower)
        pairs = grid_of_pairs(limits.lower + off, limits.upper - off, count)
        motions = survey(models[:SCREENED], pairs, SCREEN if of_posterior else EXACT, weight)
        table = _ranked(motions, "p_r_high" if objective == "peak" else "points", asked, aim)
        lower, upper, probability, around = _followed(models, table, asked, aim)
        if probability < asked:
            reason = (
                f"none of the pairs followed between {pairs.min():.3f} and {pairs.max():.3f} {goal}"
            )
            if of_posterior:
                reason += f" with probability {asked:g}; the nearest does with {probability:.3f}. "
                reason += _what_would_help(source, table, asked, aim)
            elif enclose_beta:
                reason += _how_near(limit_cycle(source, lower, upper))
        else:
            sure = OF_A_FIT if fit else "for exactly this model"
            if of_posterior:
                sure = f"with probability {probability:.3f} (asked for: {asked:g})"
            message = (
                f"Thresholds {lower:.3f} and {upper:.3f}: the rule {goal} {sure}; of the pairs "
                f"that do, they are best by objective={objective!r}. Limits: {limits.message}."
            )
            own = threshold_limits(models[0], None)
            if not (of_posterior or own.contains(lower, upper)):
                message += (
                    f" Theorem 1 does not cover the pair at the model's own δ_Ph: {own.message}; "
                    "that it keeps switching is seen from its motion."
                )
            message += " Utilization does not enclose β." * (around < asked)
    if reason:
        message = f"No thresholds: {reason}"
    if fit:
        probability = np.nan
        message = message if fit.success else UNSURE.format(fit.message, message)
    if around < asked or (fit and not fit.success):
        warn(message)
    decided = lower, upper, probability, bool(around >= asked), message, reason
    return ThresholdChoice(*decided, limits, table, source)


def _how_near(cycle: LimitCycle) -> str:
    """Say how near the nearest pair comes to β, and what may help."""
    return (
        f" = {cycle.model.human.beta:.3g}; under the nearest utilization stays within "
        f"{cycle.r_low:.3f} to {cycle.r_high:.3f}. A smaller margin may come nearer, a wider range "
        "of robot performance moves the limits apart, and enclose_beta=False asks for switching "
        "only."
    )


# --- the search -----------------------------------------------------------------------------------


def _ranked(motions: np.ndarray, objective: str, asked: float, aim: str) -> pd.DataFrame:
    """
    Return means over models of what pairs lead to, the best pair first: of those that do what is
    asked, then of those nearest to it.
    """
    table = pd.DataFrame(motions).assign(objective=motions[objective])
    table = table.groupby(PAIR)[COLUMNS].mean().reset_index()
    able = table[aim] >= asked
    first = table["objective"].where(able, table[aim])
    second = table["mean_p_r"].where(able, -table["off_beta"])
    return table.iloc[np.lexsort((-second, -first, ~able))].reset_index(drop=True)


def _followed(
    models: list[TscModel], table: pd.DataFrame, asked: float, aim: str
) -> tuple[float, float, float, float]:
    """
    Return the first pair that does what is asked, else the most probable, how probable that is, and
    that utilization encloses β; decided sample by sample, from β and from rest, for all models.
    """
    able = (table[aim] >= asked).sum()
    count = FOLLOWED if able else 1
    # The best lie at the edge of what the screening finds probable enough: then the most probable.
    likely = table[count:able].sort_values(aim, ascending=False, kind="stable")[:FOLLOWED]
    tried = []
    for pair in pd.concat([table[:count], likely])[PAIR].to_numpy():
        motions = survey(models, [pair], starts=BOTH).reshape(-1, len(BOTH))
        shares = [float(motions[name].all(axis=1).mean()) for name in (aim, "p_encloses")]
        tried.append((*pair.tolist(), *shares))
        if shares[0] >= asked:
            break
    return max(tried, key=itemgetter(2))


def _what_would_help(posterior: Posterior, table: pd.DataFrame, asked: float, aim: str) -> str:
    """Say how much longer to record, as if draws came nearer to their mean."""
    blocks = posterior.target.blocks
    minutes = blocks.measured.shape[1] * blocks.samples * blocks.step / 60.0
    thetas, pairs = posterior.thetas[:SCREENED], table[PAIR][:NEAREST]
    mean = thetas.mean(axis=0)
    for times in LONGER:
        nearer = physical(mean + times**-0.5 * (thetas - mean), blocks.step)
        able = survey(tsc_models(nearer), pairs, SCREEN)[aim].reshape(-1, len(pairs))
        if able.mean(axis=0).max() >= asked:
            return f"Record about {times} times as much: {minutes * times:.0f} minutes."
    return (
        f"More than {LONGER[-1]} times these {minutes:.0f} minutes would be needed: record phases "
        "that take utilization to both sides of β, or widen the range of robot performance."
    )


def _room(models: list[TscModel], delta: float) -> tuple[ThresholdLimits, str]:
    """Return the limits, medians over the models, and why they leave no room, if they do."""
    c = TscConstants(*np.transpose([tsc.constants() for tsc in models]))
    ends = limits_as_printed(c, delta)
    lower, upper = (float(np.median(end)) for end in ends)
    limits = ThresholdLimits(lower, upper, delta)
    if limits.feasible:
        return limits, ""
    share = (ends[0] < ends[1]).mean()
    known = "no recording of this robot and operator can help"
    if share > 0.05:
        known = f"there is room in {share:.0%} of the draws, so that more data may show some"
    least, most = map(np.median, limits_as_printed(c, 0.0))
    smaller = f", or take a smaller δ_Ph than {delta:.3g}" if least < most else ""
    return limits, (
        f"Theorem 1 leaves no room: {limits.message}; {known}. Remedy: widen the range of robot "
        f"performance (p_max − p_min){smaller}."
    )
