"""
The bound over many switches, against runs whose thresholds jump anywhere within their limits at
every sample.
"""

import numpy as np
import pytest

from trustlab.allocation.correction.phase_bound import least_effort
from trustlab.models.human import HumanModel
from trustlab.models.published import published_models
from trustlab.models.robot import RobotModel
from trustlab.models.tsc import TscModel

PILOT = published_models()["pilot"]


def effort(model, r, p_r, mode, limits, steps, choose):
    """
    Cumulative sums of f, written out, and the number of switches; `choose` gives both thresholds at
    each sample.
    """
    sums = [0.0]
    switches = 0
    robot = model.robot
    human = model.human
    for k in range(steps):
        p_h = human.p_min
        if 0 < r < 1:
            share = (r / human.beta) ** human.beta * ((1 - r) / (1 - human.beta)) ** (
                1 - human.beta
            )
            p_h += (human.p_max - human.p_min) * share
        if k > 0:
            tsc = model.a_T * p_r - model.b_T * p_h
            lower, upper = choose(k, mode, tsc)
            now = 0 if tsc >= upper else 1 if tsc <= lower else mode
            switches += now != mode
            mode = now
        sums.append(
            sums[-1] + min(max(r + (p_r - robot.p_min) / (robot.p_max - robot.p_min), 0.0), 2.0)
        )
        p_r = robot.a * p_r + (1 - robot.a) * robot.p_min + mode * robot.b * p_h
        r = human.a * r + (1 - human.a) * mode
    return np.array(sums), switches


def drawn(rng):
    """A model, its state and limits of both thresholds in which it switches often."""
    if rng.random() < 0.3:
        model = PILOT
    else:
        h_min, r_min = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.4)
        h_max, r_max = h_min * (1 + rng.uniform(0.05, 0.5)), r_min * (1 + rng.uniform(0.2, 1.0))
        human = HumanModel(1 - 10 ** rng.uniform(-3.3, -0.5), rng.uniform(0.3, 0.9), h_min, h_max)
        model = TscModel(RobotModel(1 - 10 ** rng.uniform(-2.5, -0.7), r_min, r_max, h_max), human)
    upper, width = rng.uniform(-0.2, 0.6), rng.uniform(0.02, 0.5)
    spread = 10 ** rng.uniform(-4, -1)
    limits = np.array([[upper - width, upper - width + spread], [upper, upper + spread]])
    limits[0, 1] = min(limits[0, 1], upper - 1e-6)
    r, p_r = rng.random(), rng.uniform(model.robot.p_min, model.robot.p_max)
    tsc = model.value(p_r, model.human.performance(r))
    mode = 1 if tsc <= limits[0, 0] else 0 if tsc >= limits[1, 1] else int(rng.integers(2))
    return model, r, p_r, mode, limits


def choices(rng, limits, kind):
    """
    Thresholds that jump at random, that keep to one end of their limits, or that put every switch
    off or forward.
    """
    if kind == "random":
        return lambda k, mode, tsc: rng.uniform(limits[:, 0], limits[:, 1])
    if kind == "late":
        return lambda k, mode, tsc: (limits[0, 0], limits[1, 1])
    if kind == "early":
        return lambda k, mode, tsc: (limits[0, 1], limits[1, 0])
    if kind == "low":
        return lambda k, mode, tsc: limits[:, 0]
    return lambda k, mode, tsc: limits[:, 1]


@pytest.mark.parametrize("part", range(4))
def test_no_run_beats_the_bound(part):
    rng = np.random.default_rng(np.random.SeedSequence(61).spawn(4)[part])
    proved = close = 0
    for _ in range(20):
        model, r, p_r, mode, limits = drawn(rng)
        c, steps = model.constants(), int(rng.integers(200, 1500))
        for sign in (1.0, -1.0):
            lean = sign * rng.choice([0.0, 0.55, -0.5]) / (1 - model.human.a)
            rho, extra = least_effort(r, p_r, float(mode), steps, limits, sign, lean, c)
            if not np.isfinite(extra):
                continue
            least, switches = np.inf, 0
            for kind in ("random", "late", "early", "low", "high"):
                sums, count = effort(model, r, p_r, mode, limits, steps, choices(rng, limits, kind))
                slack = sign * sums - (rho * np.arange(steps + 1) + extra)
                assert slack.min() >= -1e-8, (model, r, p_r, mode, limits, sign, kind)
                least, switches = min(least, slack[-1]), max(switches, count)
            proved += switches > 2
            close += switches > 2 and least < 0.1 * steps
    assert proved > 6
    assert close > 4


def test_the_bound_is_close_for_the_pilot_operator():
    """
    Over an hour with thresholds that hardly move: within two parts in a thousand of what runs do.
    """
    limits, c = np.array([[0.02, 0.021], [0.45, 0.451]]), PILOT.constants()
    sums, switches = effort(PILOT, 0.8, 0.36, 1, limits, 36_000, choices(None, limits, "low"))
    assert switches > 90
    for sign in (1.0, -1.0):
        rho, extra = least_effort(0.8, 0.36, 1.0, 36_000, limits, sign, sign * 600.0, c)
        bound = rho * 36_000 + extra
        assert bound <= sign * sums[-1]
        assert bound == pytest.approx(sign * sums[-1], rel=4e-3)


def test_nothing_is_proved_where_the_work_would_be_too_much():
    """
    Thresholds anywhere and phases that never end: the bound says −∞, not a number that is too good.
    """
    limits, c = np.array([[-1.0, 0.4], [0.4, 1.0]]), PILOT.constants()
    assert least_effort(0.0, 0.24, 1.0, 1_000_000, limits, 1.0, 0.0, c)[1] == -np.inf
