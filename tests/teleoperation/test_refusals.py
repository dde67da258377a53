"""
What the parts of a teleoperation loop refuse: arguments that do not go together.
What tests/test_contract.py puts into every argument is not tried here again.
"""

import numpy as np
import pytest

import trustlab as tl
from trustlab.teleoperation.channel import channel_run
from trustlab.teleoperation.delays import Delay, packet_delay
from trustlab.teleoperation.filters import TwoPortFilter, corrected_filter, passivity_margin
from trustlab.teleoperation.ports.waves import Scattering
from trustlab.teleoperation.team.decisions import GivenSequence, MostTrusted, policy_named

ONES, UNIT = np.ones((50, 1)), Scattering(1.0)
SENT = [0.0, 0.1, 0.2, 0.3]


def send(scattering=UNIT, **change):
    return channel_run(ONES, ONES, scattering, 0.01, **change)


def trace(*packets):
    return packet_delay(*packets).samples(7, 0.1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: Scattering(1.0, alpha_min=0.9, alpha_max=0.3),
            "must not exceed alpha_max",
        ),
        (lambda: send(delay_1=0.0), "at least one sample"),
        (lambda: send(alpha=1.5), "alpha must lie in"),
        (lambda: send([], leaders=np.zeros(50, int)), "numbers of the 0 robots"),
        (
            lambda: Delay(lambda t: 0.1 - t, 0.1, "this delay").samples(50, 0.01),
            r"0 s at t = 0\.1 s: it must be at least one sample",
        ),
        (lambda: trace(SENT, [0.1, 0.05, 0.3, 0.4]), "packet 1, sent at t = 0.1 s, was"),
        (lambda: trace(SENT, [np.nan] * 4), "ever received"),
        (
            lambda: trace(SENT, [0.1, 0.5, np.nan, 0.4]),
            "until 0.5 s, and the run lasts until 0.6 s",
        ),
        (lambda: TwoPortFilter(1.0, 0.2, 1.0), r"k_12 k_21 = 0\.2"),
        (lambda: passivity_margin([1.0], [1.0, -1.0]), "stable"),
        (lambda: passivity_margin([1.0, 0.0, 0.0], [1.0, 1.0]), "proper"),
        (lambda: corrected_filter(1.0, 1.0).run(np.zeros(3), np.zeros(4), 0.1), "same shape"),
        (lambda: GivenSequence([0, 1], times=[0.0]), "times"),
        (lambda: policy_named(MostTrusted), "must be one of"),  # a class, no policy
        (
            lambda: tl.simulate_team(np.ones((2, 2)) - np.eye(2), GivenSequence(["z", 0])),
            "'z', which does not exist",
        ),
    ],
)
def test_parts(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_a_session_without_the_signals():
    run = tl.simulate_teleoperation("M", seed=1, duration=1.0)
    with pytest.raises(tl.SessionError, match="f_s_y"):
        tl.passivity(tl.Session(run.data.drop(columns="f_s_y"), run.metadata))
