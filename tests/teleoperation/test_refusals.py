"""
What the parts of a teleoperation loop refuse: ranges, and arguments that do not go together.
What tests/test_contract.py puts into every argument is not tried here again.
"""

import numpy as np
import pytest

import trustlab as tl
from trustlab.teleoperation.channel import channel_run
from trustlab.teleoperation.delays import Delay, packet_delay
from trustlab.teleoperation.filters import (
    TwoPortFilter,
    corrected_filter,
    passivity_margin,
    printed_filter,
    sinusoid_energy,
)
from trustlab.teleoperation.ports.device import HapticDevice
from trustlab.teleoperation.ports.waves import EnergyLedger, Scattering
from trustlab.teleoperation.team.decisions import GivenSequence, MostTrusted, policy_named
from trustlab.teleoperation.transparency import rendered_impedance

ONES, UNIT = np.ones((50, 1)), Scattering(1.0)
SENT = [0.0, 0.1, 0.2, 0.3]


def send(scattering=UNIT, **change):
    return channel_run(ONES, ONES, scattering, 0.01, **change)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Scattering(1.0, alpha_min=0.9, alpha_max=0.3), "alpha_min must not exceed"),
        (lambda: Scattering(1.0, alpha_max=1.1), r"alpha_max must not exceed 1 \(3\.1\)"),
        (lambda: EnergyLedger(0.0), "sample_time must be positive"),
        (lambda: rendered_impedance(UNIT, [1.0], [1.0, 2.0]), "environment must be"),
        (lambda: send(delay_1=-0.1), "delay_1: a constant delay must not be negative"),
        (lambda: send(delay_1=(0.1, 0.2)), "delay_1: a constant delay must be a number"),
        (lambda: send(delay_1=0.0), "at least one sample"),
        (lambda: send(alpha=1.5), "alpha must lie in"),
        (lambda: send([UNIT], leaders=np.zeros(50)), "whole numbers"),
        (lambda: send([], leaders=np.zeros(50, int)), "there are 0 robots"),
        (
            lambda: Delay(lambda t: 0.1 - t, 0.1, "this delay").samples(50, 0.01),
            r"0 s at t = 0\.1 s: it must be at least one sample",
        ),
    ],
)
def test_channels(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    ("sent", "received", "words"),
    [
        (SENT, [0.1, 0.05, 0.3, 0.4], "packet 1, sent at t = 0.1 s, was received before"),
        (SENT, [np.nan] * 4, "ever received"),
        (SENT, [0.1, 0.5, np.nan, 0.4], r"until 0\.5 s, and the run lasts until 0\.6 s"),
        (SENT, [0.1], "same number of packets"),
        ([0.0, 0.2, 0.1, 0.3], [0.5] * 4, "packet 2, sent at t = 0.1 s, .*before the packet bef"),
        ([100.0, 101.0], [100.5, 101.5], "give seconds from the start of the run"),
    ],
)
def test_traces(sent, received, words):
    with pytest.raises(ValueError, match=words):
        packet_delay(sent, received).samples(7, 0.1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: printed_filter(0.0), "cutoff must be positive"),
        (lambda: corrected_filter(0.0, 1.0), "cutoff must be positive"),
        (lambda: corrected_filter(1.0, 0.0), "impedance must be positive"),
        (
            lambda: HapticDevice(0.001, 0.55, 100.0, 60.0, port_damping=-0.1),
            "port_damping must not",
        ),
        (lambda: TwoPortFilter(1.0, 0.2, 1.0), r"k_12 k_21 = 0\.2"),
        (lambda: passivity_margin([1.0], [1.0, -1.0]), "stable"),
        (lambda: passivity_margin([1.0, 0.0, 0.0], [1.0, 1.0]), "proper"),
        (lambda: corrected_filter(1.0, 1.0).run(np.zeros(3), np.zeros(4), 0.1), "same shape"),
        (lambda: corrected_filter(1.0, 1.0).run([0.0, np.nan], [0.0, 1.0], 0.1), "sample 1"),
        (
            lambda: sinusoid_energy(printed_filter(1.0), 1e-4),
            r"duration must lie in \[0\.001, ",
        ),
    ],
)
def test_filters_and_devices(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: GivenSequence([]), "at least one"),
        (lambda: GivenSequence([0, 1], times=[0.0]), "times"),
        (lambda: MostTrusted(-0.1), "margin"),
        (lambda: policy_named(MostTrusted), "must be one of"),  # a class, no policy
        (
            lambda: tl.simulate_team(np.ones((2, 2)) - np.eye(2), GivenSequence(["z", 0])),
            "'z', which does not exist",
        ),
    ],
)
def test_policies(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    ("left", "words"), [("f_s_y", "f_s_y"), ("[rf]_[ms]_.", "r_m_x")], ids=["one", "all"]
)
def test_a_session_without_the_signals(left, words):
    run = tl.simulate_teleoperation("M", seed=1, duration=1.0)
    dropped = run.data.columns[run.data.columns.str.fullmatch(left)]
    with pytest.raises(tl.SessionError, match=words):
        tl.passivity(tl.Session(run.data.drop(columns=dropped), run.metadata))
