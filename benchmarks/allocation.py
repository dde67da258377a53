"""Steps of the correction (2.43)-(2.44) on a closed loop, and simulations under (2.8)."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterator
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
# The 99th percentile of a clipped plan takes at most so long [ms].
CLIPPED = 0.015

# Far from the target all corrections are at their limits; at it the active set moves at each step.
STARTS = {"far": (0.02, 0.45), "near": (TARGET[0] + 2e-5, TARGET[1] - 3e-5)}


def pilot() -> tl.TscModel:
    """Return the model of the pilot operator."""
    return tl.published_models()["pilot"]


def corrector(engine: str | None = None, horizon: int = HORIZON) -> tl.ThresholdCorrector:
    """Return a corrector whose target lies outside of the limits, as the printed one does."""
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
    """Yield our plans, ours beside the peers' at the same states, a long one, and simulation."""
    warnings.simplefilter("ignore", TargetWarning)
    human, robot = pilot().human, pilot().robot
    constants = {"a_r": human.a, "beta": human.beta, "h_min": human.p_min, "h_max": human.p_max}
    constants |= {"a_pr": robot.a, "b_pr": robot.b, "p_min": robot.p_min, "p_max": robot.p_max}
    data = {"constants": constants, "horizon": HORIZON}
    loops = {}
    for name in STARTS:
        loops[name], data[f"{name}_modes"] = closed_loop(name)
        data[f"{name}_states"] = scaled(loops[name])
        yield alone(name, loops[name])
    for name, states in loops.items():
        turns = in_turns(data, name, shooting(data))
        yield compared(name, states, "CasADi Opti with IPOPT", turns, turns)
    with Worker("do_mpc_steps", data) as worker:
        for name, states in loops.items():
            result = lambda n=name: worker.ask(n)[1]  # noqa: E731
            yield compared(name, states, "do-mpc with IPOPT", result, worker.timed(name))
    # A plan of an hour may take as many times as long as it is longer.
    horizon, ahead = 180 * HORIZON, itertools.cycle(loops["far"])
    plan = corrector(horizon=horizon)
    work = f"Correction, N = {horizon:,}, far, clipped"
    yield within(work, lambda: plan.step(*next(ahead)), 180 * CLIPPED)
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


def alone(name: str, states: list[tuple]) -> Row:
    """Return our clipped plan over the whole loop."""
    plan = corrector()
    stepped(plan, states[:10])
    return tail(f"Correction, N = {HORIZON}, {name}, clipped", stepped(plan, states), CLIPPED)


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
    work = f"Correction, N = {HORIZON}, {name}, CasADi"
    return beside(work, ours, peer, side, limit=50.0, least=GOALS[peer], turns=60)
