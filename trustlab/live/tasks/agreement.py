"""How often people choose the leader that a policy would pick, beyond chance."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from trustlab.live.tasks.team import ADVISERS, BY_HAND
from trustlab.models.checks import between, whole_number
from trustlab.sessions.session import Session


def occasions(session: Session, dwell: float) -> pd.DataFrame:
    """
    Return the occasions on which a person might have changed the leader of a team.

    The first begins when the leader has led for the dwell time. Each lasts until the person lets
    another robot lead, at most for another dwell time; the next begins when a switch is possible
    again.

    Parameters
    ----------
    session : Session
        A run of a team.
    dwell : float
        τ_min [s].

    Returns
    -------
    pandas.DataFrame
        A row per occasion: t, when it begins [s]; most_trusted and hysteresis, whom the policies
        would pick then; chosen, who leads at its end.
    """
    leader = session["leader"].astype(int)
    length = round(dwell / session.sample_time)
    rows = []
    end = 0
    for k in np.flatnonzero(session["may_switch"] > 0):
        if k < end:
            continue
        ahead = leader[k : k + length + 1]
        switched = np.flatnonzero(ahead != leader[k])
        if len(ahead) <= length and not switched.size:
            break  # the run ended before the person had the time
        end = int(k + (switched[0] if switched.size else length))
        picks = (int(session[f"leader_{name}"][k]) for name in ADVISERS)
        rows.append((session.t[k], *picks, leader[end]))
    return pd.DataFrame(rows, columns=["t", *ADVISERS, "chosen"])


def policy_agreement(
    sessions: Iterable[Session], draws: int = 2000, confidence: float = 0.95, seed: int = 0
) -> pd.DataFrame:
    """
    Return how often people's choice of the leader agrees with each policy, beyond chance.

    κ = (agreement − chance)/(1 − chance). Chance is what choices and picks of the same run would
    share if they were independent, Cohen (1960), with each run's own frequencies: somebody who
    keeps one robot agrees with a policy that keeps it too by chance only.

    Parameters
    ----------
    sessions : iterable of Session
        Runs of a team in which a person chose by hand; others are left out.
    draws : int
        Resamples of participants, for the interval.
    confidence : float
        Of the interval.
    seed : int
        Of the resamples.

    Returns
    -------
    pandas.DataFrame
        Index policy; participants, occasions, agreement (share of occasions), chance, kappa, low
        and high: percentiles of participants drawn with replacement, NaN for fewer than two.

    Raises
    ------
    ValueError
        If there is no occasion to choose.
    """
    whole_number("draws", draws, least=100)
    tail = 50.0 * (1.0 - between("confidence", confidence, 0.5, 0.999))
    people: dict[str, np.ndarray] = {}
    for session in sessions:
        about = session.metadata
        if about.condition == BY_HAND:
            table = occasions(session, about.more["min_dwell"])
            sums = people.setdefault(str(about.participant), np.zeros((len(ADVISERS), 3)))
            sums += [_sums(table, name) for name in ADVISERS]
    total = sum(people.values(), np.zeros((len(ADVISERS), 3)))
    if not total.any():
        raise ValueError(f"nobody had an occasion to choose; runs in {BY_HAND!r} are needed")
    rng = np.random.default_rng(seed)
    drawn = rng.integers(len(people), size=(draws, len(people)))
    low = high = np.nan
    if len(people) > 1:
        kappas = _kappa(np.array(list(people.values()))[drawn].sum(axis=1))
        low, high = np.nanpercentile(kappas, [tail, 100.0 - tail], axis=0)
    count, agreed, chance = total.T
    columns = {"participants": len(people), "occasions": count.astype(int)}
    columns |= {"agreement": agreed / count, "chance": chance / count, "kappa": _kappa(total)}
    index = pd.Index(ADVISERS, name="policy")
    return pd.DataFrame(columns | {"low": low, "high": high}, index)


def _sums(table: pd.DataFrame, policy: str) -> tuple[float, float, float]:
    """Return occasions of a run, agreements, and those expected by chance."""
    if table.empty:
        return 0.0, 0.0, 0.0
    chosen, picked = table["chosen"], table[policy]
    shares = chosen.value_counts(normalize=True)
    expected = shares.mul(picked.value_counts(), fill_value=0.0).sum()
    return len(table), (chosen == picked).sum(), expected


def _kappa(sums: np.ndarray) -> np.ndarray:
    """Return κ of occasions, agreements and expected agreements; NaN where chance is certain."""
    count, agreed, expected = np.moveaxis(sums, -1, 0)
    room = np.where(count - expected > 1e-9, count - expected, np.nan)
    return (agreed - expected) / room
