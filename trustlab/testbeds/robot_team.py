"""
A team of robots led to a goal by one operator through whichever of them leads: Chapter 4 as a
simulated task.
"""

from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

from trustlab.models.checks import between, finite_array, of_class, spawned
from trustlab.models.trust import trust_run
from trustlab.teleoperation.delays import delays_in_samples
from trustlab.teleoperation.filters import WaveFilter, passivity_margin
from trustlab.teleoperation.loop.settings import DivergenceError, PartError
from trustlab.teleoperation.ports.ledger import READ_OUTS, accounts
from trustlab.teleoperation.records import filled, log_of, robot_numbers, signal
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.graphs import TeamGraph, formation_on, graphs_in_time, multiplied
from trustlab.teleoperation.team.leader_policies import (
    Decision,
    LeaderPolicy,
    LivePolicy,
    is_live,
    policy_named,
)
from trustlab.teleoperation.team.settings import (
    TeamChannel,
    TeamOperator,
    TeamSettings,
    TeamTrial,
)
from trustlab.testbeds.team_run import TeamRun

NOTE = "simulated team and operator"
DECISION = 0.1
# Numbers that a run may record.
LARGEST = 200_000_000


def simulate_team(
    graph,
    policy: str | LeaderPolicy | LivePolicy = "most_trusted",
    goal=(1.0, 2.0, 0.5),
    seed: int | np.random.SeedSequence = 0,
    duration: float = 300.0,
    operator: TeamOperator | None = None,
    settings: TeamSettings | None = None,
    trial: TeamTrial | None = None,
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
    graph : networkx.Graph, networkx.DiGraph, array_like, shape (N, N), or dict
        Who sees whom, edges from who sees to who is seen, `weight` a_ij: connected, or with a
        spanning tree if directed; without self-loops. The leader must be seen by all others,
        directly or through others. A graph that changes is a dict from time [s] to graph, with one
        at 0; each holds from the next decision on. Links are lost or appear, robots leave (in no
        edge and not among the nodes any more) or join (nodes that were not there before). Use
        networkx graphs for that, whose robots have names.
    policy : {"most_trusted", "hysteresis", "sequence", "random"}, LivePolicy or LeaderPolicy
        Who leads; decided every 0.1 s, or every sample where samples are longer. Your own policy is
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
    operator : TeamOperator, optional
        Who holds the device; TeamOperator(push=0, drag=0) leaves the team alone (Remark 13).
    settings : TeamSettings, optional
        Device, scattering, trust and gains, the channel with its delays and filters, and τ_min.
    trial : TeamTrial, optional
        Time steps, start, a force added to the hand's, and what is recorded.

    Returns
    -------
    TeamRun
        With `.converged`, `.time_to_goal`, `.table()`, `.positions`, `.plot()` and `.animate()`.
        Labelled synthetic.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.
    PartError
        If a policy of your own raises an error: policy and time are named.
    DivergenceError
        If the run grows without bound; time and block are named.

    Examples
    --------
    >>> import networkx as nx
    >>> import trustlab as tl
    >>> ring = nx.cycle_graph(4)
    >>> run = tl.simulate_team(ring, policy="most_trusted", goal=(1.0, 2.0, 0.5), seed=0)
    >>> run.converged, round(run.time_to_goal)
    (True, 71)
    """
    policy = policy_named(policy)
    operator = TeamOperator() if operator is None else of_class("operator", operator, TeamOperator)
    settings = TeamSettings() if settings is None else of_class("settings", settings, TeamSettings)
    trial = TeamTrial() if trial is None else of_class("trial", trial, TeamTrial)
    names, graphs = graphs_in_time(graph, trial.require_connected)
    goal = finite_array("goal", goal, length=3)
    count = _samples(duration, trial, len(names))
    ends = settings.per_robot("scattering", len(names))
    channel, T = settings.channel, trial.sample_time
    rate = max(end.max_delay_rate for end in ends)
    delays = delays_in_samples(channel.delays, rate, channel.read_out, count, T)
    times = _times(settings, float(delays.max() * T), T)
    streams = [np.random.default_rng(child) for child in spawned(seed, 3)]
    start, inner, pushed = _start(trial, len(names), count, streams[0])
    distance = start - goal
    plan = _plan(graphs, settings, len(names), duration, count, T, streams[1])
    budget = operator.budget * (1.0 + 0.5 * float(np.sum(distance**2) + np.sum(inner**2)))
    title, filtering = _filters(channel, float(np.mean([end.b for end in ends])))
    numbers = filled(
        kernel.NUMBERS,
        **_numbers(settings, operator),
        **filtering,
        sample_time=T,
        gain=float(np.sqrt(1.0 - rate)),
        push=operator.stiffness(times["vision_delay"]),
        budget=budget,
        reserve=operator.reserve * budget,
        vision=round(times["vision_delay"] / T),
        error_range=max(float(np.linalg.norm(distance, axis=1).max()), trial.tolerance),
    )
    leading = Leading(policy, graphs, names, plan, times["min_dwell"], streams[2])
    team = Team(numbers, _robots(settings, ends, T), graphs, plan, settings, goal, leading)
    data, coordinates = team.run(_memory(delays, pushed, distance, inner), trial.samples_per_row)
    t = data.index.to_numpy()
    trust = plan.trust[_intervals(t, plan.step, len(plan.trust))]
    facts: dict = {"policy": policy.title, "filter": title}
    facts |= {name: numbers[name].item() for name in ("k12", "k21")}
    facts |= {"seed": str(seed), "read_out": channel.read_out} | times
    facts |= {name: numbers[name].item() for name in ("sample_time", "push")} | {"note": NOTE}
    return TeamRun(
        names,
        graphs[0].adjacency,
        goal,
        data,
        coordinates.transpose(0, 2, 1) + goal,
        trust,
        budget,
        trial.tolerance,
        facts,
        tuple((round(T * first, 9), graphs[number].adjacency) for first, number in plan.changes),
    )


class Plan(NamedTuple):
    """When who leads is decided, and what is known of the run before it begins."""

    step: float  # between decisions [s]
    decision: np.ndarray  # of each sample, shape (K,)
    graph: np.ndarray  # number of the graph at each decision, shape (M,)
    trust: np.ndarray  # human-to-robot, (4.1), at each decision, shape (M, N)

    @property
    def changes(self) -> list[tuple[int, int]]:
        """From which sample on another graph holds, and its number."""
        numbers = self.graph[self.decision]
        return [(int(k), int(numbers[k])) for k in np.flatnonzero(np.diff(numbers)) + 1]

    def spans(self, live: bool) -> list[tuple[int, int]]:
        """
        Return from which sample to which the kernel runs at a stretch: to the next change of the
        graph, or the next decision of a live policy.
        """
        until = self.decision if live else self.graph[self.decision]
        stops = np.flatnonzero(np.diff(until)) + 1
        return list(pairwise([0, *stops.tolist(), len(self.decision)]))


def _plan(graphs: list[TeamGraph], settings, robots: int, duration, count, T, rng) -> Plan:
    """Return when decisions are taken, on which graph, and the trust at each."""
    step = max(DECISION, T)
    most = int(np.ceil(duration / step)) + 1
    trust = _trust(settings, robots, most, step, rng)
    since = [graph.since for graph in graphs]
    graph = np.searchsorted(since, step * np.arange(most) + 1e-9, side="right") - 1
    return Plan(step, _intervals(np.arange(count) * T, step, most), graph, trust)


class Team(NamedTuple):
    """A team as the kernel runs it from change to change of its graph."""

    numbers: np.void
    robots: np.ndarray
    graphs: list[TeamGraph]
    plan: Plan
    settings: TeamSettings
    goal: np.ndarray
    leading: "Leading"

    def run(self, memory: kernel.Memory, every: int) -> tuple[pd.DataFrame, np.ndarray]:
        """
        Return what is logged, a row every `every` samples, and where the robots are from the goal.
        """
        T, plan = self.numbers["sample_time"].item(), self.plan
        rows = -(-len(plan.decision) // every)
        table, log = log_of(kernel.LOG, rows)
        distances, states = np.empty((rows, 3, len(self.robots))), np.zeros(1, kernel.STATE)
        row = states.view(float)[: table.shape[1]]
        formation = graph = None
        leads, heads = memory.samples["lead"], memory.samples["head"]
        live = is_live(self.leading.policy)
        if not live:
            leads[:] = self.leading.ahead()[plan.decision]
        for first, last in plan.spans(live):
            decision = plan.decision[first]
            if self.graphs[plan.graph[decision]] is not graph:
                graph = self.graphs[plan.graph[decision]]
                formation = self._regroup(formation, graph, memory, states[0])
            if live:
                where = partial(_positions, formation, memory, self.goal)
                leads[first:last] = self.leading.choose(decision, first * T, where)
            switched = self.settings.channel.switch_scattering
            heads[first:last] = leads[first:last] if switched else leads[0]
            done, block = kernel.run_team(
                self.numbers,
                formation,
                self.robots,
                memory,
                first,
                last,
                every,
                states,
                row,
                table,
                distances,
            )
            if block >= 0:
                raise DivergenceError(
                    f"the team diverged at t = {(done - 1) * T:g} s in the "
                    f"{kernel.BLOCKS[block]}; push less, switch the scattering with the leader, "
                    "or use a filter that is passive"
                )
            recorded = slice(-(-first // every), -(-last // every))
            # one product of matrices, not one per row: NumPy takes forty times as long for these
            flat = distances[recorded].reshape(-1, len(self.robots))
            flat[:] = multiplied(flat, formation.vectors.T)
            distances[recorded, :, ~graph.present] = np.nan  # not in the team, nowhere
        log["leader"] += self.goal
        t = pd.Index(np.round(T * every * np.arange(rows), 9), name="t")
        return pd.DataFrame(table, index=t, columns=list(kernel.COLUMNS)), distances

    def _regroup(
        self, before: kernel.Formation | None, graph: TeamGraph, memory, state
    ) -> kernel.Formation:
        """
        Carry the robots over to the next graph's basis; what V_fs gains or loses by the links is
        booked as their supply.
        """
        h = 0.5 * self.numbers["sample_time"].item()
        after = formation_on(graph, self.settings.coupling, h)
        if before is not None:
            stored, _ = kernel.storages(before, memory.w, memory.z)
        for coordinates in (memory.w, memory.z):
            places = coordinates if before is None else multiplied(coordinates, before.vectors.T)
            coordinates[:] = multiplied(places, after.vectors)
        if before is not None:
            gained = kernel.storages(after, memory.w, memory.z)[0] - stored
            state["supply_links"] += self.settings.force_gain / self.settings.lead_gain * gained
        return after


def _memory(delays, pushed, distance, zeta) -> kernel.Memory:
    """
    Return what a run remembers, at its start; w and z are positions until the first formation gives
    them a basis.
    """
    samples, arrives = np.zeros(len(pushed), kernel.SAMPLE), np.ones((2, len(pushed)), bool)
    samples["pushed"] = pushed
    return kernel.Memory(
        samples,
        delays,
        arrives,
        accounts(),
        np.zeros((len(pushed), 3)),
        np.zeros((len(pushed), 3)),
        distance.T.copy(),
        zeta.T.copy(),
        np.full(len(distance), 0.5),
    )


def _positions(team: kernel.Formation, memory: kernel.Memory, goal: np.ndarray) -> np.ndarray:
    """Return where the robots are now [m], shape (N, 3)."""
    return multiplied(memory.w, team.vectors.T).T + goal


def _start(
    trial: TeamTrial, robots: int, count: int, rng
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where the robots begin, drawn by default, ζ at the start, and the force added."""
    start = rng.uniform(-5.0, 5.0, (robots, 3)) if trial.start is None else trial.start
    inner = np.zeros((robots, 3)) if trial.inner is None else trial.inner
    push = np.zeros((count, 3)) if trial.push is None else trial.push
    return (
        signal("start", start, robots, 3),
        signal("inner", inner, robots, 3),
        signal("push", push, count, 3),
    )


def _times(settings: TeamSettings, delay: float, T: float) -> dict[str, float]:
    """Return the greatest delay, how old the operator's picture is, and τ_min [s]."""
    vision, dwell = settings.channel.vision_delay, settings.min_dwell
    vision = delay if vision is None else vision
    if not T * (1.0 - 1e-9) <= vision <= 1e4:
        raise ValueError(f"vision_delay must be at least one sample, {T:g} s, got {vision}")
    dwell = max(5.0 * delay, 5.0) if dwell is None else dwell
    if not dwell > delay:
        raise ValueError(
            f"min_dwell = {dwell:g} s must be greater than the delay, {delay:g} s: waves of one "
            "leader would arrive at the one after the next (Section 4.2 asks for τ_min ≫ T)"
        )
    return {"delay": delay, "vision_delay": vision, "min_dwell": dwell}


def _intervals(t: np.ndarray, decision: float, most: int) -> np.ndarray:
    """
    Return the decision interval that each time falls into; 1e-9 keeps rounding from moving a
    boundary.
    """
    return np.minimum((t / decision + 1e-9).astype(np.int64), most - 1)


def _samples(duration, trial: TeamTrial, robots: int) -> int:
    """Return the number of samples, checked."""
    count = round(between("duration", duration, 10.0 * trial.sample_time, 1e5) / trial.sample_time)
    rows = -(-count // trial.samples_per_row)
    if max(rows * (3 * robots + len(kernel.COLUMNS)), 16 * count) > LARGEST:
        raise ValueError(
            f"{count} samples and {rows} rows for {robots} robots are too many; shorten duration, "
            "or raise sample_time or record_every"
        )
    return count


def _numbers(settings: TeamSettings, operator: TeamOperator) -> dict:
    """Return the settings of device and operator that the kernel takes as they are."""
    names = ("mass", "damping", "stiffness", "weight", "steepness", "lead_gain", "force_gain")
    numbers = {name: getattr(settings, name) for name in names}
    numbers |= {name: getattr(operator, name) for name in ("reach", "drag", "guarded")}
    return numbers | {"read_out": READ_OUTS[settings.channel.read_out]}


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
        try:
            leaders = self.policy.leaders(trust, self.names, plan.step, self.dwell, self.rng)
        except Exception as error:
            raise self._raised(error) from error
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
        try:
            answer = self.policy.leader(now)
        except Exception as error:
            raise self._raised(error, f", at t = {t:g} s") from error
        number = robot_numbers(
            f"the policy's answer at t = {t:g} s", [answer], 1, len(self.names)
        ).item()
        self._lead(number, t, graph)
        return number

    def _raised(self, error: Exception, when: str = "") -> PartError:
        """Return the error of a policy that raised one."""
        raised = f"raised {type(error).__name__}: {error}"
        return PartError(f"the leader policy {self.policy.title!r} {raised}{when}")

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


def _filters(channel: TeamChannel, impedance: float) -> tuple[str, dict]:
    """Return what the filters F1 and F2 of Fig. 4.1 are, and their numbers."""
    filters = channel.filter_at(impedance)
    if filters is None:
        return "no filter", {"filtering": kernel.NO_FILTER, "cutoff": 1.0}
    cutoff = filters.cutoff
    if isinstance(filters, WaveFilter):
        return f"waves, {cutoff:g} rad/s", {"filtering": kernel.WAVES, "cutoff": cutoff}
    margin = passivity_margin([cutoff], [1.0, cutoff], filters.k12, filters.k21)
    kind = "two-port" if margin.is_passive else "two-port that is not passive"
    numbers = {"cutoff": cutoff, "k12": filters.k12, "k21": filters.k21}
    return f"{kind}, {cutoff:g} rad/s", numbers | {"filtering": kernel.TWO_PORT}
