"""What thresholds an operator's own switches show (Table 2.3), and performance as a share of its range (2.39)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import finite_array, finite_number
from trustlab.models.tsc import TscModel
from trustlab.sessions.errors import SessionError
from trustlab.sessions.session import Session

__all__ = ["ThresholdEstimate", "estimate_thresholds", "relative_performance"]


@dataclass(frozen=True, eq=False)
class ThresholdEstimate:
    """
    TSC at the operator's own switches.

    Parameters
    ----------
    switches : pandas.DataFrame
        One row per switch: run, t [s], threshold ("lower" on taking over, "upper" on handing over), tsc.
    summary : pandas.DataFrame
        Index `threshold`; columns n, mean, sd, ci_low, ci_high (bootstrap 95 % interval of the mean), share_within (of the
        switches within ±0.15 of their mean).
    distinguishable : bool
        Whether mean ± SD of the two do not overlap, the upper above the lower: single switches then tell them apart.
        This is how Table 2.3 sets participant 3 apart.
    p : float
        One-sided p of Welch's t test that the mean of the upper is greater; NaN with fewer than two switches in one.
        Small also where single switches overlap but there are many of them.
    """

    switches: pd.DataFrame
    summary: pd.DataFrame
    distinguishable: bool
    p: float

    @property
    def lower(self) -> float:
        """Mean TSC at which the operator takes over."""
        return float(self.summary.loc["lower", "mean"])

    @property
    def upper(self) -> float:
        """Mean TSC at which the operator hands over to the robot."""
        return float(self.summary.loc["upper", "mean"])

    def table(self) -> pd.DataFrame:
        """Return the summary."""
        return self.summary.copy()


def estimate_thresholds(
    sessions: Session | Iterable[Session],
    model: TscModel | None = None,
    within: float = 0.15,
    resamples: int = 2000,
    seed: int = 0,
) -> ThresholdEstimate:
    """
    Estimate the thresholds that an operator's own switches show.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with column mode (0 or 1) and tsc, or p_r and p_h with a model to work it out.
    model : TscModel, optional
        The operator's model (2.1), for sessions without column tsc.
    within : float
        Half width of the band around the means that `share_within` counts.
    resamples : int
        Bootstrap resamples for the intervals of the means.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    ThresholdEstimate

    Raises
    ------
    SessionError
        If a column is missing, mode is a share, or no run has a switch.
    ValueError
        If `within` is not positive.
    """
    if not finite_number("within", within) > 0.0:
        raise ValueError(f"within must be positive, got {within}")
    runs = [sessions] if isinstance(sessions, Session) else list(sessions)
    rows = []
    for number, run in enumerate(runs):
        run.require("mode")
        mode = run["mode"]
        if not np.isin(mode, (0.0, 1.0)).all():
            raise SessionError(
                f"{run.label}: thresholds need a mode of 0 or 1, not shares", run.metadata.source
            )
        if "tsc" not in run and model is None:
            raise SessionError(
                f"{run.label} has no column 'tsc'; give model=TscModel(...) to work it out from p_r and p_h",
                run.metadata.source,
            )
        run.require(*(["tsc"] if "tsc" in run else ["p_r", "p_h"]))
        tsc = run["tsc"] if "tsc" in run else model.value(run["p_r"], run["p_h"])
        for k in np.flatnonzero(np.diff(mode)) + 1:
            rows.append((number, run.t[k], "lower" if mode[k] == 1.0 else "upper", tsc[k]))
    switches = pd.DataFrame(rows, columns=["run", "t", "threshold", "tsc"])
    if switches.empty:
        raise SessionError("mode never changes in these sessions, so no threshold shows")
    return _summarise(switches, within, resamples, np.random.default_rng(seed))


def apart(summary: pd.DataFrame) -> bool:
    """
    Return whether mean − SD of the upper threshold lies above mean + SD of the lower one.

    Parameters
    ----------
    summary : pandas.DataFrame
        Index lower, upper; columns mean, sd.
    """
    low, high = summary.loc["lower"], summary.loc["upper"]
    return bool(high["mean"] - high["sd"] > low["mean"] + low["sd"])


def _summarise(
    switches: pd.DataFrame, within: float, resamples: int, rng: np.random.Generator
) -> ThresholdEstimate:
    from scipy import stats

    groups = {
        name: switches.loc[switches["threshold"] == name, "tsc"].to_numpy() for name in ("lower", "upper")
    }
    rows = {}
    for name, values in groups.items():
        if values.size == 0:
            rows[name] = (0, np.nan, np.nan, np.nan, np.nan, np.nan)
            continue
        means = rng.choice(values, (resamples, values.size)).mean(axis=1)
        low, high = np.quantile(means, [0.025, 0.975]) if values.size > 1 else (np.nan, np.nan)
        sd = values.std(ddof=1) if values.size > 1 else np.nan
        share = np.mean(np.abs(values - values.mean()) <= within)
        rows[name] = (values.size, values.mean(), sd, low, high, share)
    columns = ["n", "mean", "sd", "ci_low", "ci_high", "share_within"]
    summary = pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("threshold")
    p = np.nan
    if min(values.size for values in groups.values()) > 1:
        p = float(
            stats.ttest_ind(groups["upper"], groups["lower"], equal_var=False, alternative="greater").pvalue
        )
    return ThresholdEstimate(switches, summary, apart(summary), p)


def relative_performance(p_r: float | np.ndarray, p_min: float, p_max: float) -> float:
    """
    Return mean robot performance as a percentage of its range, (mean P_r − P_min)/(P_max − P_min) · 100 (2.39).

    Parameters
    ----------
    p_r : float or array_like
        Robot performance.
    p_min, p_max : float
        Least and greatest robot performance.

    Raises
    ------
    ValueError
        If p_min is not below p_max, or a performance is not finite.
    """
    low, high = finite_number("p_min", p_min), finite_number("p_max", p_max)
    if not low < high:
        raise ValueError(f"p_min must be below p_max, got {low} and {high}")
    values = finite_array("p_r", np.atleast_1d(p_r))
    return 100.0 * (float(values.mean()) - low) / (high - low)
