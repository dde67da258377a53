"""A team of robots led to a goal by one operator through whichever of them leads: Chapter 4 as a simulated task."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from trustlab.models.checks import between, finite_array, finite_number, of_class, one_of, positive, spawned
from trustlab.models.trust import trust_run
from trustlab.teleoperation.delays import Delay, delays_in_samples
from trustlab.teleoperation.filters import TwoPortFilter, WaveFilter, corrected_filter, passivity_margin, printed_filter
from trustlab.teleoperation.loop.settings import DivergenceError
from trustlab.teleoperation.ports.ledger import READ_OUTS, accounts
from trustlab.teleoperation.records import log_of, robot_numbers, signal
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.leader_policies import LeaderPolicy, policy_named
from trustlab.teleoperation.team.settings import TeamOperator, TeamSettings, flag, team_graph
from trustlab.testbeds.team_run import TeamRun

NOTE = "simulated team and operator"
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
    names, adjacency = team_graph(graph, flag("require_connected", require_connected))
    policy = policy_named(policy)
    settings = TeamSettings() if settings is None else of_class("settings", settings, TeamSettings)
    operator = TeamOperator() if operator is None else of_class("operator", operator, TeamOperator)
    one_of("read_out", read_out, READ_OUTS)
    goal, tolerance = finite_array("goal", goal, length=3), positive("tolerance", tolerance)
    count, every, T = _samples(duration, sample_time, record_every, len(names))
    ends = settings.per_robot("scattering", len(names))
    rate = max(end.max_delay_rate for end in ends)
    both = {"delay": delay, "delay_back": delay if delay_back is None else delay_back}
    delays = delays_in_samples(both, rate, read_out, count, T)
    greatest = float(delays.max() * T)
    vision, dwell = _vision(vision_delay, greatest, T), _dwell(min_dwell, greatest)
    streams = [np.random.default_rng(child) for child in spawned(seed, 3)]
    q0, zeta0, pushed = _given(start, inner, push, len(names), count, streams[0])
    trust, leads, decision = _leaders(policy, settings, names, duration, count, T, dwell, streams)
    heads = leads if flag("switch_scattering", switch_scattering) else np.full(count, leads.item(0))
    values, vectors, w, z = _modes(adjacency, q0 - goal, zeta0)
    budget = operator.budget * (1.0 + 0.5 * float(np.sum(w**2) + np.sum(z**2)))
    filtering = _filters(filters, float(np.mean([end.b for end in ends])))
    numbers = _numbers(settings, operator, filtering, T, rate, read_out, vision, budget, q0 - goal, tolerance)
    rows = -(-count // every)
    table, log = log_of(kernel.LOG, rows + 1)  # the last row is the kernel's scratch
    modes = np.empty((rows, 3, len(names)))
    done, block = kernel.run_team(
        numbers, values, vectors, leads, heads, _robots(settings, ends, T),
        delays, np.ones((2, count), bool), accounts(), w, z, pushed, every, np.zeros(1, kernel.STATE), log, modes,
    )  # fmt: skip
    if block >= 0:
        raise _diverged(block, (done - 1) * T)
    log["leader"] += goal
    t = np.round(T * every * np.arange(rows), 9)
    facts = _facts(policy, filtering, numbers, seed, read_out, greatest, vision, dwell)
    data = pd.DataFrame(table[:rows], index=pd.Index(t, name="t"), columns=list(kernel.COLUMNS))
    positions = (modes @ vectors.T).transpose(0, 2, 1) + goal
    trust = trust[_intervals(t, decision, len(trust))]
    return TeamRun(names, adjacency, goal, data, positions, trust, budget, tolerance, facts)


def _modes(adjacency, distance, zeta) -> tuple[np.ndarray, ...]:
    """Return eigenvalues and eigenvectors of the Laplacian, and the modes of two arrays of shape (N, 3)."""
    values, vectors = np.linalg.eigh(np.diag(adjacency.sum(axis=1)) - adjacency)
    w, z = (np.ascontiguousarray(array.T @ vectors) for array in (distance, zeta))
    # the least eigenvalue is 0; rounding may make it negative, which would let the mean drift
    return np.maximum(values, 0.0), np.ascontiguousarray(vectors), w, z


def _facts(policy, filtering, numbers, seed, read_out, delay, vision, dwell) -> dict:
    """Return how a run was made."""
    return {
        "policy": policy.title,
        "filter": filtering.title,
        "k12": filtering.k12,
        "k21": filtering.k21,
        "seed": str(seed),
        "read_out": read_out,
        "delay": delay,
        "vision_delay": vision,
        "min_dwell": dwell,
        "sample_time": numbers.sample_time,
        "push": numbers.push,
        "note": NOTE,
    }


def _given(start, inner, push, robots: int, count: int, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where the robots begin, ζ at the start, and the force added to the hand's, drawn or zero where not given."""
    drawn, none = rng.uniform(-5.0, 5.0, (robots, 3)), np.zeros((robots, 3))
    return (
        signal("start", drawn if start is None else start, robots, 3),
        signal("inner", none if inner is None else inner, robots, 3),
        signal("push", np.zeros((count, 3)) if push is None else push, count, 3),
    )


def _diverged(block: int, t: float) -> DivergenceError:
    """Return the error of a run that grew without bound."""
    return DivergenceError(
        f"the team diverged at t = {t:g} s in the {kernel.BLOCKS[block]}; push less, switch the scattering with the leader, or use a "
        "filter that is passive"
    )


def _vision(vision_delay, delay: float, T: float) -> float:
    """Return how old the operator's picture is [s]: at least one sample, the greatest delay when not given."""
    vision = delay if vision_delay is None else finite_number("vision_delay", vision_delay)
    if not T * (1.0 - 1e-9) <= vision <= 1e4:
        raise ValueError(f"vision_delay must be at least one sample, {T:g} s, got {vision}")
    return vision


def _intervals(t: np.ndarray, decision: float, most: int) -> np.ndarray:
    """Return the decision interval that each time falls into; 1e-9 keeps rounding from moving a boundary."""
    return np.minimum((t / decision + 1e-9).astype(np.int64), most - 1)


def _leaders(policy, settings, names, duration, count, T, dwell, streams) -> tuple[np.ndarray, np.ndarray, float]:
    """Return human-to-robot trust at every decision, who leads in each sample, and the time between decisions [s]."""
    decision = max(DECISION, T)
    trust = _trust(settings, len(names), int(np.ceil(duration / decision)) + 1, decision, streams[1])
    chosen = _chosen(policy, trust, names, decision, dwell, streams[2])
    return trust, chosen[_intervals(np.arange(count) * T, decision, len(chosen))], decision


def _samples(duration, sample_time, record_every, robots: int) -> tuple[int, int, float]:
    """Return the number of samples, how many of them a recorded row stands for, and the sample time, checked."""
    T = between("sample_time", positive("sample_time", sample_time), 0.0, 0.1)
    duration = between("duration", duration, 10.0 * T, 1e5)
    count = round(duration / T)
    record = max(T, 0.01) if record_every is None else positive("record_every", record_every)
    every = round(record / T)
    if every < 1 or abs(every * T - record) > 1e-6 * record:
        raise ValueError(f"record_every must be a multiple of sample_time = {T:g} s, got {record:g}")
    rows = -(-count // every)
    if max(rows * (3 * robots + len(kernel.COLUMNS)), 16 * count) > LARGEST:
        raise ValueError(
            f"{count} samples and {rows} rows for {robots} robots are too many; shorten duration, or raise sample_time or "
            "record_every"
        )
    return count, every, T


def _dwell(min_dwell, delay: float) -> float:
    """Return τ_min [s], which must be greater than the delay."""
    dwell = max(5.0 * delay, 5.0) if min_dwell is None else finite_number("min_dwell", min_dwell)
    if not dwell > delay:
        raise ValueError(
            f"min_dwell = {dwell:g} s must be greater than the delay, {delay:g} s: waves of one leader would arrive at the one "
            "after the next (Section 4.2 asks for τ_min ≫ T)"
        )
    return dwell


def _numbers(
    settings, operator, filtering, T, rate, read_out, vision, budget, distance, tolerance
) -> kernel.TeamNumbers:
    """Return device, filters and operator as the compiled loop takes them."""
    device = settings.device()
    return kernel.TeamNumbers(
        sample_time=T,
        mass=device.mass[0, 0],
        damping=device.damping[0, 0],
        stiffness=device.stiffness[0, 0],
        weight=device.weight[0, 0],
        gain=float(np.sqrt(1.0 - rate)),
        read_out=READ_OUTS[read_out],
        filtering=filtering.kind,
        cutoff=filtering.cutoff,
        k12=filtering.k12,
        k21=filtering.k21,
        push=operator.stiffness(vision),
        reach=operator.reach,
        drag=operator.drag,
        budget=budget,
        reserve=operator.reserve * budget,
        guarded=operator.guarded,
        vision=round(vision / T),
        error_range=max(float(np.linalg.norm(distance, axis=1).max()), tolerance),
        steepness=settings.steepness,
    )


def _robots(settings, ends, T: float) -> np.ndarray:
    """Return every robot's end of the channel and its trust in the operator, records of ROBOT."""
    models = settings.per_robot("robot_to_human", len(ends))
    rows = [
        (end.b, end.beta_min, end.beta_max, model.decay(T), model.b / model.a, model.t_min, model.t_max)
        for end, model in zip(ends, models, strict=True)
    ]
    return np.array(rows, kernel.ROBOT)


def _trust(settings: TeamSettings, size: int, count: int, step: float, rng) -> np.ndarray:
    """Return human-to-robot trust (4.1) at every decision, shape (M, N): performance is drawn anew at random times."""
    models = settings.per_robot("human_to_robot", size)
    trust = np.empty((count, size))
    for i, (model, stream) in enumerate(zip(models, rng.spawn(size), strict=True)):
        anew = stream.random(count) < min(step / settings.performance_time, 1.0)
        drawn = stream.random(count + 1)
        performance = drawn[np.cumsum(anew)]
        start = stream.random()
        share = trust_run(performance[:-1], model.decay(step), model.b / model.a, start)
        trust[:, i] = model.t_min + (model.t_max - model.t_min) * share
    return trust


def _chosen(policy, trust: np.ndarray, names: tuple, step: float, dwell: float, rng) -> np.ndarray:
    """Return the policy's leaders, checked: they exist, and stay for τ_min."""
    leaders = policy.leaders(trust, names, step, dwell, rng)
    chosen = robot_numbers("the policy's answer, one leader per decision,", leaders, len(trust), len(names))
    switches = np.flatnonzero(np.diff(chosen)) + 1
    short = np.diff(np.concatenate([[0], switches])) * step < dwell - 1e-6
    if short.any():
        k = int(np.argmax(short))
        raise ValueError(
            f"the policy switches at t = {switches[k] * step:g} s, less than min_dwell = {dwell:g} s after the switch before"
        )
    return chosen


class Filtering(NamedTuple):
    """F1 and F2 of Fig. 4.1 as numbers, and what they are."""

    kind: int
    cutoff: float
    k12: float
    k21: float
    title: str


def _filters(filters, impedance: float) -> Filtering:
    """Return the filters that a user names or gives."""
    if isinstance(filters, str) and filters in FILTERS:
        if filters == "none":
            return Filtering(kernel.NO_FILTER, 1.0, 0.0, 0.0, "no filter")
        named = {"waves": WaveFilter(CUTOFF), "printed": printed_filter(CUTOFF)}
        filters = named.get(filters) or corrected_filter(CUTOFF, impedance)
    if isinstance(filters, WaveFilter):
        return Filtering(kernel.WAVES, filters.cutoff, 0.0, 0.0, f"waves, {filters.cutoff:g} rad/s")
    if not isinstance(filters, TwoPortFilter):
        one_of("filters", filters, FILTERS, also="a TwoPortFilter or a WaveFilter")
    margin = passivity_margin([filters.cutoff], [1.0, filters.cutoff], filters.k12, filters.k21)
    kind = "two-port" if margin.is_passive else "two-port that is not passive"
    title = f"{kind}, {filters.cutoff:g} rad/s"
    return Filtering(kernel.TWO_PORT, filters.cutoff, filters.k12, filters.k21, title)
