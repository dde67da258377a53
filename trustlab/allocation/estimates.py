"""
What a session shows of its operator: thresholds from switches (Table 2.3), suggestions followed
(Table 2.6), relative performance (2.39).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.log import as_list, each_once
from trustlab.models.checks import finite_array, finite_number, in_order, of_class, positive
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel
from trustlab.sessions.errors import SessionError
from trustlab.sessions.session import Session

# Half width of the band around the means that `share_within` counts, as Table 2.3 does; draws for
# `p_overlap`.
WITHIN, DRAWS = 0.15, 2000
SIDES = ("lower", "upper")

STATES = ("followed", "not followed", "withdrawn", "open")
FOLLOWED, NOT_FOLLOWED, WITHDRAWN, OPEN = range(4)


@dataclass(frozen=True, eq=False)
class ThresholdEstimate:
    """
    TSC at the operator's own switches.

    Parameters
    ----------
    switches : pandas.DataFrame
        One row per switch: run, t [s], threshold ("lower" on taking over, "upper" on handing over),
        tsc.
    summary : pandas.DataFrame
        Index `threshold`; columns n, mean, sd, ci_low, ci_high (Student's 95 % interval of the
        mean), share_within (of the switches within ±0.15 of their mean).
    separation : float
        How far the means are apart in sums of the two SDs, (mean upper − mean lower)/(SD lower + SD
        upper). Above 1, mean ± SD do not overlap, the way in which Table 2.3 sets participant 3
        (0.99) apart from the others (1.5 to 6.5). Infinite where neither spreads; NaN with fewer
        than two switches in one direction.
    p_overlap : float
        One-sided p against the hypothesis that `separation` is 1 or less; NaN likewise.
    """

    switches: pd.DataFrame
    summary: pd.DataFrame
    separation: float
    p_overlap: float

    @property
    def distinguishable(self) -> bool:
        """
        Whether single switches are shown to tell the thresholds apart: `p_overlap` below 0.05.
        """
        return bool(self.p_overlap < 0.05)

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
    after: float | None = None,
) -> ThresholdEstimate:
    """
    Estimate an operator's thresholds from the switches that they made.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with column mode (0 or 1) and tsc, or p_r and p_h with a model to compute it from.
    model : TscModel, optional
        The operator's model: TSC is computed from it, (2.1), in place of column tsc.
    after : float, optional
        Leave out switches before this time [s], in every run; all count when not given.

    Returns
    -------
    ThresholdEstimate

    Raises
    ------
    SessionError
        If a column is missing, mode is a share, or no run has a switch (after `after`).
    ValueError
        If an argument is not understood, or a run is given twice.

    Notes
    -----
    Rule (2.8) hands over at one level of TSC and takes over at a lower one. An operator follows it,
    as far as switches can show, when nearly every single switch lies on its own side of a cut
    between the two. With normal spread the best cut at equal distances in SDs leaves Φ(−s) of the
    switches on the wrong side, s being `separation`; s = 1, where mean ± SD touch, leaves 16 %. The
    test asks whether s exceeds 1. Its p is a generalized one (Weerahandi, 1993): means and SDs are
    drawn from what normal samples of these sizes say about them. It keeps its level with few
    switches.

    A switch shows TSC when the hand moved, not when the operator decided: TSC runs on during the
    reaction, so that means lie beyond the operator's own thresholds by about its rate times the
    reaction lag, below the lower and above the upper. Where switching was barred at first, a
    threshold may have been passed long before the first switch, whose TSC then says nothing about
    it: `run_condition` bars switches for its first 100 s (`settling` in the session's metadata),
    and after=110.0 leaves out what was merely waiting for that.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.run_condition("C3", participant=2, laps=4, seed=0)
    >>> model = tl.published_models()["2"]
    >>> estimate = tl.estimate_thresholds(run.session, model)
    >>> estimate.table().index.tolist()
    ['lower', 'upper']
    """
    if model is not None:
        of_class("model", model, TscModel)
    after = -np.inf if after is None else finite_number("after", after)
    rows = []
    for number, run in enumerate(each_once(as_list(sessions))):
        mode = run["mode"]
        known = model is not None or "tsc" in run
        if not (known and np.isin(mode, (0.0, 1.0)).all()):
            raise SessionError(
                f"{run.label}: thresholds need a mode of 0 or 1, not shares, and column 'tsc'; or "
                "give model=TscModel(...) to compute it from p_r and p_h",
                run.metadata.source,
            )
        tsc = run["tsc"] if model is None else model.value(run["p_r"], run["p_h"])
        for k in np.flatnonzero((np.diff(mode) != 0.0) & (run.t[1:] >= after)) + 1:
            rows.append((number, run.t[k], "lower" if mode[k] == 1.0 else "upper", tsc[k]))
    switches = pd.DataFrame(rows, columns=["run", "t", "threshold", "tsc"])
    if switches.empty:
        when = "" if after == -np.inf else f" at {after:g} s or later"
        raise SessionError(
            f"mode never changes{when} in these sessions, so no threshold can be estimated"
        )
    tsc = switches.groupby("threshold")["tsc"]
    near = (switches["tsc"] - tsc.transform("mean")).abs() <= WITHIN
    summary = tsc.agg(n="count", mean="mean", sd="std").reindex(SIDES)
    n = summary["n"] = summary["n"].fillna(0).astype(int)
    half = special.stdtrit(n - 1, 0.975) * summary["sd"] / np.sqrt(n)
    summary["ci_low"], summary["ci_high"] = summary["mean"] - half, summary["mean"] + half
    summary["share_within"] = near.groupby(switches["threshold"]).mean()
    sides = summary[["n", "mean", "sd"]].to_numpy()
    return ThresholdEstimate(switches, summary, *_apart(sides, np.random.default_rng(0)))


def _apart(sides: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """
    Return the separation of two groups of switches, of which n, mean and SD are known, and p that
    it is 1 or less.
    """
    n, mean, sd = sides.T
    if n.min() < 2:
        return np.nan, np.nan
    drawn = []
    for count, middle, width in sides:
        spread = width * np.sqrt((count - 1) / rng.chisquare(count - 1, DRAWS))
        drawn += [middle + spread * rng.standard_normal(DRAWS) / np.sqrt(count), spread]
    with np.errstate(divide="ignore", invalid="ignore"):  # no spread: ∞, or NaN without distance
        low, a, high, b = drawn
        ratios = (high - low) / (a + b)
        ratio = (mean[1] - mean[0]) / sd.sum()
    return float(ratio), 1.0 - float((ratios > 1.0).mean())


def relative_performance(p_r: float | np.ndarray, p_min: float, p_max: float) -> float:
    """
    Return mean robot performance as a percentage of its range, (2.39).

    It is (mean P_r − P_min)/(P_max − P_min) · 100.

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

    Examples
    --------
    >>> import trustlab as tl
    >>> round(tl.relative_performance([0.30, 0.33, 0.36], p_min=0.24, p_max=0.36), 1)
    75.0
    """
    low, high = in_order("p_min", p_min, "p_max", p_max)
    values = finite_array("p_r", np.ravel(p_r))
    return 100.0 * (float(values.mean()) - low) / (high - low)


# --- suggestions ---------------------------------------------------------------------------------


def followed_suggestions(session: Session, deadline: float = 15.0) -> pd.DataFrame:
    """
    Return the suggestions that were shown, and whether they were followed (Table 2.6).

    Each counts from its first appearance.

    A suggestion is shown while `suggested_mode` is 0 or 1 and not the mode there is; one that comes
    back within the deadline, while the mode stayed and the aid did not agree with it, is the same
    suggestion.

    Parameters
    ----------
    session : Session
        With columns mode and suggested_mode.
    deadline : float
        A suggestion counts as followed when the mode changes to it within this time [s].

    Returns
    -------
    pandas.DataFrame
        Columns start [s], suggested_mode, delay [s] until the mode changed to it (NaN if it never
        did before the next suggestion), followed (bool), state: "followed", "not followed",
        "withdrawn" (before the deadline) or "open" (the session ended before the deadline).

    Raises
    ------
    SessionError
        If a column is missing or holds a share.
    ValueError
        If `session` is not a `Session`, or the deadline is not positive.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.run_condition("C2", participant=2, laps=4, seed=0)
    >>> tl.followed_suggestions(run.session).columns.tolist()
    ['start', 'suggested_mode', 'delay', 'followed', 'state']
    """
    of_class("session", session, Session, "trustlab.read_session(path) reads one")
    deadline = positive("deadline", deadline)
    session.require("mode", "suggested_mode")
    for name in ("mode", "suggested_mode"):
        if not np.isin(session[name], (-1.0, 0.0, 1.0)).all():
            raise SessionError(f"column {name!r} holds shares; suggestions need modes of 0 or 1")
    episodes = suggestion_episodes(session.t, session["mode"], session["suggested_mode"], deadline)
    table = pd.DataFrame(episodes, columns=["start", "suggested_mode", "delay", "state"])
    table.insert(3, "followed", table["state"] == FOLLOWED)
    return table.assign(state=table["state"].map(dict(enumerate(STATES))))


@njit
def suggestion_episodes(t, mode, suggested, deadline):
    """
    Return start, mode, delay until it was taken (or NaN) and state of every suggestion, a row each.

    States are those of `followed_suggestions`.
    """
    rows = np.full((t.size, 4), np.nan)  # the last column is when it was shown last, at first
    count = last = 0
    # Whether none was shown yet, or the mode has changed, or the aid has agreed with it, since the
    # last one was.
    broken = True
    for k in range(t.size):
        before = mode[max(k - 1, 0)]
        if suggested[k] >= 0.0 and suggested[k] != before:
            if broken or suggested[k] != suggested[last] or t[k] - t[last] > deadline:
                rows[count, 0], rows[count, 1] = t[k], suggested[k]
                count += 1
            rows[count - 1, 3] = t[k]
            last = k
            broken = False
        elif mode[k] != before or suggested[k] == before:
            broken = True
        now = count - 1
        if mode[k] == rows[now, 1] and np.isnan(rows[now, 2]):
            rows[now, 2] = t[k] - rows[now, 0]
    for row in rows[:count]:
        start, _, delay, shown = row
        row[3] = WITHDRAWN if t[-1] - start >= deadline else OPEN
        if delay <= deadline + 1e-9:
            row[3] = FOLLOWED
        elif shown - start >= deadline - 1e-9:
            row[3] = NOT_FOLLOWED
    return rows[:count]
