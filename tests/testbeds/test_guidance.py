"""
Guidance: the operator's port gives out no energy that it did not take, and no guidance is a hidden
autopilot.
"""

from dataclasses import replace

import numpy as np
import pytest

import trustlab as tl
from trustlab.teleoperation import STUDIES, Delay, DivergenceError
from trustlab.teleoperation.loop.kernel import GUIDANCE
from trustlab.testbeds.uav_tracking import TASKS

T = 0.01
IDLE = tl.Teleoperator(proportional=0.0, derivative=0.0, noise=0.0, stiffness=0.0, damping=0.0)


def columns(session, stem):
    return session.data[[f"{stem}_{axis}" for axis in "xyz"]].to_numpy()


def switching(state):
    """Scales that jump between their bounds."""
    number = int(state.t * 7.0 + 0.5)
    alpha = state.alpha_min if (number * 2654435761) % 3 == 0 else state.alpha_max
    return alpha, state.beta_min if (number * 40503) % 5 < 2 else state.beta_max


SWITCHING = tl.Scheme("switching", switching)


def jitter(seed, most):
    """A delay drawn anew in every sample: packets overtake one another."""
    return Delay(
        lambda t: np.random.default_rng(seed).uniform(0.02, most, t.size), np.inf, "drawn anew"
    )


def deepest(guidance, guard, seed, seconds=15.0):
    """
    How far the energy at the operator's port falls below −E₀ [J] in a random run; the port's energy
    from the logged signals.
    """
    rng, count = np.random.default_rng([5, seed]), round(seconds / T)
    delays = [
        jitter(int(own), most)
        for own, most in zip(rng.integers(1 << 30, size=2), rng.uniform(0.05, 0.8, 2), strict=True)
    ]
    study = STUDIES[("main", "preliminary")[seed % 2]]
    study = replace(study, k_ffa=study.k_ffa * 10.0 ** rng.uniform(-1.0, 2.0))
    start = float(rng.choice([0.0, 0.3, 2.0])) if guidance == "tank" else 0.0
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
            delay_1=delays[0],
            delay_2=delays[1],
            lost=rng.uniform(size=(2, count)) < 0.5,
            guidance=guidance,
            guard=guard,
            tank=start,
            push=rng.normal(size=(count, 3)) * rng.uniform(0.0, 3.0),
        )
    except DivergenceError as error:
        run = error.session
    power = (columns(run, "r_m") * columns(run, "f_m")).sum(axis=1)
    taken = T * np.cumsum(power)
    np.testing.assert_allclose(
        run["energy_port"], taken, rtol=1e-9, atol=1e-9 * T * np.abs(power).sum() + 1e-14
    )
    return min(taken.min() + start, 0.0)


@pytest.mark.parametrize("guidance", GUIDANCE)
def test_the_operators_port_never_gives_out_more_than_the_tank_held(guidance):
    assert min(deepest(guidance, "repay", seed) for seed in range(10)) >= -1e-9


@pytest.mark.long
@pytest.mark.parametrize("guidance", GUIDANCE)
def test_the_operators_port_never_gives_out_more_in_500_runs(guidance):
    assert min(deepest(guidance, "repay", seed) for seed in range(500)) >= -1e-9


@pytest.mark.parametrize("guidance", GUIDANCE)
def test_without_its_guard_every_guidance_gives_energy_out(guidance):
    assert min(deepest(guidance, "off", seed) for seed in range(4)) < -0.1


def at_rest(run):
    """Mean distance of a robot that stays where it starts."""
    reference = columns(run, "reference")
    return np.linalg.norm(reference - reference[0], axis=1).mean()


@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.parametrize("guidance", GUIDANCE)
@pytest.mark.parametrize("delays", [{}, {"delay": 0.0}])
def test_who_does_nothing_tracks_no_better_than_a_robot_at_rest(guidance, study, delays):
    for seed in range(2):
        run = tl.simulate_teleoperation(
            "M", IDLE, study, seed=seed, duration=60.0, guidance=guidance, **delays
        )
        assert run["path_error"].mean() >= at_rest(run) - 1e-9


def test_the_exception_is_the_printed_guidance_without_its_guard_a_hidden_autopilot():
    run = tl.simulate_teleoperation(
        "M", IDLE, duration=120.0, guidance="through_channel", guard="off"
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
    for guidance in ("through_channel", "tank"):
        run = tl.simulate_teleoperation("M", seed=3, duration=20.0, guidance=guidance, guard="off")
        phase = np.random.default_rng(np.random.SeedSequence(3).spawn(5)[0]).uniform(
            0.0, 2.0 * np.pi
        )
        moving = TASKS["main"].path(run.t, 1.5, phase)[1]
        fed = T * np.cumsum((-columns(run, "f_s") * moving).sum(axis=1))
        np.testing.assert_allclose(run["energy_target"], fed, atol=1e-9)


def test_the_printed_controller_stops_the_operator_and_stiff_guidance_is_not_passive_under_it():
    errors = []
    for stiffness in (0.0, 6.0, 60.0):
        study = replace(STUDIES["main"], k_ffa=stiffness)
        run = tl.simulate_teleoperation(
            "M", study=study, seed=1, guidance="through_channel", guard="cancel"
        )
        errors.append(run["path_error"].mean())
    assert max(errors) - min(errors) < 0.02  # whatever the stiffness: nothing of it is left
    stiff = replace(STUDIES["main"], k_ffa=600.0)
    cancelled = tl.simulate_teleoperation(
        "M", study=stiff, seed=1, guidance="through_channel", guard="cancel"
    )
    repaid = tl.simulate_teleoperation(
        "M", study=stiff, seed=1, guidance="through_channel", guard="repay"
    )
    assert cancelled["energy_robot"].min() < -0.5
    assert repaid["energy_robot"].min() > -1e-9


def test_guidance_at_the_operator_leaves_the_robot_to_the_operator():
    run = tl.simulate_teleoperation("M", seed=2, duration=30.0)
    assert not columns(run, "f_s").any()
    assert not run["energy_robot"].any()
    felt, printed = (
        np.linalg.norm(columns(one, "guide"), axis=1).mean()
        for one in (
            run,
            tl.simulate_teleoperation("M", seed=2, duration=30.0, guidance="through_channel"),
        )
    )
    assert felt > 3.0 * printed


def test_two_port_makes_up_for_drift():
    run = tl.simulate_teleoperation("M", seed=2, duration=60.0, guidance="two_port", delay=0.2)
    sent, done = T * columns(run, "r_m").cumsum(axis=0), T * columns(run, "r_s").cumsum(axis=0)
    assert np.abs(done[20:] - sent[:-20]).max() < 0.2
