"""
The step interface: same bits as a whole run, parts of one's own, and what happens when one of them
fails.
"""

from functools import partial

import numpy as np
import pytest

import trustlab as tl
from trustlab.teleoperation import SCHEMES, STUDIES, Guidance, PartError, packet_delay
from trustlab.teleoperation.loop.kernel import GUIDANCE
from trustlab.testbeds import tracking_vehicle

SHORT = 8.0


def tmig(state):
    """TMIG's formula (3.5) written out, trust being in [0, 1]."""
    alpha = state.alpha_max - (state.alpha_max - state.alpha_min) / (
        1.0 + np.exp(-10.0 * (state.trust_hr - 0.5))
    )
    beta = state.beta_max - (state.beta_max - state.beta_min) / (
        1.0 + np.exp(-10.0 * (state.trust_rh - 0.5))
    )
    return alpha, beta


def columns(session, stem):
    return session.data[[f"{stem}_{axis}" for axis in "xyz"]].to_numpy()


@pytest.mark.parametrize("guidance", GUIDANCE)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_stepped_and_run_a_loop_has_the_bits_of_a_whole_run(scheme, guidance):
    whole = tl.simulate_teleoperation(scheme, seed=5, duration=SHORT, guidance=guidance)
    loop = tl.TeleoperationLoop(scheme, seed=5, duration=SHORT, guidance=guidance)
    for _ in range(300):
        loop.step()
    assert loop.run() == whole


@pytest.mark.parametrize("guidance", GUIDANCE)
def test_tmig_written_by_a_user_is_tmig(guidance):
    ours = tl.simulate_teleoperation("TMIG", seed=2, duration=20.0, guidance=guidance).data
    mine = {"seed": 2, "duration": 20.0, "guidance": guidance}
    run = tl.simulate_teleoperation(tl.Scheme("mine", tmig), **mine)
    np.testing.assert_allclose(run.data, ours, rtol=0.0, atol=1e-12)
    assert run.metadata.more["parts"] == "scheme"


def law(state):
    """A PD law that remembers the error by itself."""
    before = state.memory.get("seen")
    rate = 0.0 * state.seen  # none before the second picture
    if state.sees:
        if before is not None:
            rate = (state.seen - before) / state.sample_time
        state.memory["seen"] = state.seen.copy()
    return np.clip(1.0 * state.seen + 0.4 * rate, -1.0, 1.0)


class Wavering:
    """Functions of one's own that no second call repeats: for replays."""

    def __init__(self):
        self.rng = np.random.default_rng()

    def scheme(self, state):
        return self.rng.uniform(state.alpha_min, state.alpha_max), state.beta_max

    def trust(self, state):
        return self.rng.uniform(), state.trust_rh

    def force(self, state):
        return self.rng.normal(size=3)

    def law(self, state):
        return 0.2 * self.rng.normal(size=3)


@pytest.mark.parametrize("guidance", GUIDANCE)
def test_a_run_is_repeated_from_its_decisions_without_functions_or_hands(guidance):
    mine = Wavering()
    loop = tl.TeleoperationLoop(
        tl.Scheme("mine", mine.scheme),
        mine.law,
        seed=4,
        trust=mine.trust,
        guidance=Guidance(guidance, force=mine.force),
    )
    for k in range(500):
        loop.step(hand=(0.01 * np.sin(0.02 * k), 0.0, 0.0) if 100 < k < 300 else None)
    same = {"seed": 4, "duration": 5.0, "guidance": guidance}
    again = tl.simulate_teleoperation("M", signals=loop.decisions, **same)
    assert again.data.equals(loop.session.data)
    without = tl.simulate_teleoperation("M", **same)
    assert not without.data.equals(loop.session.data)  # negative control


def test_feedback_autonomy_and_trust_are_exchanged():
    stiff = tl.simulate_teleoperation(
        "M",
        seed=1,
        duration=SHORT,
        guidance=Guidance(force=lambda state: -6.0 * state.stretch),
    )
    np.testing.assert_allclose(
        stiff.data, tl.simulate_teleoperation("M", seed=1, duration=SHORT).data, atol=1e-12
    )
    task = tl.TrackingTask(autonomy=lambda state: (0, 0, 0))
    idle = tl.simulate_teleoperation("TMIG", seed=1, duration=SHORT, task=task)
    assert not columns(idle, "u_a").any()
    fixed = tl.simulate_teleoperation(
        "TMIG", seed=1, duration=SHORT, trust=lambda state: (0.25, 0.75)
    )
    assert (fixed["trust_hr"][1:] == 0.25).all()
    assert (fixed["trust_rh"][1:] == 0.75).all()


def test_vehicles_as_matrices_and_as_functions_are_the_transfer_functions():
    period, axes = 0.01, tracking_vehicle()
    a = np.zeros((8, 8))
    b = np.zeros((8, 3))
    c = np.zeros((6, 8))
    place = 0
    for i, axis in enumerate(
        axes
    ):  # position and states of each axis, by the series of the exponential
        n = axis.order + 1
        block = np.zeros((n + 1, n + 1))
        block[0, 1], block[1:n, 1:n], block[1:n, n] = 1.0, *axis.matrices()
        whole = sum(
            np.linalg.matrix_power(block * period, m) / float(np.prod(range(1, m + 1)))
            for m in range(12)
        )
        a[place : place + n, place : place + n], b[place : place + n, i] = (
            whole[:n, :n],
            whole[:n, n],
        )
        c[i, place], c[3 + i, place + 1] = 1.0, 1.0
        place += n
    ours = tl.simulate_teleoperation("TMIG", seed=4, duration=SHORT).data
    np.testing.assert_allclose(
        tl.simulate_teleoperation(
            "TMIG", seed=4, duration=SHORT, task=tl.TrackingTask(vehicle=(a, b, c))
        ).data,
        ours,
        atol=1e-10,
    )

    def lag(state):
        velocity = state.velocity + 0.02 * (state.command - state.velocity)
        return state.robot + 0.01 * velocity, velocity

    run = tl.simulate_teleoperation("M", seed=4, duration=SHORT, task=tl.TrackingTask(vehicle=lag))
    moved, speed = columns(run, "robot"), columns(run, "velocity")
    np.testing.assert_allclose(np.diff(moved, axis=0), 0.01 * speed[1:], atol=1e-14)


@pytest.mark.parametrize("guidance", GUIDANCE)
def test_a_run_with_a_vehicle_is_guided_by_where_it_is_and_is_repeated_without_it(guidance):
    """Oracle: the guiding force by (3.17), from the logged error, where the guard is off."""

    def lag(state):
        velocity = state.velocity + 0.02 * (state.command - state.velocity)
        return state.robot + 0.01 * velocity, velocity

    same = {"seed": 4, "duration": SHORT, "guidance": Guidance(guidance, "off")}
    loop = tl.TeleoperationLoop("M", task=tl.TrackingTask(vehicle=lag), **same)
    run = loop.run()
    if guidance == "through_channel":
        error = columns(run, "reference") - columns(run, "robot")
        np.testing.assert_allclose(columns(run, "f_s"), -6.0 * error, atol=1e-12)
    again = tl.simulate_teleoperation("M", signals=loop.decisions, **same)
    assert again.data.equals(run.data)


def test_a_device_axis_by_axis():
    settings = STUDIES["main"]
    same = tl.simulate_teleoperation("TMIG", seed=6, duration=SHORT)
    each = {
        name: (getattr(settings, name),) * 3 for name in ("mass", "damping", "stiffness", "weight")
    }
    from dataclasses import replace

    assert (
        tl.simulate_teleoperation("TMIG", study=replace(settings, **each), seed=6, duration=SHORT)
        == same
    )
    heavier = replace(settings, mass=(0.5, 0.5, 0.2))
    for guidance in GUIDANCE:
        run = tl.simulate_teleoperation(
            "TMIG", study=heavier, seed=6, duration=20.0, guidance=guidance
        )
        power = (columns(run, "r_m") * (columns(run, "f_h") - columns(run, "f_m"))).sum(axis=1)
        held = run["energy_device"] + run["energy_dissipated"]
        np.testing.assert_allclose(held, 0.01 * np.cumsum(power), rtol=1e-10, atol=1e-12)
        assert run["energy_port"].min() > -1e-9


@pytest.mark.parametrize("guidance", GUIDANCE)
@pytest.mark.parametrize("mass", [0.0, 2.0])
def test_the_arm_that_holds_the_device_may_have_a_mass(mass, guidance):
    """
    Oracle: Newton's law at the middle of every sample, for the device under the hand's force f_h
    and for an arm that nobody moves under the added force; and power at the ports, summed here.
    """
    arm = tl.Teleoperator(mass=mass, noise=0.0, proportional=0.0, derivative=0.0)
    push = np.random.default_rng(6).normal(size=(2000, 3))
    run = tl.simulate_teleoperation(
        "TMIG", arm, seed=6, duration=20.0, guidance=guidance, signals={"push": push}
    )
    x, v, f_h, f_m = (columns(run, name) for name in ("device", "device_velocity", "f_h", "f_m"))
    acceleration = np.diff(v, axis=0) / 0.01
    v, x = 0.5 * (v[1:] + v[:-1]), 0.5 * (x[1:] + x[:-1])
    held = STUDIES["main"]
    device = -held.damping * v - held.stiffness * x + f_h[:-1] - f_m[:-1]
    np.testing.assert_allclose(held.mass * acceleration, device, atol=1e-9)
    moved = push[:-1] - f_h[:-1] - arm.damping * v - arm.stiffness * x
    np.testing.assert_allclose(mass * acceleration, moved, atol=1e-9)
    power = (columns(run, "r_m") * (f_h - f_m)).sum(axis=1)
    stored = run["energy_device"] + run["energy_dissipated"]
    np.testing.assert_allclose(stored, 0.01 * np.cumsum(power), rtol=1e-10, atol=1e-12)
    assert run["energy_port"].min() > -1e-9


@pytest.mark.parametrize("guidance", GUIDANCE)
def test_the_channel_is_not_blamed_for_the_guidance(guidance):
    """
    Oracle: waves by (3.13) from the ports, without the guiding force: what arrives back is what
    the operator's end gives beyond β b r_m.
    """
    run = tl.simulate_teleoperation(
        "M", seed=1, duration=60.0, guidance=Guidance(guidance, "off"), delay=0.1
    )
    ports = 0.01 * np.cumsum(
        [
            (columns(run, velocity) * columns(run, force)).sum(axis=1)
            for velocity, force in (("r_m", "f_m"), ("r_s", "f_s"))
        ],
        axis=1,
    )
    within = run["energy_channel"] + run["energy_guidance"]
    np.testing.assert_allclose(within, ports[0] - ports[1], atol=1e-9)
    assert run["energy_channel"].min() >= -1e-9
    felt = run["energy_guidance"]
    assert felt.min() < -0.1 if guidance == "at_operator" else not felt.any()


def test_a_trace_of_packets_is_read_newest_first():
    sent = np.arange(0.0, 20.0, 0.005)
    rng = np.random.default_rng(3)
    received = sent + rng.exponential(0.05, sent.size)
    received[rng.uniform(size=sent.size) < 0.5] = np.nan
    late = packet_delay(sent, received).samples(1900, 0.01)
    for k in range(0, 1900, 37):  # by brute force: the newest of all that have come
        come = sent[received <= 0.01 * k + 1e-9]
        newest = come.max() if come.size else -0.01
        assert late[k] == pytest.approx(max(0.01 * k - newest, 0.01), abs=1e-12)
    for guidance in GUIDANCE:
        run = tl.simulate_teleoperation(
            "TMIG", duration=15.0, delay=packet_delay(sent, received), guidance=guidance
        )
        assert run["energy_port"].min() > -1e-9


@pytest.mark.parametrize(
    ("trace", "words"),
    [
        (
            ([0.0, 0.2, 0.1], [0.1, 0.3, 0.4]),
            "the trace runs backwards: packet 2, sent at t = 0.1 s",
        ),
        (([0.0, 0.1], [0.1, 0.2]), "delay to the robot: .*until 0.2 s, and the run lasts until"),
    ],
)
def test_a_trace_that_cannot_be_is_refused_by_name_and_time(trace, words):
    with pytest.raises(ValueError, match=words):
        tl.simulate_teleoperation(delay=(packet_delay(*trace), 0.1), duration=5.0)


def test_a_function_cannot_change_the_state_that_guards_rely_on():
    """Negative control: who does change the account makes the guard let energy out."""

    def forging(state):
        state.energy_port = 100.0
        return -6.0 * state.stretch

    def bending(state):
        state.r_m[0] = 0.0
        return -6.0 * state.stretch

    for function, words in ((forging, "energy_port is read only"), (bending, "read-only")):
        with pytest.raises(PartError, match=words):
            tl.simulate_teleoperation("M", seed=1, guidance=Guidance(force=function))

    def stiff(state):
        return -60.0 * state.stretch

    honest, forged = (
        tl.TeleoperationLoop("M", seed=1, guidance=Guidance(force=stiff)) for _ in range(2)
    )
    forged.simulation.state.whole["account"] = 100.0
    assert forged.run(SHORT)["energy_port"].min() < -1.0
    assert honest.run(SHORT)["energy_port"].min() > -1e-9


def flying(vehicle):
    return {"task": tl.TrackingTask(vehicle=vehicle)}


def failing(state):
    if state.t > 1.0:
        raise RuntimeError("the hand slipped")
    return state.seen


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (
            {"scheme": tl.Scheme("s", lambda s: (np.nan if s.t > 1 else 0.5, 0.3))},
            r"scheme .* alpha = nan; it must lie in \[0.2, 1\]",
        ),
        (
            {"scheme": tl.Scheme("s", lambda s: (0.5 + s.t, 0.3))},
            r"alpha = 1.0.*; it must lie in \[0.2, 1\]",
        ),
        (
            {"scheme": tl.Scheme("s", lambda s: (0.5, -0.1 * s.t + 0.1))},
            r"beta = .*; it must lie in \[0.05, 0.5\]",
        ),
        ({"scheme": tl.Scheme("s", lambda s: 1.0 / (s.t - 1.0))}, "scheme .* raised TypeError"),
        (
            {"scheme": tl.Scheme("s", lambda s: (s.robot_x, 0.3))},
            "raised AttributeError: the state has no 'robot_x'",
        ),
        ({"operator": failing}, "operator .* raised RuntimeError: the hand slipped"),
        ({"operator": partial(failing)}, "operator .* raised RuntimeError: the hand slipped"),
        (
            {"operator": lambda s: (s.t / (s.t - 1.0), 0.0, 0.0) if s.t != 0.5 else (1.0, 2.0)},
            "operator .*three numbers",
        ),
        (
            flying(lambda s: (s.robot, 0.0 / (1.0 - s.t) + s.velocity)),
            "vehicle .* raised ZeroDivisionError",
        ),
        (
            flying(lambda s: (np.log(1.0 - s.t) + s.robot, s.velocity)),
            "vehicle .* returned robot = .*nan|inf",
        ),
        ({"trust": lambda s: (np.nan, 0.5)}, "trust .* trust_hr = nan"),
        (
            {"guidance": Guidance(force=lambda s: np.full(3, np.inf))},
            r"guiding force .* guiding = \[inf inf inf\]",
        ),
        (
            {"task": tl.TrackingTask(autonomy=lambda s: s.picture[:2])},
            r"autonomy .* u_a of shape \(2,\); three numbers are wanted",
        ),
    ],
)
def test_a_part_that_fails_is_named_with_its_time_and_the_run_so_far_is_kept(parts, words):
    loop = tl.TeleoperationLoop(**({"scheme": "TMIG", "seed": 1} | parts))
    with pytest.raises(PartError, match=words) as caught:
        loop.run(5.0)
    assert "at t = " in str(caught.value)
    if caught.value.session is not None:  # more than one sample was done
        rows = len(caught.value.session.data)
        assert caught.value.session == loop.session
        same = {"scheme": "TMIG", "seed": 1} | parts
        again = tl.TeleoperationLoop(**same)
        for _ in range(rows - 1):
            again.step()
        assert again.session.data.equals(loop.session.data.iloc[: rows - 1])
    with pytest.raises(PartError, match=words):
        loop.step()


@pytest.mark.parametrize(
    ("matrices", "words"),
    [
        ((np.eye(6), np.zeros((6, 2)), np.eye(6)), r"B must have shape \(6, 3\), got \(6, 2\)"),
        ((np.eye(6), np.zeros((6, 3)), np.eye(3, 6)), r"C must have shape \(6, 6\)"),
        ((np.full((6, 6), np.nan), np.zeros((6, 3)), np.eye(6)), "A must be finite"),
    ],
)
def test_a_vehicle_of_wrong_dimensions_is_refused(matrices, words):
    with pytest.raises(ValueError, match=words):
        tl.TrackingTask(vehicle=matrices)


def test_what_a_loop_refuses():
    with pytest.raises(ValueError, match="three TransferFunction"):
        tl.TeleoperationLoop("OMI", **flying(lambda state: (state.robot, state.velocity)))
    with pytest.raises(ValueError, match="trust must be a function"):
        tl.TeleoperationLoop("M", trust=0.5)
    loop = tl.TeleoperationLoop("M", duration=0.3)
    for _ in range(30):
        loop.step()
    with pytest.raises(ValueError, match=r"ends at t = 0\.3 s; make it with a longer duration"):
        loop.step()
    for until in (0.2, 0.4):
        with pytest.raises(ValueError, match=r"until must lie between t = 0\.3 s"):
            loop.run(until)
