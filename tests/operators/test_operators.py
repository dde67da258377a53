"""Simulated people: operators of the ground robot and teleoperators."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trustlab as tl
from tests.cases import flight, refused
from tests.loops import columns, missed
from trustlab import TeleoperationLoop, Teleoperator, TrackingTask, simulate_teleoperation
from trustlab.operators import operator, simulated_answers
from trustlab.operators.answers import agreeing, experience
from trustlab.operators.ground_robot import ASSUMPTIONS
from trustlab.teleoperation import STUDIES, Guidance
from trustlab.testbeds import TeleoperatorPopulation
from trustlab.testbeds.ground_robot.kernel import drive_modes

# --- teleoperators --------------------------------------------------------------------------------


# No force on the hand, and nothing that guards it.
FREE = Guidance(guard="off", force=lambda state: (0.0, 0.0, 0.0))


def test_numbers_are_the_operators_own():
    numbers = Teleoperator(reaction=0.3, lag=0.2, patience=2.0).numbers(0.01, 0.1)
    assert (numbers["delay"], numbers["patience"]) == (40, 200)
    assert numbers["decay"] == pytest.approx(np.exp(-0.05))


def test_allocating_by_hand_costs_a_share_of_the_command_in_mmi_alone():
    costly = Teleoperator(allocation_cost=0.25)
    for scheme, same in (("MMI", Teleoperator(compensation=0.75)), ("M", Teleoperator())):
        runs = [simulate_teleoperation(scheme, who, duration=10.0).data for who in (costly, same)]
        assert runs[0].equals(runs[1]), scheme


def test_a_hand_tires_with_what_it_has_pushed():
    """Oracle: the law and the sum of forces, sample by sample."""
    who = Teleoperator(fatigue=2.0, noise=0.0)
    loop = TeleoperationLoop("M", who, seed=3)
    decay, pushed, wish = np.exp(-0.01 / who.lag), 0.0, np.zeros(3)
    for _ in range(400):
        before = loop.state.copy()
        seen = who.proportional * before.seen
        if before.sees:
            seen = seen + who.derivative * (before.seen - before.seen_before) / 0.01
        pushed += 0.01 * np.linalg.norm(before.f_h)
        strength = 1.0 / (1.0 + who.fatigue / 60.0 * pushed)
        wish = decay * wish + (1.0 - decay) * strength * np.clip(seen, -who.reach, who.reach)
        assert_allclose(loop.step().wish, wish, rtol=1e-10, atol=1e-15)
    assert strength < 0.95


def test_assumptions_about_teleoperators():
    population = TeleoperatorPopulation("main")
    plain = population.draw(60, seed=1)
    assert set(plain["law"]) == {"proportional"}
    assumptions = {"adapting": 0.4, "gain": 1.5, "crossover": 0.8, "lag": 0.1, "compensation": 2.0}
    assumptions |= {"allocation_cost": 0.3, "fatigue_of_hand": 0.2}
    changed = population.draw(60, seed=1, assumptions=assumptions)
    adapts = changed["law"] == "crossover"
    assert 10 <= adapts.sum() <= 38
    names, factors = ["proportional", "derivative", "crossover"], [1.5, 1.5, 0.8]
    assert_allclose(changed[names], factors * plain[names], rtol=1e-12)
    assert_allclose(changed["lag"], plain["lag"] + 0.1, rtol=1e-12)
    person = population.person(changed.iloc[5].to_dict())
    assert (person.compensation, person.allocation_cost, person.fatigue) == (2.0, 0.3, 0.2)


def stepped(loop, count):
    """The states before each of so many samples."""
    states = []
    for _ in range(count):
        states.append(loop.state.copy())
        loop.step()
    return states


def test_the_eye_sees_late_and_a_target_that_leaves_the_picture_is_lost_to_eye_and_controller():
    """
    Against the logged path; T = 0.01 s, reaction 0.25 s and camera 0.1 s: 35 samples.
    """
    task = TrackingTask(failure_every=1e9, view=0.1, integral=0.0)
    signals = {"push": np.full((1500, 3), 2.0)}
    loop = TeleoperationLoop("MI", seed=4, duration=15.0, task=task, signals=signals)
    states, run = stepped(loop, 1500), loop.session
    error = missed(run)[:, :2]
    inside = (np.abs(error) <= 0.1).all(axis=1)
    assert 100 < inside.sum() < 1400, inside.sum()
    for k in range(36, 1500, 7):
        assert states[k].sees == inside[k - 35], k
        assert states[k].finds == inside[k - 10], k
        last = np.flatnonzero(inside[: k - 34])[-1]
        assert_allclose(states[k].seen[:2], error[last], atol=1e-12)
        if not inside[k - 10]:
            assert_array_equal(states[k].u_a, 0.0)


def test_compensation_scales_what_the_hand_does():
    """
    Oracle: without noise and force the device is linear in what is wanted.
    """
    task, wanted = TrackingTask(failure_every=1e9), []
    for factor in (1.0, 1.5):
        who = Teleoperator(compensation=factor, noise=0.0)
        loop = TeleoperationLoop("M", who, seed=2, delay=0.01, task=task, guidance=FREE)
        # the first pictures, of the same path
        wanted.append(np.array([state.wanted for state in stepped(loop, 38)[36:]]))
    assert_allclose(wanted[1], 1.5 * wanted[0], rtol=1e-9)
    assert wanted[0].any(axis=1).all()


@pytest.mark.parametrize("alpha", [0.3, 1.0])
def test_who_adapts_keeps_the_crossover(alpha):
    """
    The gain from the error seen to what the robot is told: ω_c whatever α, where a fixed gain
    is scaled by the channel.
    """
    gains = {}
    signals = {"alpha": np.full(11_000, alpha)}
    same = {"seed": 6, "duration": 110.0, "delay": 0.01, "signals": signals, "guidance": FREE}
    for law in ("crossover", "proportional"):
        laws = {"law": law, "crossover": 0.8, "proportional": 0.8, "derivative": 0.0}
        run = simulate_teleoperation("M", Teleoperator(**laws, noise=0.0, reach=5.0), **same)
        # what is seen is the error, late by 35 samples
        error = missed(run)[5965:-35, :2]
        told = columns(run, "r_s")[6000:, :2]
        gains[law] = np.sqrt(np.mean(told**2) / np.mean(error**2))
    assert gains["crossover"] == pytest.approx(0.8, rel=0.15)  # less what lag and device take
    assert gains["proportional"] < 0.7 * gains["crossover"]


def made(error, force, alpha, p_h, p_r):
    """A session with constant signals, so that what was gone through is known in closed form."""
    names = ["path_error", "f_h_x", "f_h_y", "f_h_z", "alpha", "p_h", "p_r"]
    rows = np.tile([error, force, 0.0, 0.0, alpha, p_h, p_r], (50, 1))
    data = pd.DataFrame(rows, index=pd.Index(0.1 * np.arange(50), name="t"), columns=names)
    return tl.Session(data)


@pytest.mark.parametrize(
    ("signals", "felt"),
    [
        # main study: error range 3 m, holding force K/Λ + β_max b = 2 + 1 N, α in [0.2, 1]
        ((0.6, 3.0, 0.6, 0.3, 0.9), (0.2, 0.5, 1.0 - abs(0.5 - 0.25))),
        ((30.0, 0.0, 1.0, 0.0, 0.0), (1.0, 0.0, 0.5)),
    ],
)
def test_experience_in_closed_form(signals, felt):
    expected = dict(zip(("error", "effort", "agreement"), felt, strict=True))
    assert experience(made(*signals)) == pytest.approx(expected)


def test_assumptions_are_off_unless_asked_for(operators):
    plain = operator("pilot", operators["pilot"])
    assert {getattr(plain, name) for name in ASSUMPTIONS} == {0.0}


def test_a_mode_agrees_with_a_rule_that_begins_in_it():
    assert agreeing(np.array([1.0, 1.0, 0.0]), np.full(3, 0.5), 0.2, 0.8) == 2 / 3


def test_answers_follow_what_was_gone_through():
    calm, rough = made(0.1, 0.1, 0.6, 0.5, 0.5), made(2.5, 20.0, 0.2, 0.9, 0.1)
    low, high = simulated_answers(calm), simulated_answers(rough)
    for name in ("mental", "physical", "temporal", "performance", "effort", "frustration"):
        assert high[name] > low[name] + 20
        assert low[name] % 5 == high[name] % 5 == 0
    for name in ("satisfaction", "comfort", "control", "trust"):
        assert high[name] < low[name] - 1
    assert 1 <= high["trust"] <= low["trust"] <= 7


def test_answers_by_settings_that_a_run_does_not_have_are_refused():
    wide = replace(STUDIES["main"], error_range=9.0)
    for study, words in (
        ("preliminary", r"study 'preliminary study .*', not 'main study .*; pass"),
        (wide, r"settings 'error_range = 9\.0', not 'as usual'"),
    ):
        run = simulate_teleoperation("TMIG", study=study, duration=5.0)
        assert simulated_answers(run, study)
        with refused(words):
            simulated_answers(run)


def test_answers_keep_to_their_points():
    few = simulated_answers(flight(), points=5)
    assert max(few[name] for name in ("satisfaction", "comfort", "control")) <= 5


# --- the ground robot -----------------------------------------------------------------------------


def by_hand(who, **more):
    """Mean performance of an operator who drives by hand for 400 s, without the first 100 s."""
    runs = [drive_modes(np.ones(4000, int), who, seed, **more) for seed in range(4)]
    return np.mean([run["p_h"][1000:].mean() for run in runs])


@pytest.mark.parametrize("level", [0.37, 0.41, 0.46])
def test_measured_performance_is_the_models(level):
    # Oracle: (2.7) on the log; utilization has no say, the model being flat.
    flat = tl.HumanModel(a=0.999, beta=0.7, p_min=level - 1e-9, p_max=level + 1e-9)
    assert by_hand(tl.Operator("flat", flat)) == pytest.approx(level, abs=0.006)


def test_skill_follows_utilization(operators):
    # Yerkes–Dodson: best at r = β, worse when idle and when overworked; the same noise.
    model = replace(operators["pilot"].human, a=0.999999)
    who = replace(operator("pilot", operators["pilot"]), human=model)
    idle, best, overworked = (by_hand(who, r0=r0) for r0 in (0.02, 0.74, 0.9999))
    assert best > max(idle, overworked) + 0.02


def test_a_delayed_hand_weaves(operators):
    # A longer delay destabilises the same steering law.
    who = replace(operator("pilot", operators["pilot"]), noise=0.0, steering_gain=2.5)
    calm, weaving = (
        drive_modes(np.ones(3000, int), replace(who, delay=delay), 0)["w_command"].std()
        for delay in (0.0, 0.9)
    )
    assert weaving > 1.5 * calm
