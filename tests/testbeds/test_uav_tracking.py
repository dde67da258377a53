"""
The whole loop: against independent integrators, its energy ledgers, its guards, and its settings.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.loops import assert_device_balances, columns, each_guidance, phase, power
from trustlab import (
    OptimalBlending,
    Scattering,
    Teleoperator,
    TrackingTask,
    TransferFunction,
    TrustModel,
    simulate_teleoperation,
)
from trustlab.models.trust import LogisticScaling, StepScaling
from trustlab.teleoperation import SCHEMES, STUDIES, DivergenceError, Guidance
from trustlab.teleoperation.loop.settings import vehicle_matrices
from trustlab.testbeds.uav_tracking import TASKS

MAIN = STUDIES["main"]
UNIT = replace(MAIN, scattering=Scattering(2.0, 0.4, 1.0, 0.2, 0.8), k_ffa=3.0)
STILL = Teleoperator(proportional=0.0, derivative=0.0, noise=0.0)
TASK = TrackingTask(failure_every=1e9)
DELAY, STEP = 0.1, 0.001  # of the second integrator [s]
# both poles at −4/s
VEHICLE = (TransferFunction(16.0, (8.0, 16.0)),) * 2 + (TransferFunction(4.0, (4.0,)),)


each_scheme = pytest.mark.parametrize("scheme", SCHEMES)
each_study = pytest.mark.parametrize("study", STUDIES)


def push(t):
    """Known forces on the hand [N]."""
    return np.stack([np.sin(1.3 * t), 0.7 * np.sin(0.8 * t), 0.5 * np.sin(2.1 * t)], axis=-1)


def error(t, robot):
    """From the robot to the target of seed 0, whose way is known in closed form."""
    return TASK.path(np.atleast_1d(t), 1.5, phase(0))[0][0] - robot


def rates(t, state, f_m, r_s):
    """Derivatives of the device, its velocity, the robot, its velocity and its acceleration."""
    x, v, _, speed, acceleration = state
    stiffness, damping = UNIT.stiffness + STILL.stiffness, UNIT.damping + STILL.damping
    pull = push(t) - stiffness * x - damping * v - f_m
    told, jerk = r_s * [axis.gain for axis in VEHICLE], np.zeros(3)
    for i in range(2):
        slow, fast = VEHICLE[i].denominator
        jerk[i] = told[i] - fast * speed[i] - slow * acceleration[i]
    climb = told[2] - VEHICLE[2].denominator[0] * speed[2]
    return np.array([v, pull / UNIT.mass, speed, [*acceleration[:2], climb], jerk])


def driven(sample_time):
    """
    Device and robot of a run whose hand only holds still and is pushed by known forces.
    """
    t = sample_time * np.arange(round(4.0 / sample_time)) + 0.5 * sample_time
    run = simulate_teleoperation(
        "M",
        STILL,
        replace(UNIT, sample_time=sample_time),
        duration=4.0,
        task=TASK,
        delay=DELAY,
        guidance=Guidance("through_channel", "off"),
        signals={"push": push(t)},
    )
    return [columns(run, name) for name in ("device", "robot")]


def second_integrator():
    """
    Device and robot with a constant delay by Heun's rule, waves read from their history: another
    discretization, in plain Python.
    """
    ends, count, late = UNIT.scattering, round(4.0 / STEP), round(DELAY / STEP)
    b = ends.b
    waves = np.zeros((count + late + 1, 2, 3))  # those that arrive, at the robot and back

    def slope(k, state):
        arrived, returned = waves[k]
        r_m = state[1] + UNIT.weight * state[0]
        f_s = -UNIT.k_ffa * error(k * STEP, state[2])
        f_m = ends.beta_max * (b * r_m + np.sqrt(2 * b / ends.beta_max) * returned)
        r_s = ends.alpha_max * (np.sqrt(2 * b / ends.alpha_max) * arrived - f_s) / b
        sent = np.sqrt(ends.beta_min / (2 * b)) * (f_m / ends.beta_max + b * r_m)
        answer = np.sqrt(ends.alpha_min / (2 * b)) * (f_s - b * r_s / ends.alpha_max)
        return rates(k * STEP, state, f_m, r_s), (sent, answer)

    state = np.zeros((5, 3))
    state[2] = error(0.0, 0.0)
    states = [state]
    for k in range(count):
        first, waves[k + late] = slope(k, states[k])
        second, _ = slope(k + 1, states[k] + STEP * first)
        states.append(states[k] + 0.5 * STEP * (first + second))
    return np.array(states)[:, [0, 2]].swapaxes(0, 1)


def test_with_a_constant_delay_a_second_integrator_agrees_to_first_order():
    exact, errors = second_integrator(), []
    for sample_time in (0.01, 0.005, 0.001):
        ours = driven(sample_time)
        theirs = exact[:, : -1 : round(sample_time / STEP)]
        ranges = np.ptp(theirs, axis=1).max(axis=1)
        errors.append((np.abs(ours - theirs).max(axis=(1, 2)) / ranges).max())
    assert errors[-1] < 0.01
    assert errors[0] / errors[-1] == pytest.approx(10.0, rel=0.3)


@pytest.mark.slow
@each_guidance
@each_scheme
@pytest.mark.parametrize("seeds", [8, pytest.param(100, marks=pytest.mark.long)])
def test_stored_energy_is_bounded_under_bounded_force(scheme, guidance, seeds):
    """
    The hand is a passive spring, pushed by at most 4 N: what is stored is bounded by what it can
    hold, not by time; and at the robot's port Theorem 4 holds to a sample.
    """
    guard = ("repay", "cancel")[guidance == "through_channel"]
    for seed in range(seeds):
        name = ("preliminary", "main")[seed % 2]
        study, rng = STUDIES[name], np.random.default_rng([44, seed])
        force = 4.0 * np.sign(np.repeat(rng.normal(size=(40, 3)), 150, axis=0))
        options = {"guidance": Guidance(guidance, guard), "signals": {"push": force / np.sqrt(3.0)}}
        run = simulate_teleoperation(scheme, STILL, name, seed=seed, duration=60.0, **options)
        spring = study.stiffness + study.weight * study.damping
        assert run["energy_device"].max() < 3.0 * spring * (4.0 / study.stiffness) ** 2
        assert run["energy_robot"].min() >= 0.01 * power(run, "r_s", "f_s").min() - 1e-12
        assert_device_balances(run)


@pytest.mark.parametrize(
    "arguments",
    [
        # the printed direction of the force is active
        {"study": replace(MAIN, printed_sign=True), "scheme": "TMIG"},
        {"task": TrackingTask(vehicle=(TransferFunction(1.0, (-3.0,)),) * 3), "scheme": "M"},
    ],
)
def test_a_run_that_diverges_stops_with_time_and_block(arguments):
    words = r"the (robot|channel|haptic device) diverged at sample \d+ \(.* s\); lower"
    with pytest.raises(DivergenceError, match=words):
        simulate_teleoperation(guidance=Guidance("through_channel", "off"), seed=1, **arguments)


def test_performance_is_the_window_mean_of_3_27():
    data = simulate_teleoperation("TMIG", seed=5, duration=40.0).data
    error, gap = (
        np.abs(columns(data, one) - columns(data, other)).sum(axis=1)
        for one, other in (("reference", "robot"), ("u_a", "u_i"))
    )
    agreement = (1.0 - gap / MAIN.command_range).clip(min=0.0)
    closeness = (1.0 - (1.0 - data["alpha"]) * error / MAIN.error_range).clip(lower=0.0)
    expected = (agreement * closeness).rolling(1000, min_periods=1).mean()
    assert_allclose(data["p_r"], expected, atol=1e-9)


def flown(data, matrices):
    """Position, velocity and acceleration of the vehicle, run again from the logged commands."""
    phi, gamma = matrices
    share = 1.0 - data["alpha"].to_numpy()[:, None]
    state, rows = np.zeros((3, 3)), []
    state[:, 0] = columns(data, "robot")[0]
    for command in columns(data, "r_s") + share * columns(data, "u_a"):
        rows.append(state)
        state = np.einsum("ijk,ik->ij", phi, state) + gamma * command[:, None]
    return np.moveaxis(rows, 2, 0)


@each_study
def test_optimal_share_in_the_loop_is_that_of_the_controller_alone(study):
    data = simulate_teleoperation("OMI", study=study, seed=6, duration=20.0).data
    task, settings = TASKS[study], STUDIES[study]
    place, velocity, acceleration = flown(data, vehicle_matrices(VEHICLE, 0.01))
    assert_allclose(place, columns(data, "robot"), atol=1e-9)
    gains = ((task.proportional, task.derivative),) * 3
    blending = OptimalBlending(VEHICLE, gains, settings.scattering.alpha_min)
    moving = task.path(data.index.to_numpy(), settings.height, phase(6))[1]
    said = np.vstack([np.zeros(3), columns(data, "u_h")])
    error, rate = columns(data, "reference") - place, moving - velocity
    for k in range(0, len(data), 37):
        answer = blending.step(
            said[k], columns(data, "u_a")[k], error[k], rate[k], -acceleration[k]
        )
        assert data["alpha"].iloc[k] == pytest.approx(answer, abs=1e-6)
    assert data["alpha"].nunique() > 10


def test_settings_are_those_printed():
    loops = {"preliminary": (60.0, 0.55, 100.0, 3.0, 4.0), "main": (10.0, 5.5, 20.0, 6.0, 1.5)}
    ends = {"preliminary": (1.0, 0.05, 1.0, 0.2, 1.0), "main": (2.0, 0.2, 1.0, 0.05, 0.5)}
    for name, study in STUDIES.items():
        loop = study.weight, study.damping, study.stiffness, study.k_ffa, study.height
        assert loop == loops[name]
        assert study.scattering == Scattering(*ends[name], max_delay_rate=0.5)  # f_i = 0.7


# Settings of a study


OWN_TRUST = replace(
    MAIN,
    human_to_robot=TrustModel(0.3, 0.2, t_min=0.0, t_max=2.0, p_min=0.2, p_max=0.9),
    robot_to_human=TrustModel(0.1, 0.1, t_min=-1.0, t_max=1.0, p_min=0.1, p_max=0.6),
)


@pytest.mark.parametrize("scheme", ["TMIG", "TMIS"])
def test_each_trust_follows_its_own_model_in_its_own_units_and_scales_follow_trust(scheme):
    data = simulate_teleoperation(scheme, study=OWN_TRUST, seed=5, duration=60.0).data
    kind = LogisticScaling if scheme == "TMIG" else StepScaling
    for model, measure, column, scale in (
        (OWN_TRUST.human_to_robot, "p_r", "trust_hr", "alpha"),
        (OWN_TRUST.robot_to_human, "p_h", "trust_rh", "beta"),
    ):
        performance, trust = data[measure].clip(model.p_min, model.p_max), data[column].to_numpy()
        expected = model.simulate(performance.to_numpy(), 0.01, 0.5 * (model.t_min + model.t_max))
        assert_allclose(trust, expected, atol=1e-9)
        low, high = (getattr(OWN_TRUST.scattering, f"{scale}_{end}") for end in ("min", "max"))
        scaling = kind(low, high, t_min=model.t_min, t_max=model.t_max)
        assert_allclose(data[scale], scaling.value(trust), atol=1e-12)


def test_scales_without_trust():
    for scheme in ("M", "MMI"):
        assert (simulate_teleoperation(scheme, duration=5.0).data["beta"] == 0.5).all()
    assert not columns(simulate_teleoperation("MI", duration=5.0), "f_m").any()
