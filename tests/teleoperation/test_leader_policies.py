"""
Leader policies: the most trusted leads, hysteresis waits, sequences are followed, every switch is
to another robot after τ_min.
"""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from trustlab.teleoperation.team.decisions import (
    POLICIES,
    GivenSequence,
    MostTrusted,
    RandomLeaders,
    TeamSituation,
)

NOTHING = np.zeros((10, 3))
TRUST = np.array([[0.5, 0.4], [0.5, 0.6], [0.5, 0.6], [0.5, 0.6], [0.7, 0.6], [0.7, 0.6]])


def lead(policy, trust, dwell, step=0.1, seed=0):
    """Return whom a policy picks, every `step`, where whoever it picks leads."""
    names = tuple("abcdefghi"[: trust.shape[1]])
    rng, memory, present = np.random.default_rng(seed), {}, np.ones(len(names), bool)
    leader, since = None, 0.0
    picks = []
    for k, now in enumerate(trust):
        times = since, dwell
        situation = k * step, names, present, present, now, leader, *times, rng, memory, None
        picks.append(policy.leader(TeamSituation(*situation)))
        if picks[-1] != leader:
            leader, since = picks[-1], k * step
    return np.array(picks)


@given(
    st.integers(0, 10_000),
    st.sampled_from(sorted(POLICIES)),
    st.floats(0.05, 20.0),
    st.integers(2, 9),
)
def test_leaders_stay_for_the_minimum(seed, name, dwell, robots):
    trust = np.random.default_rng(seed).uniform(size=(400, robots))
    chosen = lead(POLICIES[name], trust, dwell, seed=seed)
    at = np.concatenate([[0], np.flatnonzero(np.diff(chosen)) + 1])
    assert chosen.shape == (400,)
    assert chosen.min() >= 0
    assert chosen.max() < robots
    assert (np.diff(at) * 0.1 >= dwell - 1e-9).all()


@pytest.mark.parametrize(
    ("policy", "trust", "dwell", "leaders"),
    [
        (MostTrusted(), TRUST, 0.2, [0, 0, 1, 1, 0, 0]),
        (MostTrusted(margin=0.15), TRUST, 0.2, [0] * 6),
        (MostTrusted(), np.full((5, 3), 0.5), 0.1, [0] * 5),  # equal trust is no reason to switch
        (GivenSequence(["c", "a"], times=[0.0, 0.45]), NOTHING, 0.2, [2] * 5 + [0] * 5),
        (GivenSequence(["a", "c"]), NOTHING, 0.15, [0, 0, 0, 2, 2, 2, 0, 0, 0, 2]),
        (GivenSequence(), NOTHING, 0.1, [0, 0, 1, 1, 2, 2, 0, 0, 1, 1]),
    ],
)
def test_policies_by_hand(policy, trust, dwell, leaders):
    assert lead(policy, trust, dwell).tolist() == leaders


def test_random_leaders_reach_everyone():
    chosen = lead(RandomLeaders(0.0), np.zeros((2000, 5)), 0.1)
    assert set(chosen) == set(range(5))
    assert (np.diff(chosen) != 0).all()  # another robot each time


def test_names_may_be_tuples():
    assert GivenSequence([(0, 0), (0, 1)], times=[0.0, 5.0]).robots == ((0, 0), (0, 1))
