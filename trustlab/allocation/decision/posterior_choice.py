"""Thresholds for a person who is known by a posterior: chosen with a stated probability, or not."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.allocation.decision.steady import SteadyMotions, grid_of_pairs, points, survey
from trustlab.allocation.limits import threshold_limits
from trustlab.identification.posterior.likelihood import SHARED
from trustlab.identification.posterior.result import Posterior, physical, tsc_models
from trustlab.models.checks import between, one_of, whole_number
from trustlab.models.display import Result
from trustlab.models.tsc import TscModel

# Draws by which pairs are judged.
DRAWS = 300

# How many times as much data are considered where no pair is probable enough.
LONGER = (2, 4, 8, 16)

OBJECTIVES = ("peak", "mean")


@dataclass(frozen=True, eq=False, repr=False)
class PosteriorChoice(Result):
    """
    Thresholds chosen under uncertainty, or the reason why none are offered.

    Parameters
    ----------
    offered : bool
        Whether a pair keeps the conditions with the probability asked for.
    lower, upper : float
        TSC_l and TSC_u; where none are offered, the pair that comes nearest.
    probability : float
        Probability that the pair keeps switching and, where asked, encloses β.
    p_switches, p_encloses : float
        Probability that it keeps switching, and that it does and encloses β.
    confidence : float
        The probability asked for.
    ranges : pandas.DataFrame
        Index `quantity`: mean_r, mean_p_r, peak_p_r and dwell (the shortest, in samples of the
        model), where the rule keeps switching; columns mean, ci_low, ci_high.
    message : str
        What is offered or which recording would help.
    candidates : pandas.DataFrame
        All pairs: lower, upper, p_switches, p_encloses, objective (expected).
    """

    offered: bool
    lower: float
    upper: float
    probability: float
    p_switches: float
    p_encloses: float
    confidence: float
    ranges: pd.DataFrame
    message: str
    candidates: pd.DataFrame

    @property
    def title(self) -> str:
        """Whether thresholds are offered."""
        return "Thresholds" if self.offered else "No thresholds offered"

    def table(self) -> pd.DataFrame:
        """Return means and intervals of what the pair leads to."""
        return self.ranges.copy()

    def plot(self, axes=None):
        """
        Plot the probability of every pair, and the choice.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to plot; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from trustlab.models.display import axes_or_new

        axes = axes_or_new(axes, figsize=(5, 4))
        shown = axes.scatter(
            "lower", "upper", c="p_encloses", data=self.candidates, vmin=0, vmax=1, label="pair"
        )
        axes.figure.colorbar(shown, ax=axes, label="probability of switching around β")
        label = "choice" if self.offered else "nearest"
        axes.plot(self.lower, self.upper, "k*", ms=12, label=label)
        axes.set(xlabel="lower threshold $TSC_l$", ylabel="upper threshold $TSC_u$")
        axes.legend(fontsize="small")
        return axes


def choose_under_posterior(
    posterior: Posterior,
    confidence: float = 0.95,
    objective: str | float = "peak",
    enclose_beta: bool = True,
    points: int = 14,
) -> PosteriorChoice:
    """Return the pair of the best expected objective among those that are probable enough."""
    check_objective(objective)
    points = whole_number("points", points, least=4, most=60)
    models = posterior.models[:DRAWS]
    pairs = _pairs(models, points)
    motions = survey(models, pairs)
    holds = motions.encloses if enclose_beta else motions.switches
    probability = holds.mean(axis=0)
    values = expected(objective_of(motions, models, objective), motions.switches)
    able = np.flatnonzero(probability >= confidence)
    offered = able.size > 0
    best = able[np.argmax(values[able])] if offered else int(np.argmax(probability))
    ranges = _ranges(motions, best)
    condition = "keeps switching around β" if enclose_beta else "keeps switching"
    lower, upper = pairs[best]
    if offered:
        message = (
            f"Thresholds {lower:.3f} and {upper:.3f}: the rule {condition} with probability "
            f"{probability[best]:.2f}; of the pairs with at least {confidence:g} they have the "
            f"best expected objective.{_at_end(pairs[best], pairs)}"
        )
    else:
        switching = motions.switches[:, best].mean()
        alone = ""
        if enclose_beta and switching >= confidence:
            alone = (
                f" (it keeps switching with {switching:.2f}, but not always around β: "
                "enclose_beta=False asks for switching only)"
            )
        message = (
            f"No pair of thresholds {condition} with probability {confidence:g}; the nearest, "
            f"{lower:.3f} and {upper:.3f}, does with {probability[best]:.2f}{alone}. "
            + _what_would_help(posterior, pairs, enclose_beta, confidence)
        )
    table = pd.DataFrame(pairs, columns=["lower", "upper"]).assign(
        p_switches=motions.switches.mean(axis=0),
        p_encloses=motions.encloses.mean(axis=0),
        objective=values,
    )
    return PosteriorChoice(
        offered=bool(offered),
        lower=float(lower),
        upper=float(upper),
        probability=float(probability[best]),
        p_switches=float(table["p_switches"][best]),
        p_encloses=float(table["p_encloses"][best]),
        confidence=confidence,
        ranges=ranges,
        message=message,
        candidates=table,
    )


def check_objective(objective: str | float) -> None:
    """Refuse what is no objective of `choose_thresholds`."""
    if isinstance(objective, str):
        one_of("objective", objective, OBJECTIVES, "a weight in [0, 1]")
    else:
        between("objective", objective, 0.0, 1.0)


def objective_of(
    motions: SteadyMotions, models: list[TscModel], objective: str | float
) -> np.ndarray:
    """Return what is to be great, by model and pair."""
    if objective == "peak":
        return motions.peak
    return motions.mean_p_r if objective == "mean" else points(motions, models, float(objective))


def expected(values: np.ndarray, switches: np.ndarray) -> np.ndarray:
    """Return means over the models that keep switching; −∞ where none does."""
    total = np.where(switches, values, 0.0).sum(axis=0)
    count = switches.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), -np.inf)


def _pairs(models: list[TscModel], count: int) -> np.ndarray:
    """Return pairs between the limits of the median model."""
    limits = [threshold_limits(tsc, 0.0) for tsc in models]
    low = float(np.median([each.lower for each in limits]))
    high = float(np.median([each.upper for each in limits]))
    span = abs(high - low)
    return grid_of_pairs(low + 0.03 * span, low + 0.97 * span, count)


def _at_end(pair: np.ndarray, pairs: np.ndarray) -> str:
    """Say that a pair lies at the end of what was searched, and what may be beyond."""
    low, high = float(pairs.min()), float(pairs.max())
    at_end = {"lower": pair[0] == low, "upper": pair[1] == high}
    names = [name for name, reached in at_end.items() if reached]
    if not names:
        return ""
    which = "Both thresholds are" if len(names) == 2 else f"The {names[0]} threshold is"
    return (
        f" {which} at the end of the range searched, {low:.3f} to {high:.3f}, where Theorem 1 "
        "promises switching. Pairs beyond it may do better: limit_cycle(posterior, lower, upper) "
        "says how probably they switch."
    )


def _ranges(motions: SteadyMotions, pair: int) -> pd.DataFrame:
    """Return means and 95 % intervals of the motions that keep switching."""
    columns = {
        "mean_r": motions.mean_r,
        "mean_p_r": motions.mean_p_r,
        "peak_p_r": motions.peak,
        "dwell": motions.dwell,
    }
    rows = {}
    for name, values in columns.items():
        seen = values[motions.switches[:, pair], pair]
        ends = np.quantile(seen, [0.025, 0.975]) if seen.size else (np.nan, np.nan)
        rows[name] = (seen.mean() if seen.size else np.nan, *ends)
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["mean", "ci_low", "ci_high"])
    return table.rename_axis("quantity")


def _what_would_help(
    posterior: Posterior, pairs: np.ndarray, enclose_beta: bool, confidence: float
) -> str:
    """Say how much longer a recording would have to be, as if draws came nearer to their mean."""
    blocks = posterior.target.blocks
    minutes = blocks.measured.shape[1] * blocks.samples * blocks.step / 60.0
    changes = int(np.count_nonzero(np.diff(blocks.modes)))
    thetas = posterior.thetas[:DRAWS]
    centre = thetas.mean(axis=0)
    for times in LONGER:
        nearer = thetas.copy()
        nearer[:, :SHARED] += (1.0 - times**-0.5) * (centre - thetas)[:, :SHARED]
        motions = survey(tsc_models(physical(nearer, 0.1)), pairs)
        holds = motions.encloses if enclose_beta else motions.switches
        if holds.mean(axis=0).max() >= confidence:
            return (
                f"Record about {times} times as much: {minutes * times:.0f} minutes with "
                f"{max(changes, 1) * times} switches."
            )
    return (
        f"More than {LONGER[-1]} times these {minutes:.0f} minutes would be needed: the mean of "
        "the draws itself is near the edge; record phases that take utilization to both sides of β."
    )
