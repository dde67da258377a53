"""
Guidance: the operator's port gives out no energy that it did not take, and no guidance is a hidden
autopilot.
"""

from dataclasses import replace

import numpy as np
import pytest

import trustlab as tl
from tests.flights import T, columns, jitter, phase
from trustlab.teleoperation import STUDIES, DivergenceError, Guidance, GuidanceBudget
from trustlab.teleoperation.loop.kernel import GUIDANCE
from trustlab.testbeds.uav_tracking import TASKS, TrackingTask

IDLE = tl.Teleoperator(proportional=0.0, derivative=0.0, noise=0.0, stiffness=0.0, damping=0.0)


def switching(state):
    """Scales that jump between their bounds."""
    number = int(state.t * 7.0 + 0.5)
    alpha = state.alpha_min if (number * 2654435761) % 3 == 0 else state.alpha_max
    return alpha, state.beta_min if (number * 40503) % 5 < 2 else state.beta_max


SWITCHING = tl.Scheme("switching", switching)


def taken_at_random(guidance, guard, seed, seconds, budget=None):
    """
    The energy [J] that the operator's port has taken by the end of each sample of a random run,
    from the logged signals.
    """
    rng, count = np.random.default_rng([5, seed]), round(seconds / T)
    delays = [
        jitter(int(own), most)
        for own, most in zip(rng.integers(1 << 30, size=2), rng.uniform(0.05, 0.8, 2), strict=True)
    ]
    study = STUDIES[("main", "preliminary")[seed % 2]]
    study = replace(study, k_ffa=study.k_ffa * 10.0 ** rng.uniform(-1.0, 2.0))
    person = tl.Teleoperator(
        noise=rng.uniform(0.0, 1.5),
        stiffness=rng.uniform(0.0, 120.0),
        damping=rng.uniform(0.0, 5.0),
        proportional=rng.uniform(0.0, 3.0),
        reach=2.0,
    )
    scheme = (SWITCHING, "TMIS", "TMIG", "MMI")[seed % 4]
    try:
        run = tl.simulate_teleoperation(
            scheme,
            person,
            study,
            seed=seed,
            duration=seconds,
            delay=tuple(delays),
            guidance=Guidance(guidance, guard, budget),
            signals={
                "arrives": rng.uniform(size=(2, count)).T >= 0.5,
                "push": rng.normal(size=(count, 3)) * rng.uniform(0.0, 3.0),
            },
        )
    except DivergenceError as error:
        run = error.session
    power = (columns(run, "r_m") * columns(run, "f_m")).sum(axis=1)
    taken = T * np.cumsum(power)
    np.testing.assert_allclose(
        run["energy_port"], taken, rtol=1e-9, atol=1e-9 * T * np.abs(power).sum() + 1e-14
    )
    return taken


def deepest(guidance, guard, seed, seconds=15.0):
    """How far the energy at the operator's port falls below zero [J] in a random run."""
    return min(taken_at_random(guidance, guard, seed, seconds).min(), 0.0)


def overspent(seed, guard="repay", budgeted=True, seconds=4.0):
    """
    By how much a random run gives out more than a random budget allows, in that stretch of samples
    where it is worst [J].
    """
    rng = np.random.default_rng([8, seed])
    energy, power = (0.0, *10.0 ** rng.uniform(-2.0, 0.5, 2), 0.0)[seed % 3 :][:2]
    budget = GuidanceBudget(energy, power)
    taken = taken_at_random("at_operator", guard, seed, seconds, budget if budgeted else None)
    # From sample i to sample j the port gives out −(taken_j − taken_i), and may give out energy +
    # power (j − i) T: the greatest fall of what follows is at most `energy`.
    rise = np.concatenate([[0.0], taken + power * T * np.arange(1, taken.size + 1)])
    return (np.maximum.accumulate(rise) - rise).max() - energy


@pytest.mark.parametrize("guidance", GUIDANCE)
def test_the_operators_port_never_gives_out_more_than_it_took(guidance):
    assert min(deepest(guidance, "repay", seed) for seed in range(10)) >= -1e-9


@pytest.mark.long
@pytest.mark.parametrize("guidance", GUIDANCE)
def test_the_operators_port_never_gives_out_more_in_500_runs(guidance):
    assert min(deepest(guidance, "repay", seed) for seed in range(500)) >= -1e-9


def test_a_budget_bounds_what_the_port_gives_out_in_any_stretch_of_time():
    assert max(overspent(seed) for seed in range(200)) <= 1e-9


@pytest.mark.long
def test_a_budget_bounds_what_the_port_gives_out_in_2000_runs():
    assert max(overspent(seed) for seed in range(2000)) <= 1e-9


def test_what_breaks_the_bound_of_a_budget():
    assert min(overspent(seed, guard="off") for seed in range(6)) > 0.1
    # the printed rule overdraws by up to a sample's power
    assert max(overspent(seed, guard="cancel") for seed in range(6)) > 1e-3
    # without a budget the port never falls below zero, but spends at once what it saved for long
    assert max(overspent(seed, budgeted=False) for seed in range(12)) > 0.05


def test_a_budget_is_felt_and_is_off_by_default():
    budget = GuidanceBudget(energy=0.2, power=0.5)
    runs = [
        tl.simulate_teleoperation("M", seed=1, duration=30.0, guidance=Guidance(budget=b))
        for b in (None, budget)
    ]
    before, felt = (tl.teleoperation_measures(run).iloc[0] for run in runs)
    assert before["guidance_felt"] < 0.6
    assert before["guarded"] > 0.95
    assert felt["guidance_felt"] > 0.9
    assert felt["guarded"] < 0.5
    assert -budget.bound(30.0) <= felt["energy_port_min"] < -1.0
    assert runs[0] == tl.simulate_teleoperation("M", seed=1, duration=30.0)


def test_the_device_dissipates_no_more_than_its_operator_and_the_budget_supply():
    """The balance behind the stability of a budgeted port, from logged signals and energies."""
    budget = GuidanceBudget(energy=0.5, power=2.0)
    study = replace(STUDIES["main"], k_ffa=600.0)
    for seed in range(3):
        run = tl.simulate_teleoperation(
            "M", study=study, seed=seed, duration=60.0, guidance=Guidance(budget=budget)
        )
        stored = run["energy_device"] + run["energy_dissipated"]
        allowed = run["energy_operator"] + budget.energy + budget.power * (run.t + T)
        assert (stored <= allowed + 1e-9).all()
        assert stored[-1] > run["energy_operator"][-1] + 10.0  # the budget is spent, and needed


@pytest.mark.parametrize("guidance", GUIDANCE)
def test_without_its_guard_every_guidance_gives_energy_out(guidance):
    assert min(deepest(guidance, "off", seed) for seed in range(4)) < -0.1


def at_rest(run):
    """Mean distance of a robot that stays where it starts."""
    reference = columns(run, "reference")
    return np.linalg.norm(reference - reference[0], axis=1).mean()


def test_the_exception_is_the_printed_guidance_without_its_guard_a_hidden_autopilot():
    run = tl.simulate_teleoperation(
        "M", IDLE, duration=120.0, guidance=Guidance("through_channel", "off")
    )
    assert run["path_error"].mean() == pytest.approx(0.07, abs=0.005)
    assert at_rest(run) > 1.0
    # the energy comes from the target, a port that the controller does not observe
    given = -run["energy_robot"][-1]
    assert run["energy_target"][-1] / given == pytest.approx(1.0, abs=0.03)
    # by (3.22) the force drives the robot, whatever the operator does: r_s = α (open − f_s/b) with
    # nothing arriving
    b = STUDIES["main"].scattering.b
    np.testing.assert_allclose(columns(run, "r_s")[:3], -columns(run, "f_s")[:3] / b, atol=1e-12)


def test_the_target_feeds_the_spring_with_force_times_velocity():
    run = tl.simulate_teleoperation(
        "M", seed=3, duration=20.0, guidance=Guidance("through_channel", "off")
    )
    moving = TASKS["main"].path(run.t, 1.5, phase(3))[1]
    fed = T * np.cumsum((-columns(run, "f_s") * moving).sum(axis=1))
    np.testing.assert_allclose(run["energy_target"], fed, atol=1e-9)


def test_the_printed_controller_stops_the_operator_and_stiff_guidance_is_not_passive_under_it():
    errors = []
    for stiffness in (0.0, 6.0, 60.0):
        study = replace(STUDIES["main"], k_ffa=stiffness)
        run = tl.simulate_teleoperation(
            "M", study=study, seed=1, guidance=Guidance("through_channel", "cancel")
        )
        errors.append(run["path_error"].mean())
    assert max(errors) - min(errors) < 0.02  # whatever the stiffness: nothing of it is left
    stiff = replace(STUDIES["main"], k_ffa=600.0)
    cancelled = tl.simulate_teleoperation(
        "M", study=stiff, seed=1, guidance=Guidance("through_channel", "cancel")
    )
    repaid = tl.simulate_teleoperation(
        "M", study=stiff, seed=1, guidance=Guidance("through_channel", "repay")
    )
    assert cancelled["energy_robot"].min() < -0.5
    assert repaid["energy_robot"].min() > -1e-9


@pytest.mark.parametrize("view", [0.3, 20.0])
def test_no_force_towards_a_target_that_nobody_sees(view):
    """The second camera, the negative control, sees all of the way."""
    task, asked = TrackingTask(view=view, speed=1.5), []

    def spring(state):
        asked.append(state.stretch.copy())
        return -6.0 * state.stretch

    run = tl.simulate_teleoperation(
        "M", IDLE, seed=1, duration=30.0, task=task, guidance=Guidance(guard="off", force=spring)
    )
    late = round(task.camera_delay / T)
    error = columns(run, "reference") - columns(run, "robot")
    seen = np.zeros(len(run), bool)
    seen[late:] = (np.abs(error[:-late, :2]) <= view).all(axis=1)
    asked = np.array(asked)[-len(run) :]
    assert not asked[~seen].any()
    np.testing.assert_allclose(asked[late:][seen[late:]], error[:-late][seen[late:]], atol=1e-12)
    assert (~seen[late:]).mean() > 0.5 if view == 0.3 else seen[late:].all()
