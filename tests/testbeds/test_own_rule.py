"""
A rule of one's own on the ground robot and the UAV, and studies in which nobody can switch.

Oracles: the rule applied to what was logged gives the modes that were driven, and these modes,
driven as given, give the same log.
"""

import numpy as np
import pytest

import trustlab as tl
from trustlab.models.simulation import Simulation
from trustlab.testbeds import drive_modes, published_operator


class Relay:
    def __init__(self, low=0.28, high=0.32, mode=1):
        self.low = low
        self.high = high
        self.mode = mode
        self.calls = 0

    def step(self, *, tsc, p_r):
        Relay.last = self  # the run's own copy
        self.calls += 1
        return 1 if p_r < self.low else 0 if p_r > self.high else None


def test_a_rule_decides_from_what_is_measured():
    rule = Relay()
    run = tl.run_condition(rule=rule, participant=2, laps=4, seed=3)
    log = run.session
    modes, now = [], 1
    for k, (t, p_r) in enumerate(zip(log.t, log["p_r"], strict=True)):
        if t > 99.95:
            now = 1 if p_r < 0.28 else 0 if p_r > 0.32 else now
        modes.append(now)
        assert log["mode"][k] == now
    assert Relay.last.calls == np.sum(log.t > 99.95)
    assert rule.calls == 0
    assert np.count_nonzero(np.diff(modes)) >= 2
    again = drive_modes(np.array(modes), published_operator(2), seed=3)
    for name in ("p_r", "p_h", "r", "path_error", "robot_x", "yaw"):
        np.testing.assert_array_equal(again[name], log[name])
    assert log.metadata.condition == "rule Relay"
    assert log.metadata.synthetic
    assert run.measures["followed_percent"] == 100.0


def test_a_rule_that_switches_often_is_driven_once(monkeypatch):
    class Restless:
        calls = 0

        def step(self, tsc, p_r):
            Restless.calls += 1
            return Restless.calls // 10 % 2

    runs = []
    begin = Simulation.__post_init__
    monkeypatch.setattr(Simulation, "__post_init__", lambda self: begin(self) or runs.append(self))
    run = tl.run_condition(rule=Restless(), participant=2, laps=3, seed=3)
    assert run.measures["switches"] > 100
    (simulated,) = runs
    assert simulated.done == run.log.size


def test_a_rule_flies_too():
    rule = Relay(0.45, 0.52, mode=0)
    run = tl.run_condition(rule=rule, participant=3, testbed="uav_following", seed=3)
    log, now = run.session, 0
    for t, p_r, mode in zip(log.t, log["p_r"], log["mode"], strict=True):
        if t > 99.95:
            now = 1 if p_r < 0.45 else 0 if p_r > 0.52 else now
        assert mode == now
    assert Relay.last.calls == np.sum(log.t > 99.95)
    assert rule.calls == 0
    assert np.count_nonzero(np.diff(log["mode"])) >= 2
    assert log.metadata.condition == "rule Relay"
    # a rule that says what the operator's own suggestions say in C3, forced and without reaction,
    # gives the same modes as (2.8)
    own = tl.run_condition("C3", participant=3, testbed="uav_following", seed=3)
    again = tl.run_condition(
        rule=tl.ThresholdRule(*own.thresholds), participant=3, testbed="uav_following", seed=3
    )
    mode = 1
    for t, tsc, driven in zip(
        again.session.t, again.session["tsc"], again.session["mode"], strict=True
    ):
        if t > 99.95:
            mode = 0 if tsc >= own.thresholds[1] else 1 if tsc <= own.thresholds[0] else mode
        assert driven == mode


def test_rules_that_fail_say_when():
    class Late:
        def step(self, tsc, p_r):
            raise RuntimeError("out of data")

    class Hungry:
        def step(self, tsc, p_r, r):
            return None

    for more, says in (
        (
            {"rule": Late()},
            r"rule.step failed at t = 100.0 s, with TSC = .*RuntimeError: out of data",
        ),
        (
            {"rule": Hungry()},
            r"called as step\(tsc=…, p_r=…\), but is step\(tsc, p_r, r\): missing",
        ),
        ({"rule": 3}, "rule must have a method step"),
        ({"rule": Relay(), "condition": "C3"}, "no effect beside rule="),
        ({"rule": Relay(), "thresholds": (0.0, 0.3)}, "no effect beside rule="),
        (
            {"rule": Late(), "testbed": "uav_following", "laps": None},
            r"rule.step failed at t = 100.0 s.*out of data",
        ),
        ({}, "condition must be one of .*or rule="),
    ):
        with pytest.raises(ValueError, match=says):
            tl.run_condition(**{"participant": 2, "laps": 2} | more)
