"""
A team of robots led to a goal by one operator through whichever of them leads: Chapter 4 as a
simulated task.
"""

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    between,
    finite_array,
    finite_number,
    of_class,
    spawned,
    whole_number,
)
from trustlab.models.trust import trust_run, trust_step
from trustlab.teleoperation.delays import delays_in_samples
from trustlab.teleoperation.filters import WaveFilter, passivity_margin
from trustlab.teleoperation.loop.parts import View
from trustlab.teleoperation.loop.settings import DivergenceError, PartError
from trustlab.teleoperation.ports.ledger import READ_OUTS, accounts
from trustlab.teleoperation.records import filled, log_of, robot_numbers, signal
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.graphs import TeamGraph, formation_on, graphs_in_time, multiplied
from trustlab.teleoperation.team.leader_policies import (
    LeaderPolicy,
    LivePolicy,
    TeamSituation,
    is_live,
    policy_named,
)
from trustlab.teleoperation.team.performance import Motion, measure_named, measured
from trustlab.teleoperation.team.settings import (
    TeamChannel,
    TeamOperator,
    TeamSettings,
    TeamTrial,
)
from trustlab.testbeds.team_run import TeamRun
from trustlab.trust.driving import TrustCourse, TrustInLoop
from trustlab.trust.interface import TrustDynamics

NOTE = "simulated team and operator"
DECISION = 0.1
# How long a drifting robot's velocity takes to be forgotten [s].
DRIFT_TIME = 5.0
# A live hand is taken to be at most so far away [m], where its grip has long reached its limit.
FARTHEST_HAND = 1e6
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
    performance: str | Callable = "motion",
    trust: TrustDynamics | TrustInLoop | None = None,
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
        the run goes on with a `TeamSituation` (time, trust, positions, who is present, a memory of
        its own), which returns the number of the leader; or a method `leaders(trust, robots, step,
        dwell, rng)`, called once: `trust` is (4.1) in every robot at every decision, shape (M, N);
        `robots` their N names; `step` the time between decisions [s]; `dwell` τ_min [s]; `rng` a
        numpy.random.Generator; it returns M numbers. Measured trust is not known before the run:
        such a policy has `uses_trust = False`, or runs with performance="random". Each leads for
        τ_min at least, unless it leaves the team: a wish to switch waits until then.
    goal : array_like, shape (3,)
        r_q [m], known to the operator alone.
    seed : int or numpy.random.SeedSequence
        Streams for the start, performance at random, the policy and robots' faults are spawned from
        it.
    duration : float
        Length [s]; large teams move slowly, for one robot is driven and all are moved.
    operator : TeamOperator, optional
        Who holds the device; TeamOperator(push=0, drag=0) leaves the team alone (Remark 13).
    settings : TeamSettings, optional
        Device, scattering, trust and gains, the channel with its delays and filters, and τ_min.
    trial : TeamTrial, optional
        Time steps, start, a force added to the hand's, and what is recorded.
    performance : {"motion", "tracking", "cohesion", "packets", "random"} or callable
        What trust (4.1) in a robot comes from, at every decision. "tracking": how well it moves as
        (4.22) asks. "motion": likewise, the leader's times the packets that arrived. "cohesion":
        how near it is to the mean of those it sees. "packets": those of the leader that arrived.
        "random": drawn, which says nothing of the robot, for tests of what holds whoever leads. Or
        f(motion) → one number from 0 to 1 per robot, NaN where there is nothing to judge by, so
        that trust stays; see `Motion`.
    trust : TrustDynamics or TrustInLoop, optional
        A model of `trustlab.trust` in place of (4.1), of each robot by itself, one trial a second;
        `trust.TrustInLoop` sets how long a trial is and where trust starts.

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
    (True, 69)
    """
    return TeamLoop(
        graph, policy, goal, seed, duration, operator, settings, trial, performance, trust
    ).run()


class TeamLoop:
    """
    A team and its operator (Fig. 4.1), stepped or run.

    Parameters
    ----------
    graph : networkx.Graph, networkx.DiGraph, array_like or dict
        Who sees whom; this and what follows as of `simulate_team`.
    policy : {"most_trusted", "hysteresis", "sequence", "random"}, LivePolicy or LeaderPolicy
        Who leads.
    goal : array_like, shape (3,)
        r_q [m].
    seed : int or numpy.random.SeedSequence
        Of all that is drawn.
    duration : float
        How long the loop may run [s]: delays and whatever is random are drawn for this time.
    operator : TeamOperator, optional
        Who holds the device.
    settings : TeamSettings, optional
        Device, scattering, trust, robots, gains and channel.
    trial : TeamTrial, optional
        Time steps, start, added force and recording.
    performance : {"motion", "tracking", "cohesion", "packets", "random"} or callable
        What trust in a robot comes from.
    trust : TrustDynamics or TrustInLoop, optional
        A model of trust in place of (4.1).

    Attributes
    ----------
    state
        The state after the last sample: every signal and energy of `TeamRun.table()`, by name.
    robots : tuple
        Names.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.

    Examples
    --------
    >>> import networkx as nx
    >>> import trustlab as tl
    >>> loop = tl.TeamLoop(nx.cycle_graph(4), seed=0, duration=20.0)
    >>> state = loop.step(hand=(0.01, 0.02, 0.0), leader=2)
    >>> loop.leader, round(loop.t, 3)
    (2, 0.001)
    >>> loop.run().converged
    False
    """

    def __init__(
        self,
        graph,
        policy: str | LeaderPolicy | LivePolicy = "most_trusted",
        goal=(1.0, 2.0, 0.5),
        seed: int | np.random.SeedSequence = 0,
        duration: float = 300.0,
        operator: TeamOperator | None = None,
        settings: TeamSettings | None = None,
        trial: TeamTrial | None = None,
        performance: str | Callable = "motion",
        trust: TrustDynamics | TrustInLoop | None = None,
    ):
        self.seed = seed
        self.duration = duration
        policy, self._measure = policy_named(policy), measure_named(performance)
        self._operator = _settings_of("operator", operator, TeamOperator)
        self._settings = _settings_of("settings", settings, TeamSettings)
        self._trial = _settings_of("trial", trial, TeamTrial)
        self.robots, self._graphs = graphs_in_time(graph, self._trial.require_connected)
        self._goal = finite_array("goal", goal, length=3)
        streams = [np.random.default_rng(child) for child in spawned(seed, 4)]
        count = _samples(duration, self._trial, len(self.robots))
        self._begin(count, streams[0])
        models = self._settings.per_robot("human_to_robot", len(self.robots))
        self._decay = np.array([model.decay(max(DECISION, self._T)) for model in models])
        self._gain = np.array([model.b / model.a for model in models])
        self._low = np.array([model.t_min for model in models])
        self._span = np.array([model.t_max for model in models]) - self._low
        driver = None
        if trust is not None:
            driver = of_class("trust", TrustInLoop.of(trust), TrustInLoop, "see trust.MODELS")
        self._courses = _courses(driver, len(self.robots), max(DECISION, self._T))
        self._share = np.full(len(self.robots), driver.start if driver else 0.5)
        self._title_of_trust = driver.model.name if driver else "(4.1)"
        plan = _plan(
            self._graphs,
            self._settings,
            len(self.robots),
            duration,
            count,
            self._T,
            streams[1],
            driver,
        )
        known = self._measure is None
        if not known:
            plan.trust[:] = np.nan
            plan.trust[0] = self._trust_of(self._share)
        self._plan = plan
        self._faults = _faults(
            self._settings.per_robot("robots", len(self.robots)), plan, streams[3]
        )
        self._leading = Leading(
            policy, self._graphs, self.robots, plan, self._times["min_dwell"], streams[2], known
        )
        # decisions that depend on what happens are taken one by one, others at a stretch
        self._careful = not known or self._leading.live or self._faults is not None
        self._reserve(count)

    def _begin(self, count: int, rng) -> None:
        """Set numbers, ends and memory."""
        settings, trial = self._settings, self._trial
        size = len(self.robots)
        self._T = T = trial.sample_time
        ends, channel = settings.per_robot("scattering", size), settings.channel
        rate = max(end.max_delay_rate for end in ends)
        delays = delays_in_samples(channel.delays, rate, channel.read_out, count, T)
        self._times = times = _times(settings, float(delays.max() * T), T)
        start, inner, pushed = _start(trial, size, count, rng)
        distance, operator = start - self._goal, self._operator
        budget = operator.budget * (1.0 + 0.5 * float(np.sum(distance**2) + np.sum(inner**2)))
        self._title, filtering = _filters(channel, float(np.mean([end.b for end in ends])))
        self._numbers = filled(
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
        self._ends = _robots(settings, ends, T)
        self._memory = _memory(delays, pushed, distance, inner)

    @property
    def t(self) -> float:
        """Time that has been simulated [s]."""
        return self._done * self._T

    @property
    def leader(self) -> Hashable:
        """Name of the robot that leads; None before the first sample."""
        return None if self._leading.leader is None else self.robots[self._leading.leader]

    @property
    def trust(self) -> np.ndarray:
        """Human-to-robot trust (4.1) in every robot at the last decision, shape (N,)."""
        return self._plan.trust[self._plan.decision[max(self._done - 1, 0)]].copy()

    @property
    def positions(self) -> np.ndarray:
        """Where the robots are [m], shape (N, 3); NaN where they are not in the team."""
        if self._formation is None:
            return self._memory.w.T + self._goal
        return np.where(self._graph.present[:, None], self._read("positions"), np.nan)

    def arrays(self) -> dict[str, np.ndarray]:
        """
        Return the arrays of a run that has not begun, by name: a program in another language steps
        them. `draws` and `drift` are what is drawn of packets and of robots' drift; `low` and what
        follows belong to trust in robots.
        """
        if self._formation is None:
            self._regroup(self._graphs[0], 0)
        size, plan = len(self.robots), self._plan
        arrays: dict[str, Any] = {
            "numbers": self._numbers,
            "ends": self._ends,
            "states": self._states,
            "low": self._low,
            "span": self._span,
            "share": self._share,
            "decay": self._decay,
            "gain": self._gain,
            "draws": np.zeros((2, len(plan.decision))),
            "drift": np.zeros((len(plan.graph), 3, size)),
        }
        arrays |= self._memory._asdict()
        for name in ("values", "vectors", "into", "solve", "stiffness"):
            arrays[name] = getattr(self._formation, name)
        if self._faults is not None:
            arrays["draws"] = self._faults.draws
            arrays["drift"][:, :, self._faults.drifting] = self._faults.drift
        return arrays

    def step(self, hand=None, leader: Hashable = None, samples: int = 1) -> View:
        """
        Advance one sample, or several under one hand, and return the state.

        Parameters
        ----------
        hand : array_like, shape (3,), optional
            Where a live hand pulls the device to [m], with the operator's `grip` and at most with
            the force `reach`; the simulated operator's hand when not given.
        leader : optional
            Name of the robot that leads from the next decision on in which the present leader has
            led for τ_min, until another is named or it leaves the team; the policy's when none was
            named.
        samples : int
            How many samples the hand stays there; many at once take less time than one by one.

        Returns
        -------
        View
            `state`, the same object in every step. `state.copy()` stays as it is.

        Raises
        ------
        ValueError
            If the loop is at its end, `hand` is not finite, or the robot cannot lead.
        DivergenceError
            If the run grows without bound.
        """
        stop = self._done + whole_number("samples", samples)
        if stop > len(self._plan.decision):
            raise ValueError(
                f"the loop ends at t = {self.t:g} s; make it with a longer duration than "
                f"{self.duration:g} s"
            )
        if hand is not None:
            place = np.clip(finite_array("hand", hand, length=3), -FARTHEST_HAND, FARTHEST_HAND)
            self._memory.samples["hand"][self._done : stop] = place
        if leader is not None:
            self._leading.name(leader, self._plan.decision[self._done])
        self._advance(stop)
        return self.state

    def run(self, until: float | None = None) -> TeamRun:
        """
        Advance until a time and return the run so far.

        Parameters
        ----------
        until : float, optional
            The time [s], counted from the start; the loop's whole duration when not given.

        Returns
        -------
        TeamRun
            Up to the duration as of `simulate_team`, bit for bit.

        Raises
        ------
        ValueError
            If the loop is already beyond that time, or does not last so long.
        DivergenceError
            If the run grows without bound.
        """
        most = len(self._plan.decision)
        stop = most if until is None else round(finite_number("until", until) / self._T)
        if not max(self._done, 1) <= stop <= most:
            raise ValueError(
                f"until must lie between t = {self.t:g} s, where the loop is, and its duration "
                f"of {self.duration:g} s, got {until}"
            )
        self._advance(stop)
        return self._result()

    def _reserve(self, count: int) -> None:
        """Make room for the log."""
        self._every = self._trial.samples_per_row
        rows = -(-count // self._every)
        self._table, self._log = log_of(kernel.LOG, rows)
        self._coordinates = np.empty((rows, 3, len(self.robots)))
        self._states = np.zeros(1, kernel.STATE)
        self._row = self._states.view(float)[: self._table.shape[1]]
        self.state = View(self._states, kernel.LOG)
        self._done = self._decided = 0
        self._formation: Any = None
        self._graph: Any = None
        self._failure: DivergenceError | None = None
        self._before: Any = None
        self._moves: dict[str, np.ndarray] | None = None
        robots = self._settings.per_robot("robots", len(self.robots))
        self._speeds = np.array([robot.speed for robot in robots])
        self._formations: list[tuple[int, kernel.Formation, TeamGraph]] = []
        plan = self._plan
        stops = np.diff(plan.decision if self._careful else plan.graph[plan.decision])
        stops = np.flatnonzero(stops) + 1
        if self._measure is not None:
            stops = np.union1d(stops, stops - 1)  # the last sample shows how robots move
        self._stops = np.append(stops[stops > 0], count)

    def _advance(self, stop: int) -> None:
        """Do the samples before `stop`, from pause to pause."""
        if self._failure is not None:
            raise self._failure
        while self._done < stop:
            first = self._done
            self._prepare(first, stop)
            last = min(stop, int(self._stops[np.searchsorted(self._stops, first, side="right")]))
            self._done, block = kernel.run_team(
                self._numbers,
                self._formation,
                self._ends,
                self._memory,
                first,
                last,
                self._every,
                self._states,
                self._row,
                self._table,
                self._coordinates,
            )
            if block >= 0:
                self._failure = DivergenceError(
                    f"the team diverged at t = {(self._done - 1) * self._T:g} s in the "
                    f"{kernel.BLOCKS[block]}; push less, switch the scattering with the leader, "
                    "or use a filter that is passive"
                )
                raise self._failure

    def _prepare(self, k: int, stop: int) -> None:
        """Do what has to be done before sample `k`: judge, regroup, choose who leads."""
        decisions, d = self._plan.decision, int(self._plan.decision[k])
        begins = k == 0 or decisions[k - 1] != d
        if begins:
            if self._measure is not None and d > 0:
                self._judge(d, k)
            graph = self._graphs[self._plan.graph[d]]
            if graph is not self._graph:
                self._regroup(graph, k)
        last = d if self._careful else int(decisions[stop - 1])
        if self._decided <= last:
            self._decide(self._decided, last)
        if self._measure is not None and (k + 1 == len(decisions) or decisions[k + 1] != d):
            self._before = self._memory.w.copy(), self._memory.z.copy()

    def _decide(self, first: int, last: int) -> None:
        """Choose who leads from decision `first` to `last`, and what its robots' faults do."""
        plan, memory = self._plan, self._memory
        since = np.searchsorted(plan.decision, first)
        until = np.searchsorted(plan.decision, last, side="right")
        where = partial(self._read, "positions")
        leaders = [self._leading.choose(d, d * plan.step, where) for d in range(first, last + 1)]
        leads = memory.samples["lead"]
        leads[since:until] = np.array(leaders)[plan.decision[since:until] - first]
        switched = self._settings.channel.switch_scattering
        memory.samples["head"][since:until] = leads[since:until] if switched else leads[0]
        self._decided = last + 1
        if self._faults is not None:
            faults = self._faults
            arrives = faults.draws[:, since:until] >= faults.loss[leads[since:until]]
            memory.arrives[:, since:until] = arrives
            if faults.drifting.size:
                into = self._formation.into[faults.drifting]
                memory.blown[:] = multiplied(faults.drift[first], into)

    def _judge(self, d: int, k: int) -> None:
        """Step trust, (4.1) or a model's, by the performance that is measured at decision `d`."""
        plan, samples = self._plan, self._memory.samples
        self._moves = None
        since = np.searchsorted(plan.decision, plan.decision[k - 1])
        now = Motion(
            d * plan.step,
            int(samples["lead"][k - 1]),
            self._graph.present,
            self._graph.adjacency,
            self._settings.lead_gain * samples["sent"][k - 1],
            float(self._memory.arrives[0, since:k].mean()),
            self._read,
        )
        performance = measured(self._measure, now)
        if self._courses:
            judged = zip(self._courses, performance, strict=True)
            self._share = np.array([course.step(value) for course, value in judged])
        else:
            # (4.1); trust stays where there is nothing to judge by
            later = trust_step.py_func(self._share, performance, self._decay, self._gain)
            self._share = np.where(np.isnan(performance), self._share, later)
        plan.trust[d] = self._trust_of(self._share)

    def _trust_of(self, share: np.ndarray) -> np.ndarray:
        """Return trust from shares of its range."""
        return self._low + self._span * share

    def _read(self, name: str = "positions") -> np.ndarray:
        """Return what is measured of the robots' motion by name, shape (N, 3)."""
        if name == "positions":
            return multiplied(self._memory.w, self._formation.vectors.T).T + self._goal
        if self._moves is None:
            self._moves = self._measured_moves()
        return self._moves[name]

    def _measured_moves(self) -> dict[str, np.ndarray]:
        """Return how robots moved in the last sample, and how (4.22) asks them to, (N, 3) each."""
        team, (w_before, z_before) = self._formation, self._before
        w, z = self._memory.w, self._memory.z
        rows = np.empty((6, w.shape[1]))
        if team.directed:
            q, zeta = 0.5 * (w + w_before), 0.5 * (z + z_before)
            rows[:3] = (w - w_before) / self._T
            rows[3:] = multiplied(zeta, team.laplacian) - multiplied(q, team.laplacian.T)
        else:
            kernel.moves_undirected(team, self._memory, w_before, z_before, self._T, rows)
        # one product for all, as matrices of large teams are slow to read
        moves = multiplied(rows, team.vectors.T)
        asked = (moves[3:] / self._speeds).T
        sample = self._memory.samples[self._done - 1]
        asked[sample["lead"]] += self._settings.lead_gain * sample["sent"]
        return {"velocities": moves[:3].T, "asked": asked}

    def _regroup(self, graph: TeamGraph, k: int) -> None:
        """
        Carry the robots over to the next graph's basis; what V_fs gains or loses by the links is
        booked as their supply.
        """
        settings, memory = self._settings, self._memory
        before = self._formation
        after = formation_on(graph, settings.coupling, 0.5 * self._T, self._speeds)
        if before is not None:
            stored, _ = kernel.storages(before, memory.w, memory.z)
        for coordinates in (memory.w, memory.z):
            places = coordinates if before is None else multiplied(coordinates, before.vectors.T)
            coordinates[:] = multiplied(places, after.into)
        if before is not None:
            gained = kernel.storages(after, memory.w, memory.z)[0] - stored
            self.state.supply_links += settings.force_gain / settings.lead_gain * gained
        self._formation, self._graph = after, graph
        self._formations.append((k, after, graph))

    def _result(self) -> TeamRun:
        """Return the run so far."""
        every, T = self._every, self._T
        plan = self._plan
        rows = -(-self._done // every)
        distances, table = self._coordinates[:rows].copy(), self._table[:rows].copy()
        ends = [first for first, _, _ in self._formations[1:]] + [self._done]
        for (first, formation, graph), last in zip(self._formations, ends, strict=True):
            recorded = slice(-(-first // every), -(-last // every))
            # one product of matrices, not one per row: NumPy takes forty times as long for these
            flat = distances[recorded].reshape(-1, len(self.robots))
            flat[:] = multiplied(flat, formation.vectors.T)
            distances[recorded, :, ~graph.present] = np.nan  # not in the team, nowhere
        table.view(kernel.LOG)[:, 0]["leader"] += self._goal
        t = pd.Index(np.round(T * every * np.arange(rows), 9), name="t")
        numbers, channel = self._numbers, self._settings.channel
        measure = self._measure
        named = getattr(measure, "__name__", repr(measure)) if callable(measure) else "random"
        facts: dict = {"policy": self._leading.policy.title, "filter": self._title}
        facts |= {name: numbers[name].item() for name in ("k12", "k21")}
        facts |= {"seed": str(self.seed), "read_out": channel.read_out} | self._times
        facts |= {name: numbers[name].item() for name in ("sample_time", "push")} | {"note": NOTE}
        facts |= {"performance": named, "waits": self._leading.waits}
        facts |= {"trust": self._title_of_trust}
        changes = self._formations[1:]
        return TeamRun(
            self.robots,
            self._graphs[0].adjacency,
            self._goal,
            pd.DataFrame(table, index=t, columns=list(kernel.COLUMNS)),
            distances.transpose(0, 2, 1) + self._goal,
            plan.trust[_intervals(t.to_numpy(), plan.step, len(plan.trust))],
            numbers["budget"].item(),
            self._trial.tolerance,
            facts,
            tuple((round(T * first, 9), graph.adjacency) for first, _, graph in changes),
        )


def _settings_of(name: str, value, kind):
    """Return settings of a class, the usual ones where there are none."""
    return kind() if value is None else of_class(name, value, kind)


class LeadSchedule(NamedTuple):
    """When who leads is decided, and what is known of the run before it begins."""

    step: float  # between decisions [s]
    decision: np.ndarray  # of each sample, shape (K,)
    graph: np.ndarray  # number of the graph at each decision, shape (M,)
    trust: np.ndarray  # human-to-robot, (4.1), at each decision, shape (M, N)


class Faults(NamedTuple):
    """
    What is drawn of robots that lose packets, uniform numbers (2, K), or drift, (M, 3, n).

    `loss`, shape (N,): probabilities. `drifting`, shape (n,): numbers of robots.
    """

    loss: np.ndarray
    draws: np.ndarray
    drifting: np.ndarray
    drift: np.ndarray


def _faults(robots: tuple, plan: LeadSchedule, rng) -> Faults | None:
    """Return what is drawn of faulty robots; None where all are faultless but for their speed."""
    loss = np.array([robot.loss for robot in robots])
    drift = np.array([robot.drift for robot in robots])
    drifting = np.flatnonzero(drift)
    if not loss.any() and not drifting.size:
        return None
    draws = rng.random((2, len(plan.decision)))
    # a first-order process of this root mean square from the start on
    noise = drift[drifting] * rng.normal(size=(len(plan.graph), 3, drifting.size))
    keep = float(np.exp(-plan.step / DRIFT_TIME))
    for d in range(1, len(noise)):
        noise[d] = keep * noise[d - 1] + np.sqrt(1.0 - keep**2) * noise[d]
    return Faults(loss, draws, drifting, noise)


def _courses(driver: TrustInLoop | None, robots: int, step: float) -> list[TrustCourse]:
    """Return the course of trust in every robot by a model; none without one."""
    return [] if driver is None else [TrustCourse(driver, step) for _ in range(robots)]


def _plan(
    graphs: list[TeamGraph], settings, robots: int, duration, count, T, rng, driver
) -> LeadSchedule:
    """Return when decisions are taken, on which graph, and the trust at each."""
    step = max(DECISION, T)
    most = int(np.ceil(duration / step)) + 1
    trust = _trust(settings, robots, most, step, rng, driver)
    since = [graph.since for graph in graphs]
    graph = np.searchsorted(since, step * np.arange(most) + 1e-9, side="right") - 1
    return LeadSchedule(step, _intervals(np.arange(count) * T, step, most), graph, trust)


def _memory(delays, pushed, distance, zeta) -> kernel.RunMemory:
    """
    Return what a run remembers, at its start; w and z are positions until the first formation gives
    them a basis.
    """
    samples, arrives = np.zeros(len(pushed), kernel.SAMPLE), np.ones((2, len(pushed)), bool)
    samples["pushed"] = pushed
    samples["hand"] = np.nan
    return kernel.RunMemory(
        samples,
        delays,
        arrives,
        accounts(),
        np.zeros((len(pushed), 3)),
        np.zeros((len(pushed), 3)),
        distance.T.copy(),
        zeta.T.copy(),
        np.zeros((3, len(distance))),
        np.full(len(distance), 0.5),
    )


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
    numbers |= {name: getattr(operator, name) for name in ("reach", "drag", "guarded", "grip")}
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


def _trust(settings: TeamSettings, size: int, count: int, step: float, rng, driver) -> np.ndarray:
    """
    Return human-to-robot trust at every decision, shape (M, N), by (4.1) or a model: performance is
    drawn anew at random times.
    """
    courses = _courses(driver, size, step)
    models = settings.per_robot("human_to_robot", size)
    trust = np.empty((count, size))
    for i, (model, stream) in enumerate(zip(models, rng.spawn(size), strict=True)):
        anew = stream.random(count) < min(step / settings.performance_time, 1.0)
        drawn = stream.random(count + 1)
        performance = drawn[np.cumsum(anew)]
        start = stream.random()
        if courses:
            steps = [courses[i].step(value) for value in performance[:-1]]
            share = np.array([driver.start, *steps])
        else:
            share = trust_run(performance[:-1], model.decay(step), model.b / model.a, start)
        trust[:, i] = model.t_min + (model.t_max - model.t_min) * share
    return trust


class Leading:
    """
    Who leads since when, as a policy says it, checked, one decision after the other.

    `known` says whether trust is known before the run, so that a policy may be asked then.
    """

    def __init__(
        self,
        policy,
        graphs: list[TeamGraph],
        names: tuple,
        plan: LeadSchedule,
        dwell,
        rng,
        known: bool,
    ):
        self.policy = policy
        self.graphs = graphs
        self.names = names
        self.plan = plan
        self.dwell = dwell
        self.rng = rng
        self.leader: int | None = None
        self.since = 0.0
        self.memory: dict = {}
        self.waits = 0  # decisions at which a wish to switch had to wait
        self._named: int | None = None
        ahead = callable(getattr(policy, "leaders", None))
        self.live = is_live(policy) and not (ahead and known)
        if self.live:
            return
        if not known and getattr(policy, "uses_trust", True):
            raise ValueError(
                f"the policy {policy.title!r} is asked before the run, when measured trust is not "
                "known: give it a method leader(now) in place of leaders(…), set uses_trust = "
                'False if it takes no trust, or pass performance="random"'
            )
        self._ahead = self._asked_ahead(known)

    def _asked_ahead(self, known: bool) -> np.ndarray:
        """Return the leader at each decision as the policy says it before the run."""
        plan = self.plan
        present = np.array([graph.present for graph in self.graphs])[plan.graph]
        trust = np.where(present, plan.trust if known else 0.5, -np.inf)
        try:
            leaders = self.policy.leaders(trust, self.names, plan.step, self.dwell, self.rng)
        except Exception as error:
            raise self._raised(error) from error
        return robot_numbers(
            "the policy's answer, one leader per decision,", leaders, len(trust), len(self.names)
        )

    def name(self, robot: Hashable, d: int) -> None:
        """Let the operator name who leads, in place of the policy."""
        graph = self.graphs[self.plan.graph[d]]
        able = [self.names[i] for i in np.flatnonzero(graph.present & graph.may_lead)]
        if robot not in able:
            raise ValueError(f"leader must be one of {able}, got {robot!r}")
        self._named = self.names.index(robot)

    def choose(self, d: int, t: float, where: Callable) -> int:
        """Return the leader from decision number `d` on."""
        graph = self.graphs[self.plan.graph[d]]
        able = graph.present & graph.may_lead
        if self._named is not None and not able[self._named]:
            self._named = None
        if self._named is not None:
            number = self._named
        else:
            number = self._asked(d, t, graph, where) if self.live else int(self._ahead[d])
        picks = f"at t = {t:g} s the policy picks robot {self.names[number]!r}, which"
        if not graph.present[number]:
            raise ValueError(f"{picks} is not in the team then")
        if not graph.may_lead[number]:
            raise ValueError(
                f"{picks} not all others see, directly or through others, so that it cannot lead "
                f"them; who can: {[self.names[i] for i in np.flatnonzero(graph.may_lead)]}"
            )
        if number == self.leader:
            return number
        if self.leader is not None and able[self.leader] and t - self.since < self.dwell - 1e-6:
            self.waits += 1
            return self.leader
        self.leader, self.since = number, t
        return number

    def _asked(self, d: int, t: float, graph: TeamGraph, where: Callable) -> int:
        """Return whom a live policy picks."""
        trust = np.where(graph.present, self.plan.trust[d], -np.inf)
        now = TeamSituation(
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
        name = f"the policy's answer at t = {t:g} s"
        return robot_numbers(name, [answer], 1, len(self.names)).item()

    def _raised(self, error: Exception, when: str = "") -> PartError:
        """Return the error of a policy that raised one."""
        raised = f"raised {type(error).__name__}: {error}"
        return PartError(f"the leader policy {self.policy.title!r} {raised}{when}")


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
