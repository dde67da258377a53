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
    free, leader = session["may_switch"] > 0, session["leader"].astype(int)
    length = round(dwell / session.sample_time)
    rows = []
    k = 0
    while k < len(session):
        if not free[k]:
            k += 1
            continue
        ahead = leader[k : k + length + 1]
        if len(ahead) <= length and (ahead == leader[k]).all():
            break  # the run ended before the person had the time
        switched = np.flatnonzero(ahead != leader[k])
        end = k + int(switched[0]) if switched.size else k + length
        picks = (int(session[f"leader_{name}"][k]) for name in ADVISERS)
        rows.append((session.t[k], *picks, leader[end]))
        k = end
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
    people: dict[str, list[pd.DataFrame]] = {}
    for session in sessions:
        if session.metadata.condition == BY_HAND:
            table = occasions(session, session.metadata.more["min_dwell"])
            people.setdefault(str(session.metadata.participant), []).append(table)
    if not any(len(table) for tables in people.values() for table in tables):
        raise ValueError(f"nobody had an occasion to choose; runs in {BY_HAND!r} are needed")
    rng = np.random.default_rng(seed)
    drawn = rng.integers(len(people), size=(draws, len(people)))
    rows = []
    for name in ADVISERS:
        sums = np.array([_sums(tables, name) for tables in people.values()])
        count, agreed, chance = sums.sum(axis=0)
        low = high = np.nan
        if len(people) > 1:
            kappas = _kappa(sums[drawn].sum(axis=1).T)
            low, high = np.nanpercentile(kappas, [tail, 100.0 - tail])
        kappa = float(_kappa(sums.sum(axis=0)))
        shares = agreed / count, chance / count
        rows.append((name, len(people), int(count), *shares, kappa, low, high))
    columns = ["policy", "participants", "occasions", "agreement", "chance", "kappa", "low", "high"]
    return pd.DataFrame(rows, columns=columns).set_index("policy")


def _sums(tables: list[pd.DataFrame], policy: str) -> np.ndarray:
    """Return occasions, agreements, and those expected by chance, summed over runs."""
    sums = np.zeros(3)
    for table in tables:
        if len(table):
            chosen, picked = table["chosen"], table[policy]
            shares = chosen.value_counts(normalize=True)
            expected = shares.mul(picked.value_counts(), fill_value=0.0).sum()
            sums += (len(table), (chosen == picked).sum(), expected)
    return sums


def _kappa(sums: np.ndarray) -> np.ndarray:
    """Return κ of occasions, agreements and expected agreements; NaN where chance is certain."""
    count, agreed, expected = sums
    room = count - expected
    # where all agree by chance nothing is left to tell
    return np.where(room > 1e-9, (agreed - expected) / np.where(room > 1e-9, room, 1.0), np.nan)
