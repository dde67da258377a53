"""A team of robots led to a goal by one operator through whichever of them leads: Chapter 4 as a simulated task."""

from __future__ import annotations

import numpy as np
import pandas as pd

from trustlab.models.checks import finite_array, finite_number, whole_number
from trustlab.models.trust import trust_run
from trustlab.teleoperation.channel import READ_OUTS
from trustlab.teleoperation.delays import Delay, delay_from
from trustlab.teleoperation.filters import (
    TwoPortFilter,
    WaveFilter,
    corrected_filter,
    passivity_margin,
    printed_filter,
)
from trustlab.teleoperation.leader_policies import LeaderPolicy, policy_named
from trustlab.teleoperation.loop import DivergenceError
from trustlab.teleoperation.team import TeamOperator, TeamSettings, team_graph
from trustlab.teleoperation.team_kernel import (
    BLOCKS,
    COLUMNS,
    NO_FILTER,
    TWO_PORT,
    WAVES,
    TeamNumbers,
    run_team,
)
from trustlab.testbeds.team_run import TeamRun

__all__ = ["simulate_team"]

FILTERS = ("none", "corrected", "waves", "printed")
CUTOFF = 10.0
DECISION = 0.1
LARGEST = 200_000_000
"""Numbers that a run may record."""


def simulate_team(
    graph,
    policy: str | LeaderPolicy = "most_trusted",
    goal=(1.0, 2.0, 0.5),
    seed: int | np.random.SeedSequence = 0,
    duration: float = 300.0,
    sample_time: float = 1e-3,
    settings: TeamSettings | None = None,
    operator: TeamOperator | None = None,
    delay: float | Delay = 0.2,
    delay_back: float | Delay | None = None,
    vision_delay: float | None = None,
    min_dwell: float | None = None,
    filters: str | TwoPortFilter | WaveFilter = "corrected",
    start: np.ndarray | None = None,
    inner: np.ndarray | None = None,
    read_out: str = "ledger",
    tolerance: float = 1e-3,
    record_every: float | None = None,
    push: np.ndarray | None = None,
    switch_scattering: bool = True,
    require_connected: bool = True,
) -> TeamRun:
    """
    Simulate robots on a graph, (4.19)-(4.24), whose leader an operator steers to a goal.

    Parameters
    ----------
    graph : networkx.Graph or array_like, shape (N, N)
        Who sees whom: undirected, connected, without self-loops.
    policy : {"most_trusted", "hysteresis", "sequence", "random"} or LeaderPolicy
        Who leads; decided every 0.1 s, or every sample where samples are longer. One of your own is any object with a
        `title` and a method `leaders(trust, robots, step, dwell, rng)`, called once: `trust` is (4.1) in every robot at
        every decision, shape (M, N); `robots` their N names; `step` the time between decisions [s]; `dwell` τ_min [s];
        `rng` a numpy.random.Generator. It returns M whole numbers from 0 to N − 1, each kept for τ_min at least.
    goal : array_like, shape (3,)
        r_q [m], known to the operator alone.
    seed : int or numpy.random.SeedSequence
        Streams for the start, the robots' performance and the policy are spawned from it.
    duration : float
        Length [s]; large teams move slowly, for one robot is driven and all are moved.
    sample_time : float
        Step of the midpoint rule [s].
    settings : TeamSettings, optional
        Device, channel and trust.
    operator : TeamOperator, optional
        Who holds the device; TeamOperator(push=0, drag=0) leaves the team alone (Remark 13).
    delay, delay_back : float or Delay
        Delay to the robots and back [s], at least one sample; the same both ways when `delay_back` is not given.
    vision_delay : float, optional
        How old the operator's picture is [s]; the greatest delay when not given.
    min_dwell : float, optional
        τ_min [s], greater than the delay; 5 T, at least 5 s, when not given.
    filters : {"corrected", "waves", "printed", "none"}, TwoPortFilter or WaveFilter
        F1 and F2 of Fig. 4.1. By name with a cutoff of 10 rad/s, and the mean b for the corrected gains.
    start : array_like, shape (N, 3), optional
        Where robots begin [m]; drawn within 5 m of the origin when not given.
    inner : array_like, shape (N, 3), optional
        ζ at the start; zero when not given.
    read_out : {"ledger", "interpolated", "hold"}
        How delayed waves are read, see `channel_run`.
    tolerance : float
        Distance to the goal that counts as arrived [m].
    record_every : float, optional
        Time between recorded rows [s], a multiple of `sample_time`; 0.01 s or one sample, the longer, when not given.
    push : array_like, shape (K, 3), optional
        Force [N] added to the hand's in every sample; V_h counts it, the operator's budget does not foresee it.
    switch_scattering : bool
        Whether the operator's end of the channel is switched with the leader, (4.7); False to see what that is for.
    require_connected : bool
        Refuse a graph in several parts.

    Returns
    -------
    TeamRun
        With `.converged`, `.time_to_goal`, `.table()`, `.positions`, `.plot()` and `.animate()`. Labelled synthetic.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.
    DivergenceError
        If the run grows without bound; time and block are named.
    """
    names, adjacency = team_graph(graph, _flag("require_connected", require_connected))
    size = len(names)
    policy = policy_named(policy)
    settings = _of("settings", settings, TeamSettings)
    operator = _of("operator", operator, TeamOperator)
    goal = finite_array("goal", goal, length=3)
    duration, T = finite_number("duration", duration), finite_number("sample_time", sample_time)
    if not 0.0 < T <= 0.1:
        raise ValueError(f"sample_time must lie in (0, 0.1] s, got {T}")
    if not 10.0 * T <= duration <= 1e5:
        raise ValueError(f"duration must be at least ten samples and at most 1e5 s, got {duration}")
    tolerance = _positive("tolerance", tolerance)
    if read_out not in READ_OUTS:
        raise ValueError(f"read_out must be one of {', '.join(READ_OUTS)}, got {read_out!r}")
    streams = _streams(seed)
    count = round(duration / T)
    record = max(T, 0.01) if record_every is None else _positive("record_every", record_every)
    every = round(record / T)
    if every < 1 or abs(every * T - record) > 1e-6 * record:
        raise ValueError(f"record_every must be a multiple of sample_time = {T:g} s, got {record:g}")
    rows = -(-count // every)
    if max(rows * (3 * size + len(COLUMNS)), 16 * count) > LARGEST:
        raise ValueError(
            f"{count} samples and {rows} rows for {size} robots are too many; shorten duration, or raise sample_time or "
            "record_every"
        )
    ends = settings.per_robot("scattering", size)
    rate = max(end.max_delay_rate for end in ends)
    delays, greatest = _delays((delay, delay if delay_back is None else delay_back), rate, read_out, count, T)
    vision = greatest if vision_delay is None else finite_number("vision_delay", vision_delay)
    if not T * (1.0 - 1e-9) <= vision <= 1e4:
        raise ValueError(f"vision_delay must be at least one sample, {T:g} s, got {vision}")
    dwell = max(5.0 * greatest, 5.0) if min_dwell is None else finite_number("min_dwell", min_dwell)
    if not dwell > greatest:
        raise ValueError(
            f"min_dwell = {dwell:g} s must be greater than the delay, {greatest:g} s: waves of one leader would arrive at the "
            "one after the next (Section 4.2 asks for τ_min ≫ T)"
        )
    q0 = _start("start", start, size, lambda: streams[0].uniform(-5.0, 5.0, (size, 3)))
    zeta0 = _start("inner", inner, size, lambda: np.zeros((size, 3)))
    decision = max(DECISION, T)
    trust = _trust(settings, size, int(np.ceil(duration / decision)) + 1, decision, streams[1])
    chosen = _chosen(policy, trust, names, decision, dwell, streams[2])
    leads = chosen[np.minimum((np.arange(count) * T / decision + 1e-9).astype(np.int64), len(chosen) - 1)]
    heads = leads if _flag("switch_scattering", switch_scattering) else np.full(count, leads[0])
    values, vectors = np.linalg.eigh(np.diag(adjacency.sum(axis=1)) - adjacency)
    w = np.ascontiguousarray((q0 - goal).T @ vectors)
    z = np.ascontiguousarray(zeta0.T @ vectors)
    budget = operator.budget * (1.0 + 0.5 * float(np.sum(w**2) + np.sum(z**2)))
    far = max(float(np.linalg.norm(q0 - goal, axis=1).max()), tolerance)
    kind, cutoff, k12, k21, title = _filters(filters, float(np.mean([end.b for end in ends])))
    pushed = np.zeros((count, 3)) if push is None else _pushed(push, count)
    device = settings.device()
    numbers = TeamNumbers(
        T, device.mass[0, 0], device.damping[0, 0], device.stiffness[0, 0], device.weight[0, 0],
        float(np.sqrt(1.0 - rate)), READ_OUTS[read_out], kind, cutoff, k12, k21, operator.stiffness(vision),
        operator.reach, operator.drag, budget, operator.reserve * budget, bool(operator.guarded),
        round(vision / T), far, settings.steepness,
    )  # fmt: skip
    table = np.array([(end.b, end.beta_min, end.beta_max) for end in ends])
    models = settings.per_robot("robot_to_human", size)
    trusts = np.array([(0.5 * (m.t_min + m.t_max), m.keep(T), m.b / m.a, m.t_min, m.t_max) for m in models])
    log, modes = np.empty((rows, len(COLUMNS))), np.empty((rows, 3, size))
    done, block = run_team(
        numbers, np.maximum(values, 0.0), np.ascontiguousarray(vectors), leads, heads, table, trusts, delays,
        np.ones((2, count), bool), w, z, np.zeros(3), np.zeros(3), pushed, every, log, modes,
    )  # fmt: skip
    if block >= 0:
        raise DivergenceError(
            f"the team diverged at t = {(done - 1) * T:g} s in the {BLOCKS[block]}; push less, switch the scattering with the "
            "leader, or use a filter that is passive"
        )
    log[:, :3] += goal
    t = np.round(T * every * np.arange(rows), 9)
    data = pd.DataFrame(log, index=pd.Index(t, name="t"), columns=list(COLUMNS))
    positions = (modes @ vectors.T).transpose(0, 2, 1) + goal
    facts = {
        "policy": policy.title,
        "filter": title,
        "k12": k12,
        "k21": k21,
        "seed": str(seed),
        "read_out": read_out,
        "delay": greatest,
        "vision_delay": vision,
        "min_dwell": dwell,
        "sample_time": T,
        "push": numbers.push,
        "note": "simulated team and operator",
    }
    steps = np.minimum((t / decision + 1e-9).astype(np.int64), len(trust) - 1)
    return TeamRun(names, adjacency, goal, data, positions, trust[steps], budget, tolerance, facts)


def _flag(name: str, value) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def _positive(name: str, value) -> float:
    number = finite_number(name, value)
    if not number > 0.0:
        raise ValueError(f"{name} must be positive, got {number}")
    return number


def _of(name: str, value, kind):
    if value is None:
        return kind()
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be of class {kind.__name__}, got {type(value).__name__}")
    return value


def _streams(seed) -> list[np.random.Generator]:
    """Return three streams of the seed, the same at every call."""
    if isinstance(seed, np.random.SeedSequence):
        own = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size)
    else:
        own = np.random.SeedSequence(whole_number("seed", seed, least=0))
    return [np.random.default_rng(child) for child in own.spawn(3)]


def _delays(given, rate: float, read_out: str, count: int, T: float) -> tuple[np.ndarray, float]:
    """Return delays both ways in samples, and the greatest in seconds."""
    delays = np.empty((2, count))
    for i, (name, value) in enumerate(zip(("delay", "delay_back"), given, strict=True)):
        delay = delay_from(name, value, rate)
        if read_out != "ledger" and delay.max_rate > rate + 1e-9:
            raise ValueError(
                f"{name} grows at up to {delay.max_rate:g} s/s, but f_i is set for {rate:g} (max_delay_rate of the scattering); "
                "raise it, or read out by ledger"
            )
        seconds = delay.samples(count, T)
        if not seconds.all():
            raise ValueError(f"{name} must be at least one sample, {T:g} s, got 0")
        delays[i] = seconds / T
    near = np.round(delays)
    delays = np.where(np.abs(delays - near) < 1e-6, near, delays)
    return delays, float(delays.max() * T)


def _start(name: str, given, size: int, draw) -> np.ndarray:
    if given is None:
        return draw()
    try:
        array = np.asarray(given)
        if array.dtype.kind not in "iuf":
            raise TypeError
        array = array.astype(float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of numbers, got {type(given).__name__}") from None
    if array.shape != (size, 3):
        raise ValueError(f"{name} must have shape ({size}, 3), one row per robot, got {array.shape}")
    if not np.isfinite(array).all():
        i, j = np.argwhere(~np.isfinite(array))[0]
        raise ValueError(f"{name} must be finite, but robot {i}, axis {j} is {array[i, j]}")
    return array


def _pushed(push, count: int) -> np.ndarray:
    return np.ascontiguousarray(_start("push", push, count, None))


def _trust(settings: TeamSettings, size: int, count: int, step: float, rng) -> np.ndarray:
    """Return human-to-robot trust (4.1) at every decision, shape (M, N): performance is drawn anew at random times."""
    models = settings.per_robot("human_to_robot", size)
    trust = np.empty((count, size))
    for i, (model, stream) in enumerate(zip(models, rng.spawn(size), strict=True)):
        anew = stream.random(count) < min(step / settings.performance_time, 1.0)
        drawn = stream.random(count + 1)
        performance = drawn[np.cumsum(anew)]
        start = stream.random()
        share = trust_run(performance[:-1], model.keep(step), model.b / model.a, start)
        trust[:, i] = model.t_min + (model.t_max - model.t_min) * share
    return trust


def _chosen(policy, trust: np.ndarray, names: tuple, step: float, dwell: float, rng) -> np.ndarray:
    """Return the policy's leaders, checked: they exist, and stay for τ_min."""
    chosen = np.asarray(policy.leaders(trust, names, step, dwell, rng))
    if chosen.shape != (len(trust),) or chosen.dtype.kind not in "iu":
        raise ValueError(
            f"the policy must return {len(trust)} whole numbers, one per decision, got {chosen.dtype} {chosen.shape}"
        )
    if chosen.min() < 0 or chosen.max() >= len(names):
        bad = int(chosen[(chosen < 0) | (chosen >= len(names))][0])
        raise ValueError(
            f"the policy names robot number {bad}, which does not exist; there are {len(names)} robots"
        )
    switches = np.flatnonzero(np.diff(chosen)) + 1
    short = np.diff(np.concatenate([[0], switches])) * step < dwell - 1e-6
    if short.any():
        k = int(np.argmax(short))
        raise ValueError(
            f"the policy switches at t = {switches[k] * step:g} s, less than min_dwell = {dwell:g} s after the switch before"
        )
    return chosen.astype(np.int64)


def _filters(filters, impedance: float) -> tuple[int, float, float, float, str]:
    if isinstance(filters, str) and filters in FILTERS:
        if filters == "none":
            return NO_FILTER, 1.0, 0.0, 0.0, "no filter"
        if filters == "waves":
            filters = WaveFilter(CUTOFF)
        else:
            filters = printed_filter(CUTOFF) if filters == "printed" else corrected_filter(CUTOFF, impedance)
    if isinstance(filters, WaveFilter):
        return WAVES, filters.cutoff, 0.0, 0.0, f"waves, {filters.cutoff:g} rad/s"
    if isinstance(filters, TwoPortFilter):
        passive = passivity_margin(
            [filters.cutoff], [1.0, filters.cutoff], filters.k12, filters.k21
        ).is_passive
        kind = "two-port" if passive else "two-port that is not passive"
        return TWO_PORT, filters.cutoff, filters.k12, filters.k21, f"{kind}, {filters.cutoff:g} rad/s"
    raise ValueError(
        f"filters must be one of {', '.join(map(repr, FILTERS))}, a TwoPortFilter or a WaveFilter, got {filters!r}"
    )
