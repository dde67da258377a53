"""
The whole loop: against independent integrators, its energy ledgers, its guards, and what it
refuses.
"""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.flights import assert_device_balances, columns, phase, power
from trustlab.allocation.blending import OptimalBlending
from trustlab.models.uav import TransferFunction
from trustlab.operators import Teleoperator
from trustlab.teleoperation import DivergenceError
from trustlab.teleoperation.loop.kernel import GUIDANCE
from trustlab.teleoperation.loop.settings import (
    STUDIES,
    Guidance,
    LoopSettings,
    vehicle_matrices,
)
from trustlab.teleoperation.ports.waves import Scattering
from trustlab.testbeds.uav_tracking import (
    TASKS,
    TrackingTask,
    simulate_teleoperation,
    tracking_vehicle,
)

SCHEMES = ("M", "MI", "MMI", "TMIG", "TMIS", "OMI")
UNIT = replace(STUDIES["main"], scattering=Scattering(2.0), k_ffa=3.0)
STILL = Teleoperator(proportional=0.0, derivative=0.0, noise=0.0)
TASK = TrackingTask(failure_every=1e9)
PUSH = MappingProxyType(
    {"x": (1.0, 1.3), "y": (0.7, 0.8), "z": (0.5, 2.1)}
)  # size [N] and rate [rad/s]


def push(t):
    return np.column_stack([size * np.sin(rate * t) for size, rate in PUSH.values()])


def driven(sample_time, delay, settings=UNIT, duration=4.0):
    """A run whose hand only holds still and is pushed by known forces."""
    t = sample_time * np.arange(round(duration / sample_time)) + 0.5 * sample_time
    return simulate_teleoperation(
        "M",
        STILL,
        replace(settings, sample_time=sample_time),
        duration=duration,
        task=TASK,
        delay=delay,
        guidance=Guidance("through_channel", "off"),
        signals={"push": push(t)},
    ).data


def target(t):
    """The target of seed 0, from the run itself: position by its closed form."""
    return TASK.path(np.atleast_1d(t), 1.5, phase(0))[0]


def device(settings, x, v, force, feedback):
    hand = STILL
    return (
        force
        - (settings.stiffness + hand.stiffness) * x
        - (settings.damping + hand.damping) * v
        - feedback
    ) / settings.mass


def test_without_delay_and_with_unit_scales_the_loop_is_the_continuous_one():
    vehicle = tracking_vehicle()

    def rates(t, y):
        x, v, p, w, a = y.reshape(5, 3)
        e = target(t)[0] - p
        r = v + UNIT.weight * x
        out = [v, device(UNIT, x, v, push(np.array([t]))[0], -UNIT.k_ffa * e), w]
        d = np.array([[*m.denominator, 0.0][:2] for m in vehicle[:2]])
        speed = np.append(a[:2], vehicle[2].gain * r[2] - vehicle[2].denominator[0] * w[2])
        jerk = np.append(
            [vehicle[i].gain * r[i] - d[i, 1] * w[i] - d[i, 0] * a[i] for i in range(2)], 0.0
        )
        return np.concatenate([*out, speed, jerk])

    start = np.zeros((5, 3))
    start[2] = target(0.0)[0]
    solved = solve_ivp(rates, (0.0, 4.0), start.ravel(), rtol=1e-10, atol=1e-12, dense_output=True)
    errors = []
    for sample_time in (0.004, 0.002, 0.001):
        data = driven(sample_time, 0.0)
        exact = solved.sol(data.index.to_numpy()).reshape(5, 3, -1)
        ours = [
            data[[f"{stem}_{axis}" for axis in "xyz"]].to_numpy().T for stem in ("device", "robot")
        ]
        errors.append(
            max(
                np.abs(ours[0] - exact[0]).max() / np.abs(exact[0]).max(),
                np.abs(ours[1] - exact[2]).max(),
            )
        )
    assert errors[-1] < 5e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.25)  # first order in the sample time
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.25)


def second_integrator(settings, delay, step, duration=4.0):
    """
    The loop with a constant delay by Heun's rule, waves read from their history: another
    discretization, in plain Python.
    """
    b, ends = settings.scattering.b, settings.scattering
    vehicle = tracking_vehicle()
    count = round(duration / step)
    late = round(delay / step)
    u_l, u_r = np.zeros((count + 1, 3)), np.zeros((count + 1, 3))
    y = np.zeros((5, 3))
    y[2] = target(0.0)[0]
    rows = np.empty((count, 2, 3))

    def rates(t, y, v_l, v_r):
        x, v, p, w, a = y
        r_m = v + settings.weight * x
        f_s = -settings.k_ffa * (target(t)[0] - p)
        f_m = ends.beta_max * (b * r_m + np.sqrt(2 * b / ends.beta_max) * v_l)
        r_s = ends.alpha_max * (np.sqrt(2 * b / ends.alpha_max) * v_r - f_s) / b
        out = np.zeros((5, 3))
        out[0] = v
        out[1] = device(settings, x, v, push(np.array([t]))[0], f_m)
        out[2] = w
        for i in range(2):
            out[3, i] = a[i]
            out[4, i] = (
                vehicle[i].gain * r_s[i]
                - vehicle[i].denominator[1] * w[i]
                - vehicle[i].denominator[0] * a[i]
            )
        out[3, 2] = vehicle[2].gain * r_s[2] - vehicle[2].denominator[0] * w[2]
        sent_l = np.sqrt(ends.beta_min / (2 * b)) * (f_m / ends.beta_max + b * r_m)
        sent_r = np.sqrt(ends.alpha_min / (2 * b)) * (f_s - b * r_s / ends.alpha_max)
        return out, sent_l, sent_r

    for k in range(count):
        rows[k] = y[0], y[2]
        v_r, v_l = (u_l[k - late], u_r[k - late]) if k >= late else (np.zeros(3), np.zeros(3))
        one, u_l[k], u_r[k] = rates(k * step, y, v_l, v_r)
        later = (
            (u_l[k + 1 - late], u_r[k + 1 - late]) if k + 1 >= late else (np.zeros(3), np.zeros(3))
        )
        two = rates((k + 1) * step, y + step * one, later[1], later[0])[0]
        y = y + 0.5 * step * (one + two)
    return rows


def test_with_a_constant_delay_a_second_integrator_agrees_to_first_order():
    settings = replace(UNIT, scattering=Scattering(2.0, 0.4, 1.0, 0.2, 0.8))
    exact = second_integrator(settings, 0.1, 0.0005)
    errors = []
    for sample_time in (0.01, 0.005, 0.001):
        data = driven(sample_time, 0.1, settings)
        at = np.round(data.index.to_numpy() / 0.0005).astype(int)
        gaps = [
            np.abs(data[[f"{stem}_{axis}" for axis in "xyz"]].to_numpy() - exact[at, i]).max()
            / np.ptp(exact[:, i], axis=0).max()
            for i, stem in enumerate(("device", "robot"))
        ]
        errors.append(max(gaps))
    assert errors[-1] < 0.01
    assert errors[0] / errors[-1] == pytest.approx(10.0, rel=0.3)


def assert_robot_port_gives_one_sample_at_most(data):
    """Theorem 4."""
    assert data["energy_robot"].min() >= 0.01 * power(data, "r_s", "f_s").min() - 1e-12


@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.parametrize("guidance", GUIDANCE)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_port_balances_and_no_block_gives_energy_away(scheme, guidance, study):
    guard = ("repay", "cancel")[guidance == "through_channel"]
    data = simulate_teleoperation(
        scheme, None, study, seed=1, duration=60.0, guidance=Guidance(guidance, guard)
    ).data
    assert_device_balances(data)
    exchanged = 0.01 * sum(
        np.abs(columns(data, velocity) * columns(data, force)).sum(axis=1).cumsum()
        for velocity, force in (("r_m", "f_m"), ("r_s", "f_s"))
    )
    assert (data["energy_channel"] >= -1e-9 * exchanged).all()
    assert_robot_port_gives_one_sample_at_most(data)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("seeds", [16, pytest.param(200, marks=pytest.mark.long)])
def test_stored_energy_is_bounded_under_bounded_force(scheme, seeds):
    # the hand as a passive spring, pushed by at most 4 N: what is stored is bounded by what it can
    # hold, not by time
    for seed in range(seeds):
        study = ("preliminary", "main")[seed % 2]
        rng = np.random.default_rng([44, seed])
        force = 4.0 * np.sign(np.repeat(rng.normal(size=(40, 3)), 150, axis=0))
        data = simulate_teleoperation(
            scheme, STILL, study, seed=seed, duration=60.0, signals={"push": force / np.sqrt(3.0)}
        ).data
        settings = STUDIES[study]
        spring = settings.stiffness + settings.weight * settings.damping
        assert data["energy_device"].max() < 3.0 * spring * (4.0 / settings.stiffness) ** 2
        assert_robot_port_gives_one_sample_at_most(data)


def tracking(scheme, study, seeds=12, **more):
    return np.array(
        [
            simulate_teleoperation(scheme, study=study, seed=s, **more).data["path_error"].mean()
            for s in range(seeds)
        ]
    )


@pytest.mark.parametrize("study", STUDIES)
def test_which_scheme_tracks_better_depends_on_the_printed_guidance_in_one_study(study):
    printed = {"guidance": Guidance("through_channel", "cancel")}
    assert tracking("TMIG", study, **printed).mean() < tracking("M", study, **printed).mean()
    better = tracking("TMIG", study).mean() < tracking("M", study).mean()
    assert better == (study == "main")  # with the robot left to the operator


def test_the_printed_direction_of_the_force_is_active_and_without_a_guard_diverges():
    printed = replace(STUDIES["main"], printed_sign=True)
    words = r"the (robot|channel|haptic device) diverged at sample \d+ \(.* s\); lower"
    with pytest.raises(DivergenceError, match=words):
        simulate_teleoperation(
            "TMIG", study=printed, guidance=Guidance("through_channel", "off"), seed=1
        )


def test_performance_is_the_window_mean_of_3_27():
    data, settings = simulate_teleoperation("TMIG", seed=5, duration=40.0).data, STUDIES["main"]
    error, gap = (
        np.abs(columns(data, one) - columns(data, other)).sum(axis=1)
        for one, other in (("reference", "robot"), ("u_a", "u_i"))
    )
    agreement = (1.0 - gap / settings.command_range).clip(min=0.0)
    closeness = (1.0 - (1.0 - data["alpha"]) * error / settings.error_range).clip(lower=0.0)
    expected = (agreement * closeness).rolling(1000, min_periods=1).mean()
    np.testing.assert_allclose(data["p_r"], expected, atol=1e-9)


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


@pytest.mark.parametrize("study", STUDIES)
def test_optimal_share_in_the_loop_is_that_of_the_controller_alone(study):
    data = simulate_teleoperation("OMI", study=study, seed=6, duration=20.0).data
    task, settings, vehicle = TASKS[study], STUDIES[study], tracking_vehicle()
    place, velocity, acceleration = flown(data, vehicle_matrices(vehicle, 0.01))
    np.testing.assert_allclose(place, columns(data, "robot"), atol=1e-9)
    gains = ((task.proportional, task.derivative),) * 3
    blending = OptimalBlending(vehicle, gains, settings.scattering.alpha_min)
    moving = task.path(data.index.to_numpy(), settings.height, phase(6))[1]
    said = np.vstack([np.zeros(3), columns(data, "u_h")])
    error, rate = columns(data, "reference") - place, moving - velocity
    for k in range(0, len(data), 37):
        answer = blending.step(
            said[k], columns(data, "u_a")[k], error[k], rate[k], -acceleration[k]
        )
        assert data["alpha"].iloc[k] == pytest.approx(answer.alpha, abs=1e-6)
    assert data["alpha"].nunique() > 10


def test_an_unstable_vehicle_stops_the_run_with_time_and_block():
    unstable = (TransferFunction(1.0, (-3.0,)),) * 3
    with pytest.raises(DivergenceError, match="the robot diverged at sample"):
        simulate_teleoperation("M", task=TrackingTask(vehicle=unstable))


@pytest.mark.parametrize(
    ("name", "loop", "scattering"),
    [
        ("preliminary", (60.0, 0.55, 100.0, 3.0, 4.0), (1.0, 0.05, 1.0, 0.2, 1.0)),
        ("main", (10.0, 5.5, 20.0, 6.0, 1.5), (2.0, 0.2, 1.0, 0.05, 0.5)),
    ],
)
def test_settings_are_those_printed(name, loop, scattering):
    study = STUDIES[name]
    assert isinstance(study, LoopSettings)
    assert loop == (study.weight, study.damping, study.stiffness, study.k_ffa, study.height)
    ends = study.scattering
    assert scattering == (ends.b, ends.alpha_min, ends.alpha_max, ends.beta_min, ends.beta_max)
    assert ends.gain == pytest.approx(0.7, abs=0.01)


def test_scales_without_trust():
    for scheme in ("M", "MMI"):
        assert (simulate_teleoperation(scheme, duration=5.0).data["beta"] == 0.5).all()
    assert not columns(simulate_teleoperation("MI", duration=5.0), "f_m").any()
