"""
One step of the correction (2.43)-(2.44), N = 200: the clipped plan and the CasADi program beside
do-mpc, CasADi's Opti with IPOPT, and GEKKO.

The closed loop runs on the model with noise on its states, once far from the target (all
corrections at their limits) and once at it (the active set moves at every step). Every state of the
loop is solved by each side, in turns. The peers get the sequence of modes and the scaling by c_b
for free, so that what they solve is one quadratic program in all but form; ours find the sequence
themselves. A peer's inputs are run under the hard switch, and their cost held to 1e-4 of ours,
before anything is timed.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time

import numpy as np

from benchmarks import machine
from benchmarks.data import pilot
from benchmarks.peers.correction_problem import Turns
from benchmarks.peers.opti_ipopt import OptiShooting
from benchmarks.timing import Row, Spread
from benchmarks.workers import PeerMissingError, Worker
from trustlab.allocation import TargetWarning, ThresholdCorrector

TITLE = "Correction of thresholds"
TARGET = (0.15, 0.56)
C_B = 1e-5
HORIZON = 200
STEPS = 300
SEED = 20_190
STARTS = {"saturated": (0.02, 0.45), "near": (TARGET[0] + 2e-5, TARGET[1] - 3e-5)}
CLIPPED_MS = 0.015
CASADI_MS = 50.0
FASTER = 3.0
AGREE = 1e-4
LENGTHS = (25, 50, 100, 200, 400)


def rows() -> Iterator[Row]:
    """Yield both engines against their limits, one row per peer and regime, and cost against N."""
    loops = {name: closed_loop(name) for name in STARTS}
    for name, loop in loops.items():
        yield from alone(name, loop)
    data = {"constants": constants(), "horizon": np.array(HORIZON)}
    for name, loop in loops.items():
        data[f"{name}_states"], data[f"{name}_modes"] = (
            scaled(loop),
            np.array([mode for _, mode in loop]),
        )
    for name, loop in loops.items():
        opti = Turns(
            data[f"{name}_states"], data[f"{name}_modes"], OptiShooting(data, HORIZON).solve
        )
        yield compared(
            name,
            loop,
            "CasADi Opti with IPOPT",
            opti,
            lambda _, call=opti: milliseconds(call)[0] / 1e3,
            60,
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "loop.npz"
        np.savez(path, **data)
        for script, peer, turns, goal in (
            ("do_mpc_worker.py", "do-mpc with IPOPT", 60, FASTER),
            ("gekko_worker.py", "GEKKO with its own IPOPT, on this machine", 5, None),
        ):
            try:
                with Worker(script, path) as worker:
                    machine.VERSIONS.update(worker.versions)
                    for name, loop in loops.items():
                        result = lambda worker=worker, name=name: worker.result(name)  # noqa: E731
                        yield compared(name, loop, peer, result, worker.side(name), turns, goal)
            except PeerMissingError as error:
                yield Row(case("both regimes"), "", peer, fault=str(error))
    yield from by_horizon()


def case(name: str) -> str:
    """
    Return the case's title.

    Parameters
    ----------
    name : str
        The regime.
    """
    return f"{TITLE}, N = {HORIZON}, {name}"


def engines(horizon: int = HORIZON) -> dict[str, ThresholdCorrector]:
    """
    Return both correctors.

    Parameters
    ----------
    horizon : int
        N.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TargetWarning)
        clipped, casadi = (
            ThresholdCorrector(pilot(), TARGET, C_B, horizon, engine=engine, **options)
            for engine, options in ((None, {}), ("casadi", {"switch_width": 0.0}))
        )
    return {"clipped": clipped, "casadi": casadi}


def constants() -> np.ndarray:
    """Return the model's constants as the peers take them."""
    human, robot = pilot().human, pilot().robot
    return np.array(
        [human.a, human.beta, human.p_min, human.p_max, robot.a, robot.b, robot.p_min, robot.p_max]
    )


def closed_loop(name: str) -> list[tuple[tuple, np.ndarray]]:
    """
    Return the states of a run with clipped plans, (r, P_r, TSC_l, TSC_u, mode), and the plan's
    modes at each.

    Parameters
    ----------
    name : str
        The regime: "saturated" or "near".
    """
    model, engine = pilot(), engines()["clipped"]
    rng = np.random.default_rng(np.random.SeedSequence(SEED))
    (lower, upper), r, p_r, mode, out = STARTS[name], 0.5, 0.315, 1, []
    for _ in range(STEPS):
        state = (r, p_r, lower, upper, mode)
        plan = engine.step(*state)
        out.append((state, plan.path[4, :-1]))
        noise = rng.normal(size=4)
        r = float(np.clip(plan.path[0, 1] + 0.01 * noise[0], 0.0, 1.0))
        p_r = float(
            np.clip(plan.path[1, 1] + 0.003 * noise[1], model.robot.p_min, model.robot.p_max)
        )
        lower = lower + plan.c_l
        upper = upper + plan.c_u
        mode = int(plan.path[4, 0])
        if name == "near":
            lower, upper = lower + C_B * noise[2], upper + C_B * noise[3]
    return out


def scaled(loop: list) -> np.ndarray:
    """
    Return r, scaled P_r, z_u and z_l at each step.

    Parameters
    ----------
    loop : list
        From `closed_loop`.
    """
    robot = pilot().robot
    rows = [
        (
            r,
            (p_r - robot.p_min) / (robot.p_max - robot.p_min),
            (upper - TARGET[1]) / C_B,
            (lower - TARGET[0]) / C_B,
        )
        for (r, p_r, lower, upper, _), _ in loop
    ]
    return np.array(rows)


def milliseconds(call: Callable[[], object]) -> tuple[float, float]:
    """
    Return the time of one call, by the clock and of the processor; garbage is not collected before
    each, as in use.

    Parameters
    ----------
    call : callable
        What is timed.
    """
    busy, began = thread_time(), perf_counter()
    call()
    return 1e3 * (perf_counter() - began), 1e3 * (thread_time() - busy)


def alone(name: str, loop: list) -> Iterator[Row]:
    """
    Yield both engines over the whole loop: median, p99, and how far their costs part.

    Parameters
    ----------
    name : str
        The regime.
    loop : list
        From `closed_loop`.
    """
    costs = {}
    times = {}
    statuses = set()
    for key, engine in engines().items():
        for state, _ in loop[:10]:
            engine.step(*state)
        plans = []
        # One engine after the other, as in use: in turns each would find cold caches.
        times[key] = [
            milliseconds(lambda e=engine, s=state, p=plans: p.append(e.step(*s)))
            for state, _ in loop
        ]
        costs[key] = np.array([plan.cost for plan in plans])
        statuses |= {plan.status for plan in plans}
    best = costs["clipped"]
    apart = float(np.max(np.abs(costs["casadi"] - best) / np.maximum(best, C_B**2)))
    for key, limit in (("clipped", CLIPPED_MS), ("casadi", CASADI_MS)):
        clock, busy = np.transpose(times[key])
        p99, spent = np.percentile(clock, 99), np.percentile(busy, 99)
        note = (
            f"p99 {p99:.3g} ms by the clock, {spent:.3g} ms of the processor, over {len(loop)} "
            f"steps of the closed loop; costs of both engines within {apart:.0e}; "
            f"{', '.join(sorted(statuses))}"
        )
        goal = f"p99 ≤ {limit:g} ms"
        yield Row(
            case(name),
            f"trustlab, engine {key}",
            "none: time per step",
            Spread.of(list(clock)),
            goal=goal,
            met=bool(p99 <= limit),
            note=note,
        )


def compared(
    name: str,
    loop: list,
    peer: str,
    result: Callable,
    side: Callable,
    turns: int,
    faster: float | None = None,
) -> Row:
    """
    Return the row of one peer: its results checked at the first steps, then our CasADi engine and
    the peer in turns.

    Parameters
    ----------
    name : str
        The regime.
    loop : list
        From `closed_loop`.
    peer : str
        Its name.
    result : callable
        Returns its inputs w at the next step, flattened.
    side : callable
        Solves the next step and returns its seconds.
    turns : int
        How many steps to time.
    faster : float, optional
        The goal for the ratio.
    """
    ours, clipped = engines()["casadi"], engines()["clipped"]
    row = Row(
        case(name), "trustlab, engine casadi", peer, goal=f"≥ {faster:g} × faster" if faster else ""
    )
    worst, checked = 0.0, 3
    try:
        for k in range(checked):
            w = np.reshape(result(), (2, HORIZON))
            best = clipped.step(*loop[k][0]).cost
            worst = max(worst, abs(cost_of(w, loop[k][0]) - best) / max(best, C_B**2))
            ours.step(*loop[k][0])
    except (PeerMissingError, RuntimeError) as error:
        return replace(row, fault=f"failed: {str(error)[:200]}")
    if not worst < AGREE:
        return replace(row, fault=f"another optimum: its cost is {worst:.1e} off")
    a, b = [], []
    for k in range(checked, checked + turns):
        a.append(milliseconds(lambda k=k: ours.step(*loop[k][0]))[0])
        b.append(1e3 * side(1))
    ratio = Spread.of([y / x for x, y in zip(a, b, strict=True)])
    note = (
        f"p99 {np.percentile(a, 99):.3g} and {np.percentile(b, 99):.3g} ms over {turns} steps; "
        f"same cost to {worst:.0e}"
    )
    met = None if faster is None else bool(ratio.median >= faster)
    return replace(row, ours_ms=Spread.of(a), peer_ms=Spread.of(b), ratio=ratio, met=met, note=note)


def cost_of(w: np.ndarray, state: tuple) -> float:
    """
    Return the cost of a peer's inputs under the hard switch.

    Parameters
    ----------
    w : numpy.ndarray, shape (2, N)
        Inputs in [0, 1], c_u first.
    state : tuple
        r, P_r, TSC_l, TSC_u, mode.
    """
    robot, (*start, mode) = pilot().robot, state
    judge = engines()["clipped"]
    actions = np.zeros((2, w.shape[1]))
    # C = c_b (w − s) needs s, which needs the modes, which need c: the same after as many rounds as
    # switches.
    for _ in range(8):
        cost, _, _, path = judge.followed(np.array(start), mode, actions)
        share = 0.5 * (path[0] + (path[1] - robot.p_min) / (robot.p_max - robot.p_min))[:-1]
        actions = (C_B * (w - share))[::-1]
    return cost


def by_horizon() -> Iterator[Row]:
    """Yield the time of both engines against N, with the power of N that fits it."""
    loop = closed_loop("saturated")[:10]
    for key, lengths in (("clipped", (*LENGTHS, 800, 3_600, 36_000)), ("casadi", LENGTHS)):
        times = []
        for n in lengths:
            engine = engines(n)[key]
            engine.step(*loop[0][0])
            times.append(
                median(milliseconds(lambda e=engine, s=state: e.step(*s))[0] for state, _ in loop)
            )
        long = np.array(lengths) >= 50
        power = np.polyfit(np.log(np.array(lengths)[long]), np.log(np.array(times)[long]), 1)[0]
        curve = ", ".join(f"{n:,}: {ms:.3g}" for n, ms in zip(lengths, times, strict=True))
        yield Row(
            f"{TITLE}, cost against N",
            f"trustlab, engine {key}",
            "none: time grows with N to the power of …",
            note=f"ms by N: {curve}; from N = 50 on N to the power of {power:.2f}",
            goal="linear: power ≤ 1.2",
            met=bool(power <= 1.2),
        )
