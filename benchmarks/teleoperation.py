"""
The teleoperation loop at 1 kHz beside plain NumPy and Drake, and the optimal share of Appendix A
per step.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter_ns

import numpy as np

import trustlab as tl
from benchmarks.peers.plain_loop import PlainLoop
from benchmarks.timing import Row, Spread, here, in_turns
from benchmarks.workers import PeerMissingError, Worker
from trustlab.models.simulation import Simulation, compiled_for
from trustlab.teleoperation import STUDIES, Guidance
from trustlab.teleoperation.loop.kernel import teleoperate
from trustlab.teleoperation.loop.records import LoopState

TITLE = "Teleoperation"
DURATION, PERIOD = 120.0, 0.001
LATE = 100
"""
Delay of the linear case in samples; Drake's block reads its input a sample later than ours, so it
is given one less.
"""
PLAIN = 52
"""
Columns that the peers log: the first ones of ours, without what guidance adds and the target's
energy.
"""
FINE = replace(STUDIES["main"], sample_time=PERIOD)
PRINTED = {"study": FINE, "guidance": Guidance("through_channel", "cancel")}


def prepared(scheme: str, duration: float = DURATION, **arguments) -> Simulation:
    """
    Return the simulation of a loop at the pause before its first sample.

    Parameters
    ----------
    scheme : str
        Who sets the scales.
    duration : float
        Length [s].
    **arguments
        Of `TeleoperationLoop`.
    """
    return tl.TeleoperationLoop(scheme, duration=duration, **arguments).simulation


def again(start: Simulation) -> np.ndarray:
    """
    Run the compiled loop from its start and return its log as a table.

    Parameters
    ----------
    start : Simulation
        As prepared; stays as it is.
    """
    state = LoopState(start.state.whole.copy(), start.state.sent, start.state.accounts.copy())
    log = np.empty_like(start.log)
    run = compiled_for(teleoperate, 0, 0, start.setup, state, start.inputs, log)
    run(0, log.size, start.setup, state, start.inputs, log)
    return log.view(float).reshape(log.size, -1)


def flat(numbers, stem: str = "") -> dict[str, float]:
    """
    Return nested constants by dotted names.

    Parameters
    ----------
    numbers : numpy.void
        The constants.
    stem : str
        Name of what they stand in.
    """
    found = {}
    for name in numbers.dtype.names:
        value = numbers[name]
        found |= (
            flat(value, f"{stem}{name}.") if value.dtype.names else {f"{stem}{name}": float(value)}
        )
    return found


SETTINGS = ("force_scaling", "gain", "guidance", "steepness", "command_range", "error_range")


def as_arrays(start: Simulation) -> dict[str, np.ndarray]:
    """
    Return the loop's inputs as arrays by name, as the peers read them.

    Parameters
    ----------
    start : Simulation
        As prepared.
    """
    inputs = start.inputs[:-1]
    setup = start.setup.numbers[0]
    state = start.state.whole[0]
    data = {name: inputs[name] for name in ("reference", "detected", "motor")}
    data |= {"moving": inputs["reference_velocity"], "pushed": inputs["push"]}
    data |= {"delays": start.setup.delays[:, :-1]}
    data |= {name: setup[name] for name in ("phi", "gamma")}
    numbers = {name: float(setup[name]) for name in (*SETTINGS, "window", "sample_time")}
    numbers |= flat(setup["trust_hr"], "trust_hr.") | flat(setup["trust_rh"], "trust_rh.")
    for one in ("mass", "damping", "stiffness", "weight"):
        numbers[one] = float(setup["device"][one][0])
    numbers["b"] = float(setup["near"]["b"])
    for scale in ("alpha", "beta"):
        numbers[f"{scale}.low"] = float(state[f"{scale}_min"])
        numbers[f"{scale}.high"] = float(state[f"{scale}_max"])
    for name, values in (
        ("settings", numbers),
        ("hand", flat(setup["hand"])),
        ("auto", flat(setup["auto"])),
    ):
        data[name], data[f"names_{name}"] = np.array([*values.values()]), np.array([*values])
    return data


def probed(step, *sizes: int) -> tuple[np.ndarray, ...]:
    """
    Return the matrices A, B, C, D of a linear function (state, input) → (next state, output).

    Parameters
    ----------
    step : callable
        The function.
    *sizes : int
        Number of states and of inputs.
    """
    columns = [np.concatenate(step(e[: sizes[0]], e[sizes[0] :])) for e in np.eye(sum(sizes))]
    whole = np.array(columns).T
    n = sizes[0]
    return whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]


def linear_case() -> tuple[dict, dict[str, np.ndarray]]:
    """
    Return the arguments of a run that is linear, and the matrices of its parts for Drake's blocks.
    """
    settings = FINE
    still = tl.Teleoperator(proportional=0.0, derivative=0.0, noise=0.0)
    task = tl.TrackingTask(failure_every=1e9)
    count = round(DURATION / PERIOD)
    rates, sizes = np.array([1.3, 0.8, 2.1]), np.array([1.0, 0.7, 0.5])
    push = sizes * np.sin(rates * PERIOD * np.arange(count)[:, None])
    arguments = {
        "scheme": "M",
        "operator": still,
        "study": settings,
        "task": task,
        "delay": LATE * PERIOD,
        "guidance": Guidance("through_channel", "off"),
        "signals": {"push": push},
    }
    run = prepared(**arguments)
    ends = settings.scattering
    setup = run.setup.numbers[0]
    guidance = setup["guidance"]
    phi, gamma = setup["phi"], setup["gamma"]
    reference, moving = run.inputs["reference"][:-1], run.inputs["reference_velocity"][:-1]
    into, back = (np.sqrt(2.0 * ends.b / top) for top in (ends.alpha_max, ends.beta_max))
    stiff, damp = settings.stiffness + still.stiffness, settings.damping + still.damping
    inertia, tip = 2.0 * settings.mass / PERIOD, 1.0 + 0.5 * PERIOD * settings.weight
    drag = settings.force_scaling * ends.beta_max

    def master(state, inputs):
        x = state[:3]
        v = state[3:]
        force = inputs[:3]
        wave = inputs[3:]  # constant delays: the ledger gives out what has arrived
        right = (
            inertia * v - stiff * x + force - drag * (ends.b * settings.weight * x + back * wave)
        )
        middle = right / (inertia + damp + 0.5 * PERIOD * stiff + drag * ends.b * tip)
        sent = np.sqrt(2.0 * ends.b * ends.beta_min) * (tip * middle + settings.weight * x)
        return (
            x + PERIOD * middle,
            2.0 * middle - v,
            sent + np.sqrt(ends.beta_min / ends.beta_max) * wave,
            x,
        )

    def slave(state, inputs):
        vehicle, wave = state.reshape(3, 3), inputs[3:]
        force = -guidance * (inputs[:3] - vehicle[:, 0])
        command = ends.alpha_max * (into * wave - force) / ends.b
        after = np.einsum("ijk,ik->ij", phi, vehicle) + gamma * command[:, None]
        sent = (
            np.sqrt(2.0 * ends.alpha_min / ends.b) * force
            - np.sqrt(ends.alpha_min / ends.alpha_max) * wave
        )
        return after.ravel(), sent, vehicle[:, 0]

    turn = np.hypot(moving[0, 0] / task.size_x, 0.0) / abs(
        np.sqrt(1.0 - (reference[0, 0] / task.size_x) ** 2)
    )
    spins = np.concatenate([[turn, 2.0 * turn], rates])
    start = np.zeros(11)
    start[0], start[1] = reference[0, 0], moving[0, 0] / turn
    start[2], start[3] = reference[0, 1], moving[0, 1] / (2.0 * turn)
    start[4::2][:3] = 0.0
    start[5:10:2], start[10] = sizes, settings.height

    def source(state, _):
        after = state.copy()
        for i, spin in enumerate(spins):
            c, s = np.cos(spin * PERIOD), np.sin(spin * PERIOD)
            after[2 * i], after[2 * i + 1] = (
                c * state[2 * i] + s * state[2 * i + 1],
                c * state[2 * i + 1] - s * state[2 * i],
            )
        return after, state[4:10:2], np.array([state[0], state[2], state[10]])

    data = as_arrays(run) | {"late": np.full(2, LATE - 1), "source_start": start}
    begin = np.zeros((3, 3))
    begin[:, 0] = reference[0]
    data["slave_start"] = begin.ravel()
    for name, step, states, inputs in (
        ("source", source, 11, 0),
        ("master", master, 6, 6),
        ("slave", slave, 9, 6),
    ):
        data |= {
            f"{name}_{letter}": m
            for letter, m in zip("abcd", probed(step, states, inputs), strict=True)
        }
    return arguments, data


def rows() -> Iterator[Row]:
    """Yield the loop beside NumPy and Drake, and the time of an optimal share."""
    arguments = {"scheme": "TMIG", "seed": 1} | PRINTED
    start = prepared(**arguments)
    data = as_arrays(start)
    case = f"Teleoperation loop, 3 axes, {DURATION:.0f} s at 1 kHz"
    ours = "trustlab teleoperate (compiled), every signal and energy logged"

    def loop():
        return again(start)[:, :PLAIN]

    plain = PlainLoop(data)
    ours_log, fault = loop(), ""
    gap = np.abs(plain.run() - ours_log).max(axis=0) / (np.abs(ours_log).max(axis=0) + 1e-12)
    if gap.max() > 1e-9:
        fault = f"its log differs by {gap.max():.1e}"
    peer = "the same loop in plain NumPy, a sample a call"
    if fault:
        yield Row(case, ours, peer, fault=fault)
    else:
        mine, other, ratio = in_turns(here(loop), here(plain.run), 3, warm=False)
        note = (
            f"whole logs agree to {gap.max():.0e} of each signal; goal from the issue, after "
            "compilation"
        )
        yield Row(
            case,
            ours,
            peer,
            mine,
            other,
            ratio,
            goal="≤ 50 ms",
            met=bool(mine.median <= 50.0),
            note=note,
        )
    whole = "trustlab simulate_teleoperation: noise, delays, loop and a checked Session"
    mine, other, ratio = in_turns(
        here(lambda: tl.simulate_teleoperation(duration=DURATION, **arguments)), here(loop), 9
    )
    yield Row(
        case, whole, "its own compiled loop alone", mine, other, ratio, note="for information"
    )
    yield from drake(case, ours, loop, ours_log, data)
    yield from parts()
    yield cold_start()
    yield from shares()


def drake(case: str, ours: str, loop, log: np.ndarray, data: dict) -> Iterator[Row]:
    """
    Yield the rows beside Drake.

    Parameters
    ----------
    case, ours : str
        What is compared.
    loop : callable
        Our loop.
    log : numpy.ndarray
        Its log.
    data : dict
        Its inputs.
    """
    peer = "a Drake LeafSystem, periodic update in NumPy, logged"
    arguments, parts = linear_case()
    reduced = "Device, waves, delays of 0.1 s and vehicle (linear part), 120 s at 1 kHz"
    blocks = "Drake's compiled LinearSystem and DiscreteTimeDelay blocks, logged"
    with tempfile.TemporaryDirectory() as folder:
        try:
            np.savez(Path(folder) / "full.npz", **data)
            with Worker("drake_worker.py", Path(folder) / "full.npz") as worker:
                peer = f"{peer} (drake {worker.versions['drake']})"
                theirs = np.array(worker.result("leaf, first samples")).reshape(-1, log.shape[1])
                gap = np.abs(theirs - log[: len(theirs)]).max()
                last = np.abs(np.array(worker.result("leaf")) - log[-1]).max()
                if max(gap, last) > 1e-7:
                    yield Row(case, ours, peer, fault=f"its log differs by {max(gap, last):.1e}")
                else:
                    times = in_turns(here(loop), worker.side("leaf"), 3, warm=False)
                    yield Row(
                        case,
                        ours,
                        peer,
                        *times,
                        note=f"first samples and the last agree to {max(gap, last):.0e}",
                    )
        except PeerMissingError as error:
            yield Row(case, ours, peer, fault=str(error))
        start = prepared(**arguments)

        def own():
            again(start)

        run = tl.simulate_teleoperation(duration=DURATION, **arguments)
        names = [f"{stem}_{axis}" for stem in ("device", "robot") for axis in "xyz"]
        expected = run.data[names].to_numpy()[::100]
        try:
            np.savez(Path(folder) / "linear.npz", **parts)
            with Worker("drake_worker.py", Path(folder) / "linear.npz") as worker:
                theirs = np.array(worker.result("linear")).reshape(expected.shape)
                gap = np.abs(theirs - expected).max()
                if gap > 1e-7:
                    yield Row(reduced, ours, blocks, fault=f"its positions differ by {gap:.1e}")
                else:
                    times = in_turns(here(own), worker.side("linear"), 9)
                    note = (
                        f"positions agree to {gap:.0e}; ours runs the full loop (scales, "
                        "trust, ledgers) on the same signals"
                    )
                    yield Row(reduced, ours, blocks, *times, note=note)
        except PeerMissingError as error:
            yield Row(reduced, ours, blocks, fault=str(error))


def logistic(state):
    """
    Return TMIG's scales as a user would write them.

    Parameters
    ----------
    state : View
        State of the loop.
    """
    fall = (
        0.5 * (1.0 - np.tanh(5.0 * (state.trust_hr - 0.5))),
        0.5 * (1.0 - np.tanh(5.0 * (state.trust_rh - 0.5))),
    )
    alpha = state.alpha_min + (state.alpha_max - state.alpha_min) * fall[0]
    return alpha, state.beta_min + (state.beta_max - state.beta_min) * fall[1]


def parts() -> Iterator[Row]:
    """Yield a user's scheme beside the built-in one, and the loop step by step."""
    case = f"Teleoperation loop, guidance at the operator, {DURATION:.0f} s at 100 Hz"
    ours = "a user's scheme, asked every sample"
    mine = tl.Scheme("mine", logistic)

    def whole(scheme):
        return tl.simulate_teleoperation(scheme, seed=1, duration=DURATION)

    # both have an exponential, whose last bits differ
    if not np.allclose(whole(mine).data, whole("TMIG").data, rtol=0.0, atol=1e-6):
        yield Row(case, ours, "the built-in scheme", fault="its log differs")
        return
    for scheme, name, most in ((mine, ours, 250.0), ("OMI", "scheme OMI", 250.0)):
        own, built_in, ratio = in_turns(
            here(lambda s=scheme: whole(s)), here(lambda: whole("TMIG")), 9
        )
        peer, goal = "the built-in scheme TMIG", f"≤ {most:.0f} ms"
        yield Row(case, name, peer, own, built_in, ratio, goal=goal, met=bool(own.median <= most))
    loops = [
        tl.TeleoperationLoop(scheme, study=FINE, seed=1, duration=3600.0)
        for scheme in ("TMIG", mine)
    ]
    own, other, ratio = in_turns(here(loops[0].step), here(loops[1].step), 9)
    fast = bool(own.median <= 0.02)
    case = "Teleoperation loop, one step"
    peer = "the same with a user's scheme"
    yield Row(case, "built-in parts", peer, own, other, ratio, "≥ 50,000 steps/s", fast)


def cold_start() -> Row:
    """Return the time of a fresh process that runs a scheme, with warm and with empty caches."""
    line = "import trustlab as tl; tl.simulate_teleoperation('TMIG', duration=1.0)"

    def fresh(cache: str | None) -> None:
        with tempfile.TemporaryDirectory() as empty:
            named = {"TRUSTLAB_CACHE_DIR": cache or empty}
            subprocess.run([sys.executable, "-c", line], env=os.environ | named, check=True)

    with tempfile.TemporaryDirectory() as kept:
        warm, empty, ratio = in_turns(here(lambda: fresh(kept)), here(lambda: fresh(None)), 3)
    met = bool(warm.median <= 2000.0 and empty.median <= 8000.0)
    note = "the loop is compiled; functions of one's own are not"
    case = "Fresh process: import, one run of 1 s"
    return Row(
        case,
        "warm caches",
        "empty caches",
        warm,
        empty,
        ratio,
        "≤ 2 s warm, ≤ 8 s empty",
        met,
        note,
    )


def shares() -> Iterator[Row]:
    """Yield the time of one optimal share; the note has the 99th percentile."""
    rng = np.random.default_rng(3)
    sizes = (0.3, 0.3, 1.0, 0.5, 0.5)
    situations = [
        [rng.normal(0.0, 10 ** rng.uniform(-1, 0.5) * s, 3) for s in sizes] for _ in range(2000)
    ]
    blending = tl.OptimalBlending()
    blending.step(*situations[0])
    times = []
    for now in situations:
        began = perf_counter_ns()
        blending.step(*now)
        times.append((perf_counter_ns() - began) / 1e6)
    p99 = float(np.percentile(times, 99))
    yield Row(
        "Optimal share of Appendix A, one step",
        "trustlab OptimalBlending",
        "none: time per step",
        Spread.of(times),
        goal="p99 ≤ 2 ms",
        met=bool(p99 <= 2.0),
        note=f"99th percentile: {p99:.3f} ms of 2,000 states",
    )
