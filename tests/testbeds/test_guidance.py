"""Guidance, and the guards that keep flights passive: energy balances from the log."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from tests.loops import T, columns, each_guidance, jitter, missed, power
from trustlab import Teleoperator, TrackingTask, simulate_teleoperation
from trustlab.teleoperation import STUDIES, DivergenceError, Guidance, GuidanceBudget

# --- guidance -------------------------------------------------------------------------------------


MAIN = STUDIES["main"]
IDLE = Teleoperator(proportional=0.0, derivative=0.0, noise=0.0, stiffness=0.0, damping=0.0)


def switching(state):
    """Scales that jump between their bounds."""
    number = int(state.t * 7.0 + 0.5)
    alpha = state.alpha_min if number % 3 == 0 else state.alpha_max
    return alpha, state.beta_min if number % 5 < 2 else state.beta_max


SWITCHING = tl.Scheme("switching", switching)


def taken_at_random(guidance, seed, seconds):
    """
    The energy [J] that the operator's port has taken by the end of each sample of a random run,
    from the logged signals.
    """
    rng, count = np.random.default_rng([5, seed]), round(seconds / T)
    walks, most = rng.integers(1 << 30, size=2), rng.uniform(0.05, 0.8, 2)
    study = STUDIES[("main", "preliminary")[seed % 2]]
    study = replace(study, k_ffa=study.k_ffa * 10.0 ** rng.uniform(-1.0, 2.0))
    who = Teleoperator(
        noise=rng.uniform(0.0, 1.5),
        stiffness=rng.uniform(0.0, 120.0),
        damping=rng.uniform(0.0, 5.0),
        proportional=rng.uniform(0.0, 3.0),
        reach=2.0,
    )
    delay = tuple(jitter(int(walk), late) for walk, late in zip(walks, most, strict=True))
    signals = {
        "arrives": rng.uniform(size=(count, 2)) >= 0.5,
        "push": rng.normal(size=(count, 3)) * rng.uniform(0.0, 3.0),
    }
    parts = {"delay": delay, "guidance": guidance, "signals": signals}
    scheme = (SWITCHING, "TMIS", "TMIG", "MMI")[seed % 4]
    try:
        run = simulate_teleoperation(scheme, who, study, seed, seconds, **parts)
    except DivergenceError as error:
        run = error.session
    given = T * power(run, "r_m", "f_m")
    rounding = 1e-9 * np.abs(given).sum() + 1e-14
    assert_allclose(run["energy_port"], given.cumsum(), rtol=1e-9, atol=rounding)
    exchanged = T * np.abs(columns(run, "r_m") * columns(run, "f_m")).sum(axis=1).cumsum()
    assert (run["energy_channel"] >= -1e-9 * exchanged - 1e-12).all()
    return given.cumsum()


def deepest(guidance, guard, seeds):
    """How far the energy at the operator's port falls below zero [J] in random runs."""
    chosen = Guidance(guidance, guard)
    return [min(taken_at_random(chosen, seed, 15.0).min(), 0.0) for seed in range(seeds)]


def overspent(seeds, guard="repay", budgeted=True):
    """
    By how much random runs give out more than a random budget allows, in that stretch of samples
    where it is worst [J].
    """
    excess = []
    for seed in range(seeds):
        rng = np.random.default_rng([8, seed])
        energy, rate = (0.0, *10.0 ** rng.uniform(-2.0, 0.5, 2), 0.0)[seed % 3 :][:2]
        budget = GuidanceBudget(energy, rate) if budgeted else None
        taken = taken_at_random(Guidance("at_operator", guard, budget), seed, 4.0)
        # From sample i to sample j the port gives out −(taken_j − taken_i), and may give out
        # energy + rate (j − i) T: the greatest fall of what follows is at most `energy`.
        rise = np.concatenate([[0.0], taken + rate * T * np.arange(1, taken.size + 1)])
        excess.append((np.maximum.accumulate(rise) - rise).max() - energy)
    return excess


@each_guidance
@pytest.mark.parametrize("seeds", [10, pytest.param(500, marks=pytest.mark.long)])
def test_the_operators_port_never_gives_out_more_than_it_took(seeds, guidance):
    assert min(deepest(guidance, "repay", seeds)) >= -1e-9


@pytest.mark.parametrize("seeds", [60, pytest.param(2000, marks=pytest.mark.long)])
def test_a_budget_bounds_what_the_port_gives_out_in_any_stretch_of_time(seeds):
    assert max(overspent(seeds)) <= 1e-9


def test_what_breaks_the_bound_of_a_budget():
    assert min(overspent(6, guard="off", budgeted=False)) > 0.1
    # the printed rule overdraws by up to a sample's power
    assert max(overspent(6, guard="cancel")) > 1e-3
    # without a budget the port never falls below zero, but spends at once what it saved for long
    assert max(overspent(12, budgeted=False)) > 0.05


def test_a_budget_is_felt_and_is_off_by_default():
    budget, same = GuidanceBudget(energy=0.2, power=0.5), {"seed": 1, "duration": 30.0}
    usual, freer = (
        simulate_teleoperation("M", guidance=Guidance(budget=b), **same) for b in (None, budget)
    )
    assert usual == simulate_teleoperation("M", **same)
    before, felt = tl.teleoperation_measures([usual, freer]).to_dict("records")
    assert before["guidance_felt"] < 0.6
    assert before["guarded"] > 0.95
    assert felt["guidance_felt"] > 0.9
    assert felt["guarded"] < 0.5
    assert -budget.bound(30.0) <= felt["energy_port_min"] < -1.0


@each_guidance
def test_without_its_guard_every_guidance_gives_energy_out(guidance):
    assert min(deepest(guidance, "off", 4)) < -0.1


def test_the_exception_is_the_printed_guidance_without_its_guard_a_hidden_autopilot():
    run = simulate_teleoperation("M", IDLE, guidance=Guidance("through_channel", "off"))
    assert run["path_error"].mean() == pytest.approx(0.07, abs=0.005)
    # the energy comes from the target, a port that the controller does not observe
    given = -run["energy_robot"][-1]
    assert run["energy_target"][-1] / given == pytest.approx(1.0, abs=0.03)
    # by (3.22) the force drives the robot, whatever the operator does: r_s = α (open − f_s/b) with
    # nothing arriving
    b = MAIN.scattering.b
    assert_allclose(columns(run, "r_s")[:3], -columns(run, "f_s")[:3] / b, atol=1e-12)


def guided(stiffness, guard):
    study, guidance = replace(MAIN, k_ffa=stiffness), Guidance("through_channel", guard)
    return simulate_teleoperation("M", study=study, seed=1, guidance=guidance)


def test_the_printed_controller_stops_the_operator_and_stiff_guidance_is_not_passive_under_it():
    errors = [guided(stiffness, "cancel")["path_error"].mean() for stiffness in (0.0, 6.0, 60.0)]
    assert np.ptp(errors) < 0.02  # whatever the stiffness: nothing of it is left
    assert guided(600.0, "cancel")["energy_robot"].min() < -0.5
    assert guided(600.0, "repay")["energy_robot"].min() > -1e-9


@pytest.mark.parametrize("view", [0.3, 20.0])
def test_no_force_towards_a_target_that_nobody_sees(view):
    """The second camera, the negative control, sees all of the way."""
    task, asked = TrackingTask(view=view, speed=1.5), []
    spring = Guidance(
        guard="off", force=lambda s: asked.append(s.stretch.copy()) or -6.0 * s.stretch
    )
    run = simulate_teleoperation("M", IDLE, seed=1, duration=30.0, task=task, guidance=spring)
    late = round(task.camera_delay / T)
    error = missed(run)[:-late]
    seen = (np.abs(error[:, :2]) <= view).all(axis=1)
    asked = np.array(asked)[-len(run) :]
    assert not asked[:late].any()
    assert_allclose(asked[late:], error * seen[:, None], atol=1e-12)
    assert seen.mean() < 0.5 if view == 0.3 else seen.all()
