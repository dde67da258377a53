"""The loop of teleoperation, stepped and at once, and measures of its runs."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trustlab as tl
from tests.cases import refused
from tests.loops import T, assert_device_balances, columns, each_guidance, missed, power
from trustlab import Scheme, TeleoperationLoop, Teleoperator, TrackingTask, simulate_teleoperation
from trustlab.teleoperation import (
    SCHEMES,
    STUDIES,
    Guidance,
    PartError,
    TeamOperator,
    TeamRobot,
    TeamSettings,
    TeamTrial,
)

# --- the loop -------------------------------------------------------------------------------------


SHORT = 8.0
MAIN = STUDIES["main"]
TRIANGLE = np.ones((3, 3)) - np.eye(3)


def logistic(low, high, trust):
    """(3.5) for trust in [0, 1]."""
    return high - (high - low) / (1.0 + np.exp(-10.0 * (trust - 0.5)))


def tmig(state):
    alpha = logistic(state.alpha_min, state.alpha_max, state.trust_hr)
    return alpha, logistic(state.beta_min, state.beta_max, state.trust_rh)


def lag(state):
    """A vehicle whose velocity follows the command."""
    velocity = state.velocity + 0.02 * (state.command - state.velocity)
    return state.robot + T * velocity, velocity


def flying(vehicle):
    return {"task": TrackingTask(vehicle=vehicle)}


@each_guidance
@pytest.mark.parametrize("scheme", SCHEMES)
def test_stepped_and_run_a_loop_has_the_bits_of_a_whole_run(scheme, guidance):
    same = {"seed": 5, "duration": SHORT, "guidance": guidance}
    loop = TeleoperationLoop(scheme, **same)
    for _ in range(300):
        loop.step()
    assert loop.run() == simulate_teleoperation(scheme, **same)


@each_guidance
def test_scheme_and_force_written_by_a_user_are_the_built_in_ones(guidance):
    same = {"seed": 2, "duration": 20.0}
    ours = simulate_teleoperation("TMIG", guidance=guidance, **same)
    spring = Guidance(guidance, force=lambda state: -6.0 * state.stretch)
    run = simulate_teleoperation(Scheme("mine", tmig), guidance=spring, **same)
    assert_allclose(run.data, ours.data, rtol=0.0, atol=1e-12)
    assert run.metadata.more["parts"] == "scheme, guiding force"


@each_guidance
def test_a_run_is_repeated_from_its_decisions_without_functions_or_hands(guidance):
    """Its functions are such that no second call repeats them."""
    rng = np.random.default_rng()
    loop = TeleoperationLoop(
        Scheme("mine", lambda s: (rng.uniform(s.alpha_min, s.alpha_max), s.beta_max)),
        lambda s: 0.2 * rng.normal(size=3),
        seed=4,
        trust=lambda s: (rng.uniform(), s.trust_rh),
        guidance=Guidance(guidance, force=lambda s: rng.normal(size=3)),
        **flying(lag),
    )
    for k in range(500):
        loop.step(hand=(0.01 * np.sin(0.02 * k), 0.0, 0.0) if 100 < k < 300 else None)
    same = {"seed": 4, "duration": 5.0, "guidance": guidance}
    again = simulate_teleoperation("M", signals=loop.decisions, **same)
    assert again.data.equals(loop.session.data)
    assert "alpha as given" in again.metadata.more["parts"]
    without = simulate_teleoperation("M", **same)
    assert not without.data.equals(loop.session.data)  # negative control


@pytest.mark.parametrize("scheme", ["OMI", Scheme("mine", tmig)])
def test_what_is_given_is_what_functions_decide_by(scheme):
    """Oracle: a run in which functions say the same, and a scheme's rule on the logged trust."""
    task = TrackingTask(autonomy=lambda state: np.full(3, 0.7))
    parts = {"task": task, "trust": lambda state: (0.2, 0.8)}
    said = simulate_teleoperation(scheme, duration=SHORT, **parts)
    given = {"u_a": columns(said, "u_a")} | {n: said[n] for n in ("trust_hr", "trust_rh")}
    assert [np.max(signal[1:]) for signal in given.values()] == [0.7, 0.2, 0.8]
    run = simulate_teleoperation(scheme, signals=given, duration=SHORT)
    assert run.data.equals(said.data)
    first = {"trust_hr": np.full(800, np.nan), "robot": np.tile([5.0, 0.0, 1.0], (800, 1))}
    first["trust_hr"][0] = 0.1
    seen = []
    watching = Scheme("watching", lambda s: seen.append((s.path_error, *s.robot)) or tmig(s))
    run = simulate_teleoperation(watching, signals=first, duration=SHORT)
    assert run["alpha"][0] == logistic(0.2, 1.0, 0.1)
    assert_array_equal(seen, run.data[["path_error", "robot_x", "robot_y", "robot_z"]])


def test_a_controller_of_ones_own_hovers_while_its_target_is_lost():
    """Oracle: the built-in controller with the same law."""
    law = {"integral": 0.0, "derivative": 0.0}
    own = TrackingTask(autonomy=lambda state: np.clip(state.picture, -1.5, 1.5))
    tasks = TrackingTask(**law), own
    ours, mine = (simulate_teleoperation("TMIG", task=t, duration=60.0).data for t in tasks)
    assert mine.equals(ours)


def test_trust_that_is_driven_starts_where_it_should():
    run = simulate_teleoperation("TMIG", trust=replace(BETA, every=1.0, start=0.9), duration=2.0)
    assert (run["trust_hr"][:100] == 0.9).all()


def test_a_log_says_how_it_was_made():
    study = replace(MAIN, window=1.0)
    who, task = Teleoperator(noise=0.9, reach=1.0), TrackingTask(speed=1.0)
    run = simulate_teleoperation("M", who, study, duration=1.0, task=task, delay=0.5)
    said = {"settings": "window = 1.0", "operator": "noise = 0.9", "task": "speed = 1.0"}
    said["samples of delay"] = "50 to 50"
    assert said.items() <= run.metadata.more.items()
    usual = simulate_teleoperation("M", duration=1.0).metadata.more
    assert {usual[name] for name in ("settings", "operator", "task")} == {"as usual"}
    team = tl.simulate_team(TRIANGLE, duration=1.0, operator=TeamOperator(9.0))
    assert team.facts["operator"] == "push = 9.0"


def test_a_step_that_is_refused_leaves_nothing_behind():
    loop, same = (TeleoperationLoop("TMIG", duration=1.0) for _ in range(2))
    with refused("hand must have 3"):
        loop.step(alpha=0.3, hand=(1.0, 2.0))
    with refused("nothing has been done"):
        _ = loop.session
    assert loop.run() == same.run()


@each_guidance
def test_a_vehicle_as_matrices_is_that_as_a_function_and_guides_by_where_it_is(guidance):
    """
    Beside a scheme that keeps something by names that a vehicle might choose, too. Oracle: the
    guiding force by (3.17), from the logged error, where the guard is off.
    """

    def remembering(state):
        state.memory.update(x=state.robot + 9.0, start=state.robot + 9.0)
        return 0.5, 0.3

    step = [[1.0, 0.98 * T], [0.0, 0.98]], [[0.02 * T], [0.02]], np.eye(2)
    matrices = tuple(np.kron(part, np.eye(3)) for part in step)
    same = {"seed": 4, "duration": SHORT, "guidance": Guidance(guidance, "off")}
    run, again = (
        simulate_teleoperation(Scheme("remembering", remembering), **same, **flying(vehicle))
        for vehicle in (lag, matrices)
    )
    assert_allclose(again.data, run.data, atol=1e-10)
    moved = np.diff(columns(run, "robot"), axis=0)
    assert_allclose(moved, T * columns(run, "velocity")[1:], atol=1e-14)
    if guidance == "through_channel":
        assert_allclose(columns(run, "f_s"), -6.0 * missed(run), atol=1e-12)


@each_guidance
@pytest.mark.parametrize("arm_mass", [0.0, 2.0])
def test_the_device_and_the_arm_obey_newton_and_the_channel_is_not_blamed(arm_mass, guidance):
    """
    Oracle: Newton's law at the middle of every sample, for the device under the hand's force f_h
    and for an arm that nobody moves under the added force; and power at the ports, summed here.
    The channel's waves by (3.13) leave out the guiding force: what arrives back is what the
    operator's end gives beyond β b r_m.
    """
    arm = Teleoperator(mass=arm_mass, noise=0.0, proportional=0.0, derivative=0.0)
    push = np.random.default_rng(6).normal(size=(2000, 3))
    run = simulate_teleoperation(
        "TMIG", arm, MAIN, 6, 20.0, guidance=Guidance(guidance, "off"), signals={"push": push}
    )
    x, v, f_h, f_m = (columns(run, name) for name in ("device", "device_velocity", "f_h", "f_m"))
    acceleration = np.diff(v, axis=0) / T
    v, x = 0.5 * (v[1:] + v[:-1]), 0.5 * (x[1:] + x[:-1])
    device = -MAIN.damping * v - MAIN.stiffness * x + f_h[:-1] - f_m[:-1]
    assert_allclose(MAIN.mass * acceleration, device, atol=1e-9)
    moved = push[:-1] - f_h[:-1] - arm.damping * v - arm.stiffness * x
    assert_allclose(arm_mass * acceleration, moved, atol=1e-9)
    assert_device_balances(run, guarded=False)
    between = T * np.cumsum(power(run, "r_m", "f_m") - power(run, "r_s", "f_s"))
    felt = run["energy_guidance"]
    assert_allclose(run["energy_channel"] + felt, between, atol=1e-9)
    assert run["energy_channel"].min() >= -1e-9
    assert felt.any() == (guidance == "at_operator")


def test_who_does_change_the_account_makes_the_guard_let_energy_out():
    """Negative control."""
    stiff = Guidance(force=lambda state: -60.0 * state.stretch)
    honest, forged = (TeleoperationLoop("M", seed=1, guidance=stiff) for _ in range(2))
    forged.simulation.state.whole["account"] = 100.0
    assert forged.run(SHORT)["energy_port"].min() < -1.0
    assert honest.run(SHORT)["energy_port"].min() > -1e-9


def guided(force):
    return {"guidance": Guidance(force=force)}


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (
            {"scheme": Scheme("s", lambda s: (np.nan if s.t > 1 else 0.5, 0.3))},
            r"scheme of this loop, at t = 1\.01 s: .* alpha = nan; it must lie in \[0.2, 1\]",
        ),
        (
            {"scheme": Scheme("s", lambda s: (s.robot_x, 0.3))},
            "AttributeError: the state has no 'robot_x'",
        ),
        ({"scheme": Scheme("s", lambda s: ("a", 0.3))}, "alpha = 'a'; it must lie in"),
        (
            {"operator": lambda s: s.seen if s.t < 1 else [][0]},
            "operator .* s: IndexError: list index out of range",
        ),
        (flying(lambda s: (np.nan * s.robot, s.velocity)), "vehicle .* returned robot = .*nan"),
        ({"trust": lambda s: (0.5, -5)}, r"trust_rh = -5; it must lie in \[0, 1\]"),
        ({"trust": lambda s: 0.5}, "trust .* returned 0.5; trust_hr and trust_rh are wanted"),
        (flying(lambda s: [s.robot]), r"returned \[array.*; robot and velocity are wanted"),
        # the state that guards rely on
        (guided(lambda s: setattr(s, "energy_port", 100.0)), "energy_port is read only"),
        (guided(lambda s: s.r_m.fill(0.0)), "read-only"),
    ],
)
def test_a_part_that_fails_is_named_with_its_time_and_the_run_so_far_is_kept(parts, words):
    arguments = {"scheme": "TMIG", "seed": 1} | parts
    loop = TeleoperationLoop(**arguments)
    with pytest.raises(PartError, match=words) as caught:
        loop.run(5.0)
    if caught.value.session is not None:  # more than one sample was done
        assert caught.value.session == loop.session
        again = TeleoperationLoop(**arguments).run(T * (len(loop.session.data) - 1))
        assert again.data.equals(loop.session.data.iloc[:-1])
    with pytest.raises(PartError, match=words):
        loop.step()


class Interrupted:
    """A scheme or a policy during which somebody presses Ctrl-C, in its 30th call."""

    title = "interrupted"

    def __init__(self, calls):
        self.calls = calls

    def __call__(self, state):
        self.calls += 1
        if self.calls == 30:
            raise KeyboardInterrupt
        return 0.5, 0.3

    def leader(self, now):
        return int(self(now)[0] > now.trust[0])


def parts(run):
    """What a run has, but for messages."""
    if isinstance(run, tl.Session):
        return [run.data]
    return run.data, run.positions, run.trust, run.switches


BETA = tl.trust.TrustInLoop(tl.trust.MODELS["beta"](), every=0.1)
GRAPHS = {0.0: nx.cycle_graph(3), 4.0: nx.path_graph(3)}
LOSSY = TeamSettings(robots=TeamRobot(loss=0.5))
DRIVEN = {"duration": SHORT, "trust": BETA}
MATRICES = np.eye(3), T * np.eye(3), np.vstack([np.eye(3), np.eye(3)])


@pytest.mark.parametrize(
    "make",
    [
        lambda who: TeleoperationLoop(Scheme("s", who), **DRIVEN, **flying(MATRICES)),
        lambda who: tl.TeamLoop(GRAPHS, who, settings=LOSSY, **DRIVEN),
    ],
)
def test_a_loop_that_was_stepped_and_interrupted_goes_on_as_if_it_had_not_been(make):
    whole, loop = make(Interrupted(30)).run(), make(Interrupted(0))
    for _ in range(9):
        loop.step()
    with pytest.raises(KeyboardInterrupt):
        loop.run()
    run = loop.run()
    for ours, theirs in zip(parts(run), parts(whole), strict=True):
        assert_array_equal(ours, theirs)


def test_a_loop_ends_with_its_duration():
    words = r"ends at t = 0\.3 s; make it with a longer duration"
    loop = TeleoperationLoop("M", duration=0.3)
    loop.run()
    with refused(words):
        loop.step()
    with refused(words):
        tl.TeamLoop(TRIANGLE, duration=0.3).step(samples=301)
    for until in (0.2, 0.4):
        with refused(r"until must lie between t = 0\.3 s"):
            loop.run(until)


def test_measures_are_those_of_the_log():
    runs = [simulate_teleoperation(scheme, seed=2, duration=12.0) for scheme in ("TMIG", "OMI")]
    table = tl.teleoperation_measures(runs)
    assert table["synthetic"].all()
    assert table["scheme"].tolist() == ["TMIG", "OMI"]
    assert table.attrs["origin"] == "simulated operators"
    run = runs[0]
    error = np.linalg.norm(missed(run), axis=1)
    expected = {
        "tracking_error": error.mean(),
        "worst_error": error.max(),
        "hand_force": np.linalg.norm(columns(run, "f_h"), axis=1).mean(),
        "alpha_rate": np.abs(np.diff(run["alpha"])).sum() / (T * (len(run) - 1)),
        "energy_operator": run["energy_operator"][-1],
        "guarded": (run["port_share"] < 1.0).mean(),
        "port_share": run["port_share"].mean(),
    }
    alone = tl.teleoperation_measures(run)
    assert alone.iloc[0][list(expected)].to_dict() == pytest.approx(expected, rel=1e-12)


def covers(axes):
    """Whether a legend lies over the curves of its axes, as drawn."""
    axes.figure.canvas.draw()
    return axes.get_legend().get_window_extent().overlaps(axes.get_window_extent())


def test_energies_that_agree_are_told_apart_and_no_legend_covers_them():
    for panel in tl.testbeds.plot_energies(simulate_teleoperation("M", duration=1.0)):
        assert np.diff([line.get_linewidth() for line in panel.lines[:4]]).max() < 0.0
        assert not covers(panel)
    energy = tl.simulate_team(TRIANGLE, duration=300.0, trial=TeamTrial(0.02, 0.1)).plot()[-1]
    assert not covers(energy)
    begin, transient, end = energy.transData.transform([(t, 0.0) for t in (0.0, 2.0, 300.0)])[:, 0]
    assert (transient - begin) / (end - begin) > 0.2
