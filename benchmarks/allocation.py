"""Steps of the correction (2.43)-(2.44) on a closed loop, and simulations under (2.8)."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterator
from statistics import median
from time import perf_counter

import numpy as np

import trustlab as tl
from benchmarks.peers.correction_problem import in_turns
from benchmarks.peers.opti_steps import shooting
from benchmarks.peers.worker import Worker
from benchmarks.timing import Row, beside, same, tail, within
from trustlab.allocation import TargetWarning
from trustlab.allocation.correction import C_L, C_U, P_R, R

TARGET, C_B, HORIZON, STEPS = (0.15, 0.56), 1e-5, 200, 300

# Far from the target all corrections are at their limits; at it the active set moves at each step.
STARTS = {"far": (0.02, 0.45), "near": (TARGET[0] + 2e-5, TARGET[1] - 3e-5)}


def pilot() -> tl.TscModel:
    """Return the model of the pilot operator."""
    return tl.published_models()["pilot"]


def corrector(engine: str | None = None, horizon: int = HORIZON) -> tl.ThresholdCorrector:
    """Return a corrector whose target lies outside of the limits, as the printed one does."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TargetWarning)
        return tl.ThresholdCorrector(pilot(), TARGET, C_B, horizon, engine=engine)


def closed_loop(name: str) -> tuple[list[tuple], np.ndarray]:
    """Return states of a run with noise, (r, P_r, TSC_l, TSC_u, mode), and each plan's modes."""
    robot, engine = pilot().robot, corrector()
    noise = np.random.default_rng(20_190).normal(size=(STEPS, 4))
    (lower, upper), r, p_r, mode = STARTS[name], 0.5, 0.315, 1
    states, modes = [], []
    for row in noise:
        states.append((r, p_r, lower, upper, mode))
        plan = engine.step(*states[-1])
        modes.append(plan.path[4, :-1])
        r = float(np.clip(plan.path[0, 1] + 0.01 * row[0], 0.0, 1.0))
        p_r = float(np.clip(plan.path[1, 1] + 0.003 * row[1], robot.p_min, robot.p_max))
        moved = C_B * row[2:] if name == "near" else np.zeros(2)
        lower, upper = lower + plan.c_l + moved[0], upper + plan.c_u + moved[1]
        mode = int(plan.path[4, 0])
    return states, np.array(modes)


def scaled(states: list[tuple]) -> np.ndarray:
    """Return r, the share of P_r, and both thresholds from their target in c_b, at each step."""
    robot = pilot().robot
    r, p_r, lower, upper, _ = np.array(states).T
    share = (p_r - robot.p_min) / (robot.p_max - robot.p_min)
    return np.column_stack([r, share, (upper - TARGET[1]) / C_B, (lower - TARGET[0]) / C_B])


def rows() -> Iterator[Row]:
    """Yield our engines, the peers at the same states, growth with N, and simulation."""
    human, robot = pilot().human, pilot().robot
    numbers = [human.a, human.beta, human.p_min, human.p_max]
    data = {"constants": np.array([*numbers, robot.a, robot.b, robot.p_min, robot.p_max])}
    data["horizon"] = np.array(HORIZON)
    loops = {}
    for name in STARTS:
        loops[name], data[f"{name}_modes"] = closed_loop(name)
        data[f"{name}_states"] = scaled(loops[name])
        yield from alone(name, loops[name])
    for name, states in loops.items():
        turns = in_turns(data, name, shooting(data))
        yield compared(name, states, "CasADi Opti with IPOPT", turns, turns)
    with Worker("do_mpc_steps", data) as worker:
        for name, states in loops.items():
            result = lambda n=name: worker.ask(n)[1]  # noqa: E731
            yield compared(name, states, "do-mpc with IPOPT", result, worker.timed(name))
    yield growth(loops["far"])
    steps = 200_000
    work = f"simulate_allocation under (2.8), {steps:,} samples"
    run = lambda: tl.simulate_allocation(pilot(), 0.02, 0.45, steps)  # noqa: E731
    yield within(work, run, steps / 1e7 * 1e3, note="10 million samples a second")


def stepped(engine: tl.ThresholdCorrector, states: list[tuple]) -> list[float]:
    """Return the milliseconds of one step after the other."""
    times = []
    for state in states:
        began = perf_counter()
        engine.step(*state)
        times.append(1e3 * (perf_counter() - began))
    return times


def alone(name: str, states: list[tuple]) -> Iterator[Row]:
    """Yield both engines over the whole loop."""
    for engine, limit in ((None, 0.015), ("casadi", 50.0)):
        plan = corrector(engine)
        stepped(plan, states[:10])
        work = f"Correction, N = {HORIZON}, {name}, engine {engine or 'clipped'}"
        yield tail(work, stepped(plan, states), limit)


# How much longer peers are to take than our program.
GOALS = {"CasADi Opti with IPOPT": 3.4, "do-mpc with IPOPT": 8.5}


def compared(name: str, states: list[tuple], peer: str, result: Callable, side: Callable) -> Row:
    """
    Return our CasADi engine beside a peer, each at one state after the other; the peer's plan is
    compared with the clipped one, which is optimal, at the first states.
    """
    robot = pilot().robot
    engine, ahead = corrector("casadi"), itertools.cycle(states)
    ours = lambda: engine.step(*next(ahead))  # noqa: E731
    for state in states[:3]:
        plan = corrector().step(*state).path[:, :-1]
        # A peer's inputs are w = c/c_b + s, c_u first.
        share = 0.5 * (plan[R] + (plan[P_R] - robot.p_min) / (robot.p_max - robot.p_min))
        apart = np.reshape(result(), (2, HORIZON)) - share - plan[[C_U, C_L]] / C_B
        same(peer, 1.0, 1.0 + np.abs(apart), 1e-2)
        ours()
    work = f"Correction, N = {HORIZON}, {name}, engine casadi"
    return beside(work, ours, peer, side, least=GOALS[peer], turns=60)


def growth(states: list[tuple]) -> Row:
    """Return the power of N to which the time of a clipped plan grows."""
    sizes, times = [100, 400, 3_600, 36_000], []
    for n in sizes:
        plan = corrector(horizon=n)
        stepped(plan, states[:1])
        times.append(median(stepped(plan, states[:20])))
    power = float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
    curve = ", ".join(f"{n:,}: {ms:.3g} ms" for n, ms in zip(sizes, times, strict=True))
    note = f"N to the power of {power:.2f}; {curve}"
    return Row("Correction against N, clipped", [], goal="linear", met=power <= 1.2, note=note)
