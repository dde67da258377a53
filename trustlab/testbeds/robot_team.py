"""
A team of robots led to a goal by one operator through whichever of them leads: Chapter 4 as a
simulated task.
"""

from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    between,
    finite_array,
    finite_number,
    flag,
    of_class,
    one_of,
    positive,
    spawned,
)
from trustlab.models.trust import trust_run
from trustlab.teleoperation.delays import Delay, delays_in_samples
from trustlab.teleoperation.filters import (
    TwoPortFilter,
    WaveFilter,
    corrected_filter,
    passivity_margin,
    printed_filter,
)
from trustlab.teleoperation.loop.settings import DivergenceError
from trustlab.teleoperation.ports.ledger import READ_OUTS, accounts
from trustlab.teleoperation.records import filled, log_of, robot_numbers, signal
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.graphs import TeamGraph, formation_on, graphs_in_time
from trustlab.teleoperation.team.leader_policies import (
    Decision,
    LeaderPolicy,
    LivePolicy,
    is_live,
    policy_named,
)
from trustlab.teleoperation.team.settings import TeamOperator, TeamSettings
from trustlab.testbeds.team_run import TeamRun

NOTE = "simulated team and operator"
FILTERS = ("none", "corrected", "waves", "printed")
CUTOFF = 10.0
DECISION = 0.1
# Numbers that a run may record.
LARGEST = 200_000_000


def simulate_team(
    graph,
    policy: str | LeaderPolicy | LivePolicy = "most_trusted",
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
    changes: Mapping | None = None,
) -> TeamRun:
    """
    Simulate robots on a graph, (4.19)-(4.24), whose leader an operator steers to a goal.

    As printed, the graph is undirected, its weights are 0 or 1 and it stays; there Lemmas 6 and 7
    and Theorem 6 hold, and with any positive weights. A link that is lost takes energy out of V_fs,
    one that appears brings some (`supply_links` in the log): V_T without it never rises. On a
    directed graph ζ goes back along the edges (q̇ = Lᵀζ − Lq + …), which is (4.22) where L is
    symmetric; no storage of the leader's port is known there, so that V_fs and V_T are NaN and
    nothing is promised.

    Parameters
    ----------
    graph : networkx.Graph, networkx.DiGraph or array_like, shape (N, N)
        Who sees whom, edges from who sees to who is seen, `weight` a_ij: connected, or with a
        spanning tree if directed; without self-loops. The leader must be seen by all others,
        directly or through others.
    policy : {"most_trusted", "hysteresis", "sequence", "random"}, LivePolicy or LeaderPolicy
        Who leads; decided every 0.1 s, or every sample where samples are longer. One of your own is
        any object with a `title` and either a method `leader(now)`, called at every decision while
        the run goes on with a `Decision` (time, trust, positions, who is present, a memory of its
        own), which returns the number of the leader; or a method `leaders(trust, robots, step,
        dwell, rng)`, called once: `trust` is (4.1) in every robot at every decision, shape (M, N);
        `robots` their N names; `step` the time between decisions [s]; `dwell` τ_min [s]; `rng` a
        numpy.random.Generator; it returns M numbers. Each leads for τ_min at least, unless it
        leaves the team.
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
        Delay to the robots and back [s], at least one sample; the same both ways when `delay_back`
        is not given.
    vision_delay : float, optional
        How old the operator's picture is [s]; the greatest delay when not given.
    min_dwell : float, optional
        τ_min [s], greater than the delay; 5 T, at least 5 s, when not given.
    filters : {"corrected", "waves", "printed", "none"}, TwoPortFilter or WaveFilter
        F1 and F2 of Fig. 4.1. By name with a cutoff of 10 rad/s, and the mean b for the corrected
        gains.
    start : array_like, shape (N, 3), optional
        Where robots begin [m]; drawn within 5 m of the origin when not given.
    inner : array_like, shape (N, 3), optional
        ζ at the start; zero when not given.
    read_out : {"ledger", "interpolated", "hold"}
        How delayed waves are read, see `channel_run`.
    tolerance : float
        Distance to the goal that counts as arrived [m].
    record_every : float, optional
        Time between recorded rows [s], a multiple of `sample_time`; 0.01 s or one sample, the
        longer, when not given.
    push : array_like, shape (K, 3), optional
        Force [N] added to the hand's in every sample; V_h counts it, the operator's budget does not
        foresee it.
    switch_scattering : bool
        Whether the operator's end of the channel is switched with the leader, (4.7); False to see
        what that is for.
    require_connected : bool
        Refuse a graph in several parts, or without a spanning tree.
    changes : dict, optional
        Time [s] → the graph from the next decision on: links that are lost or appear, robots that
        leave (in no edge and not among the nodes any more) or join (nodes that were not there
        before). Use networkx graphs for that, whose robots have names.

    Returns
    -------
    TeamRun
        With `.converged`, `.time_to_goal`, `.table()`, `.positions`, `.plot()` and `.animate()`.
        Labelled synthetic.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.
    DivergenceError
        If the run grows without bound; time and block are named.

    Examples
    --------
    >>> import networkx as nx
    >>> import trustlab as tl
    >>> run = tl.simulate_team(nx.cycle_graph(4), policy="most_trusted", goal=(1.0, 2.0, 0.5), seed=0)
    >>> run.converged, round(run.time_to_goal)
    (True, 71)
    """
    names, graphs = graphs_in_time(graph, changes, flag("require_connected", require_connected))
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
    plan = _plan(graphs, settings, len(names), duration, count, T, streams[1])
    budget = operator.budget * (1.0 + 0.5 * float(np.sum((q0 - goal) ** 2) + np.sum(zeta0**2)))
    title, filtering = _filters(filters, float(np.mean([end.b for end in ends])))
    numbers = _numbers(
        settings, operator, filtering, T, rate, read_out, vision, budget, q0 - goal, tolerance
    )
    memory = _memory(delays, pushed, q0 - goal, zeta0)
    leading = Leading(policy, graphs, names, plan, dwell, streams[2])
    live = leading if is_live(policy) else None
    if live is None:
        memory.samples["lead"] = leading.ahead()[plan.decision]
    switched = flag("switch_scattering", switch_scattering)
    robots = _robots(settings, ends, T)
    table, log, modes = _fly(
        numbers, robots, memory, graphs, plan, settings, live, switched, goal, every
    )
    rows = len(modes)
    log["leader"] += goal
    t = np.round(T * every * np.arange(rows), 9)
    facts = _facts(policy, title, numbers, seed, read_out, greatest, vision, dwell)
    data = pd.DataFrame(table, index=pd.Index(t, name="t"), columns=list(kernel.COLUMNS))
    positions = modes.transpose(0, 2, 1) + goal
    trust = plan.trust[_intervals(t, plan.step, len(plan.trust))]
    later = tuple((graph.since, graph.adjacency) for graph in graphs[1:])
    return TeamRun(
        names, graphs[0].adjacency, goal, data, positions, trust, budget, tolerance, facts, later
    )


class Plan(NamedTuple):
    """When who leads is decided, and what is known of the run before it begins."""

    step: float  # between decisions [s]
    decision: np.ndarray  # of each sample, shape (K,)
    graph: np.ndarray  # number of the graph at each decision, shape (M,)
    trust: np.ndarray  # human-to-robot, (4.1), at each decision, shape (M, N)


def _fly(
    numbers,
    robots,
    memory,
    graphs: list[TeamGraph],
    plan: Plan,
    settings,
    live,
    switched: bool,
    goal,
    every: int,
):
    """
    Run the kernel from change to change of the graph, with a live policy from decision to decision;
    return what is logged.
    """
    T = numbers["sample_time"].item()
    count = len(plan.decision)
    size = len(robots)
    rows = -(-count // every)
    table, log = log_of(kernel.LOG, rows)
    modes, states = np.empty((rows, 3, size)), np.zeros(1, kernel.STATE)
    row = states.view(float)[: table.shape[1]]
    team = None
    now = None
    leads = memory.samples["lead"]
    for first, last in _spans(plan, live is not None):
        graph = graphs[plan.graph[plan.decision[first]]]
        if graph is not now:
            formation, now = formation_on(graph, settings.coupling, 0.5 * T), graph
            team = _regroup(team, formation, settings, memory, states[0])
        if live is not None:
            where = partial(_positions, team, memory, goal)
            leads[first:last] = live.choose(plan.decision[first], first * T, where)
        memory.samples["head"][first:last] = leads[first:last] if switched else leads[0]
        done, block = kernel.run_team(
            numbers, team, robots, memory, first, last, every, states, row, table, modes
        )
        if block >= 0:
            raise DivergenceError(
                f"the team diverged at t = {(done - 1) * T:g} s in the {kernel.BLOCKS[block]}; "
                "push less, switch the scattering with the leader, or use a filter that is "
                "passive"
            )
        recorded = slice(-(-first // every), -(-last // every))
        modes[recorded] = modes[recorded] @ team.vectors.T
        modes[recorded, :, ~graph.present] = np.nan  # a robot that is not in the team is nowhere
    return table, log, modes


def _plan(graphs: list[TeamGraph], settings, robots: int, duration, count, T, rng) -> Plan:
    """Return when decisions are taken, on which graph, and the trust at each."""
    step = max(DECISION, T)
    most = int(np.ceil(duration / step)) + 1
    trust = _trust(settings, robots, most, step, rng)
    since = [graph.since for graph in graphs]
    graph = np.searchsorted(since, step * np.arange(most) + 1e-9, side="right") - 1
    return Plan(step, _intervals(np.arange(count) * T, step, most), graph, trust)


def _spans(plan: Plan, live: bool) -> list[tuple[int, int]]:
    """
    Return from which sample to which the kernel runs at a stretch: to the next change of the graph,
    or the next decision.
    """
    until = plan.decision if live else plan.graph[plan.decision]
    stops = np.flatnonzero(np.diff(until)) + 1
    return list(pairwise([0, *stops.tolist(), len(plan.decision)]))


def _memory(delays, pushed, distance, zeta) -> kernel.Memory:
    """
    Return what a run remembers, at its start; w and z are positions until the first formation gives
    them a basis.
    """
    samples, arrives = np.zeros(len(pushed), kernel.SAMPLE), np.ones((2, len(pushed)), bool)
    samples["pushed"] = pushed
    (u_l, u_r), w, z = np.zeros((2, len(pushed), 3)), distance.T.copy(), zeta.T.copy()
    return kernel.Memory(
        samples, delays, arrives, accounts(), u_l, u_r, w, z, np.full(len(distance), 0.5)
    )


def _positions(team: kernel.Formation, memory: kernel.Memory, goal: np.ndarray) -> np.ndarray:
    """Return where the robots are now [m], shape (N, 3)."""
    return (memory.w @ team.vectors.T).T + goal


def _regroup(
    before: kernel.Formation | None, team: kernel.Formation, settings, memory, state
) -> kernel.Formation:
    """
    Carry the robots over to the next graph's basis; what V_fs gains or loses by the links is booked
    as their supply.
    """
    if before is not None:
        held, _ = kernel.storages(before, memory.w, memory.z)
    for modes in (memory.w, memory.z):
        positions = modes if before is None else modes @ before.vectors.T
        modes[:] = positions @ team.vectors
    if before is not None:
        gained = kernel.storages(team, memory.w, memory.z)[0] - held
        state["supply_links"] += settings.force_gain / settings.lead_gain * gained
    return team


def _facts(policy, title, numbers, seed, read_out, delay, vision, dwell) -> dict:
    """Return how a run was made."""
    facts = {"policy": policy.title, "filter": title} | {
        name: numbers[name].item() for name in ("k12", "k21")
    }
    facts |= {
        "seed": str(seed),
        "read_out": read_out,
        "delay": delay,
        "vision_delay": vision,
        "min_dwell": dwell,
    }
    return facts | {name: numbers[name].item() for name in ("sample_time", "push")} | {"note": NOTE}


def _given(
    start, inner, push, robots: int, count: int, rng
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return where the robots begin, ζ at the start, and the force added to the hand's, drawn or zero
    where not given.
    """
    drawn, none = rng.uniform(-5.0, 5.0, (robots, 3)), np.zeros((robots, 3))
    return (
        signal("start", drawn if start is None else start, robots, 3),
        signal("inner", none if inner is None else inner, robots, 3),
        signal("push", np.zeros((count, 3)) if push is None else push, count, 3),
    )


def _vision(vision_delay, delay: float, T: float) -> float:
    """
    Return how old the operator's picture is [s]: at least one sample, the greatest delay when not
    given.
    """
    vision = delay if vision_delay is None else finite_number("vision_delay", vision_delay)
    if not T * (1.0 - 1e-9) <= vision <= 1e4:
        raise ValueError(f"vision_delay must be at least one sample, {T:g} s, got {vision}")
    return vision


def _intervals(t: np.ndarray, decision: float, most: int) -> np.ndarray:
    """
    Return the decision interval that each time falls into; 1e-9 keeps rounding from moving a
    boundary.
    """
    return np.minimum((t / decision + 1e-9).astype(np.int64), most - 1)


def _samples(duration, sample_time, record_every, robots: int) -> tuple[int, int, float]:
    """
    Return the number of samples, how many of them a recorded row stands for, and the sample time,
    checked.
    """
    T = between("sample_time", positive("sample_time", sample_time), 0.0, 0.1)
    duration = between("duration", duration, 10.0 * T, 1e5)
    count = round(duration / T)
    record = max(T, 0.01) if record_every is None else positive("record_every", record_every)
    every = round(record / T)
    if every < 1 or abs(every * T - record) > 1e-6 * record:
        raise ValueError(
            f"record_every must be a multiple of sample_time = {T:g} s, got {record:g}"
        )
    rows = -(-count // every)
    if max(rows * (3 * robots + len(kernel.COLUMNS)), 16 * count) > LARGEST:
        raise ValueError(
            f"{count} samples and {rows} rows for {robots} robots are too many; shorten duration, "
            "or raise sample_time or record_every"
        )
    return count, every, T


def _dwell(min_dwell, delay: float) -> float:
    """Return τ_min [s], which must be greater than the delay."""
    dwell = max(5.0 * delay, 5.0) if min_dwell is None else finite_number("min_dwell", min_dwell)
    if not dwell > delay:
        raise ValueError(
            f"min_dwell = {dwell:g} s must be greater than the delay, {delay:g} s: waves of one "
            "leader would arrive at the one after the next (Section 4.2 asks for τ_min ≫ T)"
        )
    return dwell


def _numbers(
    settings, operator, filtering, T, rate, read_out, vision, budget, distance, tolerance
) -> np.void:
    """Return device, filters and operator as the compiled loop takes them."""
    own = ("mass", "damping", "stiffness", "weight", "steepness", "lead_gain", "force_gain")
    return filled(
        kernel.NUMBERS,
        **{name: getattr(settings, name) for name in own},
        **{name: getattr(operator, name) for name in ("reach", "drag", "guarded")},
        **filtering,
        sample_time=T,
        gain=float(np.sqrt(1.0 - rate)),
        read_out=READ_OUTS[read_out],
        push=operator.stiffness(vision),
        budget=budget,
        reserve=operator.reserve * budget,
        vision=round(vision / T),
        error_range=max(float(np.linalg.norm(distance, axis=1).max()), tolerance),
    )


def _robots(settings, ends, T: float) -> np.ndarray:
    """Return every robot's end of the channel and its trust in the operator, records of ROBOT."""
    models = settings.per_robot("robot_to_human", len(ends))
    rows = [
        (
            end.b,
            end.beta_min,
            end.beta_max,
            model.decay(T),
            model.b / model.a,
            model.t_min,
            model.t_max,
        )
        for end, model in zip(ends, models, strict=True)
    ]
    return np.array(rows, kernel.ROBOT)


def _trust(settings: TeamSettings, size: int, count: int, step: float, rng) -> np.ndarray:
    """
    Return human-to-robot trust (4.1) at every decision, shape (M, N): performance is drawn anew at
    random times.
    """
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


class Leading:
    """
    Who leads since when, as a policy says it, checked: before the run, or at one decision after the
    other while it goes on.
    """

    def __init__(
        self, policy, graphs: list[TeamGraph], names: tuple, plan: Plan, dwell: float, rng
    ):
        self.policy = policy
        self.graphs = graphs
        self.names = names
        self.plan = plan
        self.dwell = dwell
        self.rng = rng
        self.leader = None
        self.since = None
        self.memory = {}

    def ahead(self) -> np.ndarray:
        """Return the leader at each decision as the policy says it before the run."""
        plan = self.plan
        present = np.array([graph.present for graph in self.graphs])[plan.graph]
        trust = np.where(present, plan.trust, -np.inf)
        leaders = self.policy.leaders(trust, self.names, plan.step, self.dwell, self.rng)
        chosen = robot_numbers(
            "the policy's answer, one leader per decision,", leaders, len(trust), len(self.names)
        )
        for d in np.flatnonzero(np.diff(chosen, prepend=-1) | np.diff(plan.graph, prepend=-1)):
            self._lead(chosen[d], d * plan.step, self.graphs[plan.graph[d]])
        return chosen

    def choose(self, d: int, t: float, where) -> int:
        """Return the leader from decision number `d` on, asking a live policy."""
        graph = self.graphs[self.plan.graph[d]]
        trust = np.where(graph.present, self.plan.trust[d], -np.inf)
        now = Decision(
            t,
            self.names,
            graph.present,
            trust,
            self.leader,
            self.since,
            self.dwell,
            self.rng,
            self.memory,
            where,
        )
        answer = self.policy.leader(now)
        number = robot_numbers(
            f"the policy's answer at t = {t:g} s", [answer], 1, len(self.names)
        ).item()
        self._lead(number, t, graph)
        return number

    def _lead(self, leader, t, graph: TeamGraph) -> None:
        """
        Let a robot lead; it must be there, be seen by all, and take over from one that has led for
        τ_min.
        """
        picks = f"at t = {t:g} s the policy picks robot {self.names[leader]!r}, which"
        if not graph.present[leader]:
            raise ValueError(f"{picks} is not in the team then")
        if not graph.may_lead[leader]:
            raise ValueError(
                f"{picks} not all others see, directly or through others, so that it cannot lead "
                f"them; who can: {[self.names[i] for i in np.flatnonzero(graph.may_lead)]}"
            )
        if leader == self.leader:
            return
        if (
            self.leader is not None
            and graph.present[self.leader]
            and t - self.since < self.dwell - 1e-6
        ):
            raise ValueError(
                f"the policy switches at t = {t:g} s, less than min_dwell = {self.dwell:g} s "
                "after the switch before"
            )
        self.leader, self.since = leader, t


def _filters(filters, impedance: float) -> tuple[str, dict]:
    """
    Return what the filters F1 and F2 of Fig. 4.1 are, and their numbers, from what a user names or
    gives.
    """
    if isinstance(filters, str) and filters in FILTERS:
        if filters == "none":
            return "no filter", {"filtering": kernel.NO_FILTER, "cutoff": 1.0}
        named = {"waves": WaveFilter(CUTOFF), "printed": printed_filter(CUTOFF)}
        filters = named.get(filters) or corrected_filter(CUTOFF, impedance)
    if isinstance(filters, WaveFilter):
        return f"waves, {filters.cutoff:g} rad/s", {
            "filtering": kernel.WAVES,
            "cutoff": filters.cutoff,
        }
    if not isinstance(filters, TwoPortFilter):
        one_of("filters", filters, FILTERS, also="a TwoPortFilter or a WaveFilter")
    numbers = {name: getattr(filters, name) for name in ("cutoff", "k12", "k21")}
    margin = passivity_margin([filters.cutoff], [1.0, filters.cutoff], filters.k12, filters.k21)
    kind = "two-port" if margin.is_passive else "two-port that is not passive"
    return f"{kind}, {filters.cutoff:g} rad/s", numbers | {"filtering": kernel.TWO_PORT}
