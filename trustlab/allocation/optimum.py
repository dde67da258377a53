"""
The best of all rules that switch control, with a certificate.

In the long run mean P_r = P_min + b/(1 − a) · mean(M P_h), by (2.3), so that P_r drops out; and by
(2.5) M = r + (r(k + 1) − r)/(1 − a_r), so that mean(M P_h) is the mean of r P_h(r) and of a sum
that all but telescopes. What a rule earns is therefore the mean of a function f of utilization
alone. No rule exceeds the greatest f; holding r there, by a threshold on utilization, attains it.
"""

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import optimize, special

from trustlab.allocation.steady import SCREEN, grid_of_pairs, survey
from trustlab.models.checks import between, not_negative, of_class, open_unit, positive
from trustlab.models.compiled import njit
from trustlab.models.display import Result
from trustlab.models.tsc import HumanModel, TscModel, human_at, next_utilization

# Utilizations at which the certificate is evaluated.
GRID = 20_001

# The longest phase of a pattern at first, in samples and in least dwell times, and at last; and how
# many manual phases are tried with the least rest that a limit of mean r allows.
LONGEST = 1000.0
MOST_DWELLS = 40
MOST_SAMPLES = 20_000
DENSE = 600

# Thresholds tried, and how many of the best pairs, screened coarsely, are followed at length.
TRIED = 80
FOLLOWED = 25


@dataclass(frozen=True, eq=False, repr=False)
class OptimalAllocation(Result):
    """
    The best pattern of switching, and how far any rule could exceed it.

    Parameters
    ----------
    value : float
        What the pattern earns, in points of (2.39).
    upper_bound : float
        What no rule exceeds, with any dwell times.
    r_star : float
        Utilization at which the bound is attained without dwell times.
    pattern : tuple of int
        Samples of manual and of autonomous control, in turn.
    mean_r, mean_p_r : float
        Mean utilization and robot performance.
    thresholds : tuple of float or None
        The best thresholds on TSC, (2.8), of a grid of 80 values from −1 to 1, that keep switching,
        the dwell time and the limit of mean r, within Theorem 1's limits or not; None where no pair
        does.
    threshold_value : float
        What they earn; NaN where there are none.
    """

    title = "Optimal allocation"

    value: float
    upper_bound: float
    r_star: float
    pattern: tuple[int, int]
    mean_r: float
    mean_p_r: float
    thresholds: tuple[float, float] | None
    threshold_value: float

    @property
    def gap(self) -> float:
        """How far any rule could exceed the pattern, in points."""
        return self.upper_bound - self.value

    @property
    def message(self) -> str:
        """The pattern, and what no rule exceeds."""
        manual, autonomous = self.pattern
        return (
            f"{manual} samples manual and {autonomous} autonomous in turn earn {self.value:.2f} "
            f"points; no rule exceeds {self.upper_bound:.2f}"
        )

    def table(self) -> pd.DataFrame:
        """
        Return the results as a table.

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; column value.
        """
        rows = {
            "value": self.value,
            "upper bound": self.upper_bound,
            "gap": self.gap,
            "r*": self.r_star,
            "mean r": self.mean_r,
            "mean P_r": self.mean_p_r,
            "value of thresholds on TSC": self.threshold_value,
        }
        return pd.Series(rows, name="value").rename_axis("quantity").to_frame()


def optimal_allocation(
    tsc: TscModel,
    weight: float = 0.5,
    min_dwell: float = 15.0,
    max_mean_r: float | None = None,
    sample_time: float = 0.1,
) -> OptimalAllocation:
    """
    Find the best of all switching rules, and a bound that certifies it.

    What is to be great is weight · robot performance + (1 − weight) · human performance, both mean
    in the long run and in per cent of their ranges (2.39).

    Parameters
    ----------
    tsc : TscModel
        The model.
    weight : float
        Weight of robot performance, in [0, 1].
    min_dwell : float
        Least time in either mode [s]; 0 for none.
    max_mean_r : float, optional
        Greatest mean utilization, in (0, 1); any when not given.
    sample_time : float
        Step of the model [s].

    Returns
    -------
    OptimalAllocation

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    The bound is the greatest drift-corrected gain over all utilizations and both modes, bounded
    between 20,001 of them by its slope, and holds for every rule, random or with memory. The gap is
    what dwell times cost, at most; without any it is next to nothing. Patterns are searched from a
    coarse grid; what is called best is best within 0.05 points of all patterns of these lengths.

    Examples
    --------
    >>> import trustlab as tl
    >>> best = tl.optimal_allocation(tl.published_models()["2"], weight=1.0, min_dwell=0.0)
    >>> round(best.upper_bound, 1), best.gap < 0.1
    (95.7, True)
    """
    of_class("tsc", tsc, TscModel)
    weight = between("weight", weight, 0.0, 1.0)
    dwell = not_negative("min_dwell", min_dwell) / positive("sample_time", sample_time)
    # Rounding of the quotient adds no sample.
    least = math.ceil(between("min_dwell/sample_time", dwell, 0.0, MOST_SAMPLES) - 1e-9)
    least = max(1, least)
    limit = 1.0 if max_mean_r is None else open_unit("max_mean_r", max_mean_r)
    upper_bound, r_star = certificate(tsc, weight, limit)
    manual, autonomous = _best_pattern(tsc, weight, least, limit)
    value, driven = earn(tsc.constants(), manual, autonomous, *_scales(tsc, weight))
    thresholds, threshold_value = _best_thresholds(tsc, weight, least, limit)
    return OptimalAllocation(
        value=float(value),
        upper_bound=upper_bound,
        r_star=r_star,
        pattern=(manual, autonomous),
        mean_r=manual / (manual + autonomous),
        mean_p_r=float(tsc.robot.p_min + tsc.robot.b / (1.0 - tsc.robot.a) * driven),
        thresholds=thresholds,
        threshold_value=threshold_value,
    )


# --- the certificate ------------------------------------------------------------------------------


def _scales(tsc: TscModel, weight: float) -> tuple[float, float]:
    """Return points per unit of mean(M P_h), and per unit of mean P_h above its least."""
    robot, human = tsc.robot, tsc.human
    of_robot = 100.0 * weight * robot.b / ((1.0 - robot.a) * (robot.p_max - robot.p_min))
    return of_robot, 100.0 * (1.0 - weight) / (human.p_max - human.p_min)


def integral_of_performance(tsc: TscModel, r: np.ndarray) -> np.ndarray:
    """Return the integral of P_h, (2.6), from 0 to r: an incomplete beta function."""
    human = tsc.human
    beta = human.beta
    top = beta**beta * (1.0 - beta) ** (1.0 - beta)
    area = special.beta(beta + 1.0, 2.0 - beta) * special.betainc(beta + 1.0, 2.0 - beta, r) / top
    return human.p_min * r + (human.p_max - human.p_min) * area


def certificate(tsc: TscModel, weight: float, limit: float) -> tuple[float, float]:
    """
    Return what no rule exceeds, and the utilization where that is attained.

    For any function φ of r no rule earns more than the greatest g(r, M) + φ(r') − φ(r), r' being
    the next utilization: summed over time φ cancels. With φ = −κ ∫P_h dr what is left is f(r), and
    second-order terms. A limit of mean r enters with a price, which only loosens the bound.
    """
    of_robot, of_human = _scales(tsc, weight)
    human = tsc.human
    ends = np.geomspace(1e-9, 1e-3, 200)
    r = np.unique(np.r_[0.0, ends, np.linspace(0.0, 1.0, GRID), 1.0 - ends, 1.0])
    p_h = human.performance(r)
    kappa = of_robot / human.b
    mode = np.array([[0.0], [1.0]])
    after = human.a * r + human.b * mode
    scale = of_robot * mode + of_human
    change = integral_of_performance(tsc, after) - integral_of_performance(tsc, r)
    gain = scale * p_h - of_human * human.p_min - kappa * change
    with np.errstate(divide="ignore", invalid="ignore"):
        # (2.6) is concave: within a cell its slope lies between those at the ends.
        steep = (p_h - human.p_min) * (human.beta - r) / (r * (1.0 - r))
        steep[[0, -1]] = np.inf, -np.inf
        steep = np.nan_to_num(scale * steep, nan=0.0)  # 0 · ∞ where performance counts for nothing
    least, most = _over_cells(human, r)
    next_least, next_most = _over_cells(human, after)
    low = steep[:, 1:] + kappa * (least - human.a * next_most)
    high = steep[:, :-1] + kappa * (most - human.a * next_least)
    best = gain.max(axis=0)

    def on_grid(price: float) -> float:
        return float((best - price * (r - limit)).max())

    price = 0.0
    if r[int(np.argmax(best))] > limit:
        price = float(optimize.minimize_scalar(on_grid, bounds=(0.0, 1e4), method="bounded").x)
    net = gain - price * (r - limit)
    rise = net[:, :-1] + np.diff(r) * np.maximum(high - price, 0.0)
    fall = net[:, 1:] - np.diff(r) * np.minimum(low - price, 0.0)
    bound = float(np.minimum(rise, fall).max())
    return bound, float(r[int(np.argmax(best - price * (r - limit)))])


def _over_cells(human: HumanModel, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the greatest P_h between neighbours of r."""
    p_h, left, right = human.performance(r), r[..., :-1], r[..., 1:]
    ends = p_h[..., :-1], p_h[..., 1:]
    inside = (left < human.beta) & (human.beta < right)
    return np.minimum(*ends), np.where(inside, human.p_max, np.maximum(*ends))


# --- patterns -------------------------------------------------------------------------------------


@njit
def earn(c, manual, autonomous, of_robot, of_human):
    """Return points and mean(M P_h) of a pattern in steady state."""
    samples = manual + autonomous
    r = (1.0 - c.a_r**manual) * c.a_r**autonomous / (1.0 - c.a_r**samples)
    driven = 0.0
    sum_p_h = 0.0
    for mode, left in ((1.0, manual), (0.0, autonomous)):
        while left > 0:
            p_h = human_at(r, c)
            after = next_utilization(r, mode, c.a_r)
            # At the end of a long phase all samples are alike.
            count = left if after == r or (mode == 0.0 and p_h == c.p_h_min) else 1
            driven += count * mode * p_h
            sum_p_h += count * p_h
            left -= count
            r = after
    value = (of_robot * driven + of_human * (sum_p_h - samples * c.p_h_min)) / samples
    return value, driven / samples


def _best_pattern(tsc: TscModel, weight: float, least: int, limit: float) -> tuple[int, int]:
    """
    Return samples of manual and autonomous control: first coarsely, then to the sample.

    By (2.5) mean r is the share of manual samples.
    """
    c, scales = tsc.constants(), _scales(tsc, weight)
    least_rest = max(1.0 - limit, 1e-12) / limit * (1.0 - 1e-12)  # for each manual sample
    longest = min(max(LONGEST, MOST_DWELLS * least), MOST_SAMPLES) / 3.0

    def best_of(manual: np.ndarray, autonomous: np.ndarray, many: int) -> np.ndarray:
        """
        Return the best of all pairs, and of many manual phases between them with the least rest.
        """
        many = many if limit < 1.0 else 0
        pairs = np.array(np.meshgrid(manual, autonomous)).reshape(2, -1)
        between = np.geomspace(max(manual.min(), least), max(manual.max(), least), many)
        pairs = np.hstack([pairs, [between, np.full(many, least)]])
        drive, rest = np.round(np.clip(pairs, least, longest))
        rest = np.maximum(rest, np.ceil(drive * least_rest))
        patterns = np.unique(np.column_stack([drive, rest])[rest <= longest], axis=0).astype(int)
        return patterns[np.argmax([earn(c, *pattern, *scales)[0] for pattern in patterns])]

    ended = True  # by the longest phase that was tried: a longer one may be better
    while ended and longest < MOST_SAMPLES:
        longest = min(3.0 * longest, MOST_SAMPLES)
        if limit < 1.0:  # whatever keeps the limit with the shortest phases
            longest = max(longest, least * least_rest + 1.0, least / least_rest + 1.0)
        coarse = np.geomspace(least, longest, 36)
        best = best_of(coarse, coarse, DENSE)
        reach = max(4, int(0.1 * best.max()))
        while reach > 0:
            offsets = np.linspace(-reach, reach, 11)
            best = best_of(best[0] + offsets, best[1] + offsets, DENSE // 10)
            reach //= 3
        ended = best.max() > 0.9 * longest
    return int(best[0]), int(best[1])


def _best_thresholds(
    tsc: TscModel, weight: float, least: int, limit: float
) -> tuple[tuple[float, float] | None, float]:
    """Return the best pair of thresholds on TSC that keeps dwell time and mean r."""
    # TSC lies between −1 and 1, (2.2).
    pairs = grid_of_pairs(-1.0, 1.0, TRIED)

    def best_of(motions: pd.DataFrame, slack: float) -> pd.DataFrame:
        """Return the motions that keep both, the best first."""
        dwells = motions[["dwell_manual_low", "dwell_autonomous_low"]].min(axis=1)
        keep = (dwells >= (1.0 - slack) * least) & (motions["mean_r"] <= limit + slack)
        return motions[keep].sort_values("points", ascending=False, kind="stable")

    screened = best_of(pd.DataFrame(survey([tsc], pairs, SCREEN, weight)), 0.1)
    ranked = screened[["lower", "upper"]].to_numpy()
    able = pd.DataFrame()
    for first in range(0, len(ranked), FOLLOWED):
        followed = survey([tsc], ranked[first : first + FOLLOWED], weight=weight)
        able = best_of(pd.concat([able, pd.DataFrame(followed)]), 0.0)
        if len(able) >= FOLLOWED:
            break
    if able.empty:
        return None, np.nan
    lower, upper, points = able.iloc[0][["lower", "upper", "points"]]
    return (float(lower), float(upper)), float(points)
