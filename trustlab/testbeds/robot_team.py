"""
A team of robots led to a goal by one operator through whichever of them leads: Chapter 4 as a
simulated task.
"""

from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    Seed,
    between,
    changes,
    finite_array,
    of_class,
    one_of,
    spawned,
    whole_number,
)
from trustlab.models.records import coloured
from trustlab.models.simulation import Loop, Simulation, View, asked, filled
from trustlab.models.trust import trust_step
from trustlab.teleoperation.delays import both_ways, delays_in_samples
from trustlab.teleoperation.filters import corrected_filter
from trustlab.teleoperation.ports import accounts, held_device
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.decisions import (
    SLACK,
    LeaderPolicy,
    TeamSituation,
    policy_named,
)
from trustlab.teleoperation.team.graphs import formation_on, graphs_in_time
from trustlab.teleoperation.team.settings import TeamOperator, TeamSettings, TeamTrial
from trustlab.testbeds.team_run import TeamRun
from trustlab.trust.driving import TrustCourse, TrustInLoop
from trustlab.trust.interface import TrustDynamics

NOTE = "simulated team and operator"
DECISION = 0.1
# How long a drifting robot's velocity takes to be forgotten [s].
DRIFT_TIME = 5.0
# A run of as many samples takes some 3 GB.
MOST_SAMPLES = 1e7
# Of the filters F1 and F2 of Fig. 4.1 [rad/s].
CUTOFF = 10.0
# Who holds the device, the blocks of Fig. 4.1 and how a run is made, where nothing else is said.
OPERATOR, SETTINGS, TRIAL = TeamOperator(), TeamSettings(), TeamTrial()


def simulate_team(
    graph,
    policy: str | LeaderPolicy = "most_trusted",
    goal=(1.0, 2.0, 0.5),
    seed: Seed = 0,
    duration: float = 300.0,
    **options: Any,
) -> TeamRun:
    """
    Simulate robots on a graph, (4.19)-(4.24), whose leader an operator steers to a goal.

    Parameters
    ----------
    graph, policy, goal, seed : as of `TeamLoop`
        Who sees whom, who leads, r_q [m], and the seed of what is drawn.
    duration : float
        Length [s].
    **options : as of `TeamLoop`
        operator, settings, trial, performance and trust.

    Returns
    -------
    TeamRun
        With `.converged`, `.time_to_goal`, `.table()`, `.positions`, `.plot()`. Labelled
        synthetic.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.
    PartError
        If a policy or a trust model fails, or a policy picks who cannot lead: which and when are
        named.
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
    return TeamLoop(graph, policy, goal, seed, duration, **options).run()


class TeamLoop(Loop):
    """
    A team and its operator (Fig. 4.1), stepped or run.

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
    policy : {"most_trusted", "hysteresis", "sequence", "random"} or LeaderPolicy
        Who leads; decided every 0.1 s, or the nearest whole number of samples. Your own policy is
        any object with a `title` and a method `leader(now)`, called at every decision with a
        `TeamSituation` (time, trust, positions, who may lead, a memory of its own), which returns
        the number of the leader. Each leads for τ_min at least, unless it leaves the team: a wish
        to switch waits until then.
    goal : array_like, shape (3,)
        r_q [m], known to the operator alone.
    seed : int or numpy.random.SeedSequence
        Streams for the start, performance at random, the policy and robots' faults are spawned from
        it.
    duration : float
        Length [s]; large teams move slowly, for one robot is driven and all are moved. A sample
        takes a time that grows as N²: four robots for a minute take some 0.05 s, a hundred 2 s.
    operator : TeamOperator, optional
        Who holds the device; TeamOperator(push=0, drag=0) leaves the team alone (Remark 13).
    settings : TeamSettings, optional
        Device, scattering, trust and gains, the channel with its delays and filters, and τ_min.
    trial : TeamTrial, optional
        Time steps, start, and what is recorded.
    performance : {"motion", "random"}
        What trust (4.1) in a robot comes from, at every decision. "motion": how well it moves as
        (4.22) asks, the leader's times the packets that arrived. "random": drawn, which says
        nothing of the robot, for tests of what holds whoever leads.
    trust : TrustDynamics or TrustInLoop, optional
        A model of `trustlab.trust` in place of (4.1), of each robot by itself, one trial a second;
        `trust.TrustInLoop` sets how long a trial is and where trust starts.

    Attributes
    ----------
    state : View
        The last sample as a row of `TeamRun.table()`: every signal and energy, by name.
    robots : tuple
        Names.
    simulation : Simulation
        The kernel with its records.

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
        policy: str | LeaderPolicy = "most_trusted",
        goal=(1.0, 2.0, 0.5),
        seed: Seed = 0,
        duration: float = 300.0,
        operator: TeamOperator = OPERATOR,
        settings: TeamSettings = SETTINGS,
        trial: TeamTrial = TRIAL,
        performance: str = "motion",
        trust: TrustDynamics | TrustInLoop | None = None,
    ):
        self.seed = seed
        self.remedy = (
            "push less, switch the scattering with the leader, or use a filter that is passive"
        )
        self._policy = policy_named(policy)
        self._performance = one_of("performance", performance, ("motion", "random"))
        self._settings = of_class("settings", settings, TeamSettings)
        self._trial = of_class("trial", trial, TeamTrial)
        self._operator = of_class("operator", operator, TeamOperator)
        driver = TrustInLoop.of(trust)
        if driver is not None:
            of_class("trust", driver, TrustInLoop, "see trust.MODELS")
        self.robots, self._graphs = graphs_in_time(graph, trial.require_connected)
        self._goal = finite_array("goal", goal, length=3)
        begins, drawn, rng, *faults = map(np.random.default_rng, spawned(seed, 5))
        T = trial.sample_time
        self.count = round(between("duration", duration, 10.0 * T, MOST_SAMPLES * T) / T)
        per_decision = max(round(DECISION / T), 1)
        self._step = per_decision * T
        self._decisions = int(np.ceil(duration / self._step)) + 1
        self.simulation = self._begin(per_decision, begins, *faults)
        self.state = View(self.simulation.state.shown)
        # Human-to-robot trust, as a share of its range.
        self._share = np.full(len(self.robots), driver.start if driver else 0.5)
        self._courses = [TrustCourse(driver, self._step) for _ in self.robots] if driver else []
        self._trust_title = driver.model.name if driver else "(4.1)"
        if performance == "random":
            rate = min(self._step / settings.performance_time, 1.0)
            self._drawn, start = _drawn(self._decisions, len(self.robots), rate, drawn)
            if driver is None:
                self._share = start
        first = [np.ceil((graph.since - SLACK) / self._step) for graph in self._graphs]
        decides = np.diff(first, append=np.ceil(self.count / per_decision))
        if decides.min() <= 0.0:
            idle = self._graphs[decides.argmin()].since
            raise ValueError(
                f"the graph from t = {idle:g} s on would do nothing in a run of {duration:g} s "
                f"with a decision every {self._step:g} s"
            )
        self._graph = self._graphs[0]
        self._levels: list[np.ndarray] = []  # of trust, at every decision
        self._named: int | None = None
        self._now = TeamSituation(
            t=0.0,
            robots=self.robots,
            present=self._graph.present,
            may_lead=self._graph.may_lead,
            trust=self._share,
            leader=None,
            since=0.0,
            dwell=self._dwell,
            rng=rng,
            memory={},
            loop=self,
        )

    def _begin(self, per_decision: int, begins, losses, drifts) -> Simulation:
        """Return the simulation at its start."""
        settings, trial = self._settings, self._trial
        count = self.count
        channel, T = settings.channel, trial.sample_time
        members = settings.per_robot(len(self.robots))
        robots, ends = self._constants(members), [end for _, end in members]
        root, rate = robots["root"][:, None], max(end.max_delay_rate for end in ends)
        delays = delays_in_samples(both_ways(channel.delay), rate, count, T)
        self._delay = delay = float(delays.max() * T)
        self._dwell = max(5.0 * delay, 5.0) if settings.min_dwell is None else settings.min_dwell
        if not self._dwell > delay:
            raise ValueError(
                f"min_dwell = {self._dwell:g} s must be greater than the delay, {delay:g} s: waves "
                "of one leader would arrive at the one after the next (Section 4.2 asks for "
                "τ_min ≫ T)"
            )
        shape = robots.size, 3
        start = begins.uniform(-5.0, 5.0, shape)
        if trial.start is not None:
            start = trial.start
        if start.shape != shape:
            raise ValueError(f"start must have shape {shape}, got {start.shape}")
        distance = start - self._goal
        draws = losses.random((count, 2)).T  # by these numbers packets are lost
        noise = coloured(self._decisions, 3 * robots.size, DRIFT_TIME, self._step, drifts)
        velocity = noise.reshape(-1, *shape) * robots["drift"][:, None]
        drift = 0.5 * T * velocity / root
        numbers = self._numbers(ends, distance, root, drift.any(), per_decision)
        formations = [
            formation_on(graph, settings.coupling, 0.5 * T, root[:, 0]) for graph in self._graphs
        ]
        matrices, stiffness = map(np.array, zip(*formations, strict=True))
        directed = [(graph.adjacency != graph.adjacency.T).any() for graph in self._graphs]
        storing = np.where(directed, np.nan, settings.force_gain / settings.lead_gain)
        setup = kernel.TeamSetup(
            np.atleast_1d(numbers), robots, matrices, stiffness, storing, delays, draws, drift
        )
        inputs = np.zeros(count, kernel.INPUT)
        inputs["hand"] = np.nan
        rows = -(-count // trial.samples_per_row)
        log = kernel.TeamLog(
            np.zeros(count, kernel.SAMPLE), np.empty(rows, kernel.STATE), np.empty((rows, *shape))
        )
        middle, zeta = np.zeros((2, *shape))
        rated, level = np.zeros(robots.size), np.full(robots.size, 0.5)
        waves = np.ones((2, count), bool), *np.zeros((2, count, 3)), accounts()
        now, shown = np.zeros((2, 1), kernel.STATE)
        state = kernel.TeamState(now, shown, distance / root, zeta, middle, rated, level, *waves)
        records = setup, state, inputs, log
        return Simulation(kernel.lead_team, *records, self._decide, per_decision, kernel.BLOCKS, T)

    def _numbers(self, ends: list, distance, root, drifting: bool, per_decision: int) -> np.void:
        """Return the constants of operator and channel, a record of NUMBERS."""
        settings, trial, operator = self._settings, self._trial, self._operator
        T, filters = trial.sample_time, settings.channel.filters
        stored = 0.5 * float(np.sum((distance / root) ** 2)) / min(settings.lead_gain, 1.0)
        budget = operator.budget * (1.0 + stored)
        corrected = corrected_filter(CUTOFF, float(np.mean([end.b for end in ends])))
        pole = 0.5 * T * CUTOFF
        low_pass = filled(
            kernel.LOW_PASS,
            corrected if filters == "corrected" else None,
            decay=1.0 / (1.0 + pole),
            gate=pole / (1.0 + pole),
        )
        return filled(
            kernel.NUMBERS,
            settings,
            trial,
            operator,
            device=held_device(settings, T),
            filters=kernel.UNFILTERED if filters in ("none", "waves") else low_pass,
            low_pass=low_pass,
            filtering=filters == "waves",
            cutoff=CUTOFF,
            goal=self._goal,
            push=operator.stiffness(self._delay),
            budget=budget,
            reserve=operator.reserve * budget,
            vision=round(self._delay / T),
            error_range=max(np.linalg.norm(distance, axis=1).max(), trial.tolerance),
            per_decision=per_decision,
            per_row=trial.samples_per_row,
            drifting=drifting,
            switching=settings.channel.switch_scattering,
        )

    def _constants(self, members: list) -> np.ndarray:
        """Return what is constant of every robot, records of ROBOT."""
        T, settings = self._trial.sample_time, self._settings
        rh = settings.robot_to_human
        robots = [
            filled(
                kernel.ROBOT,
                robot,
                end,
                rh,
                root=np.sqrt(robot.speed),
                near=end.at_operator,
                far=end.at_robot,
                decay=rh.decay(T),
                gain=rh.b / rh.a,
            )
            for robot, end in members
        ]
        return np.array(robots)

    @property
    def leader(self) -> Hashable:
        """Name of the robot that leads; None before the first sample."""
        leader = self._now.leader
        return None if leader is None else self.robots[leader]

    @property
    def trust(self) -> np.ndarray:
        """Human-to-robot trust (4.1) in every robot at the last decision, shape (N,)."""
        model = self._settings.human_to_robot
        return model.t_min + (model.t_max - model.t_min) * self._share

    @property
    def positions(self) -> np.ndarray:
        """Where the robots are [m], shape (N, 3); NaN where they are not in the team."""
        return self._placed(self.simulation.state.q, self._graph.present)

    def _placed(self, q: np.ndarray, present: np.ndarray) -> np.ndarray:
        """Return places [m] from distances to the goal over √s; NaN where nobody is present."""
        places = q * self.simulation.setup.robots["root"][:, None] + self._goal
        return np.where(present[..., None], places, np.nan)

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
        able = self._able()
        if not isinstance(leader, Hashable) or leader not in (None, *able):
            raise ValueError(f"leader must be one of {able}, got {leader!r}")
        stop = self._held(whole_number("samples", samples), hand)
        if leader is not None:
            self._named = self.robots.index(leader)
        self._advance(stop)
        return self.state

    # --- decisions --------------------------------------------------------------------------------

    def _decide(self, state: kernel.TeamState, inputs: np.ndarray) -> None:
        """Judge the robots, take the graph of the time, and choose who leads."""
        run = self.simulation
        decision = run.done // run.every
        t = decision * self._step
        if decision == len(self._levels):  # else done before an interruption
            if decision > 0:
                drawn = self._performance == "random"
                performance = self._drawn[decision - 1] if drawn else self._rated(state)
                asked(f"the trust model, at t = {t:g} s", self._judge, performance)
            self._levels.append(self.trust)
        number = sum([graph.since <= t + SLACK for graph in self._graphs]) - 1
        self._graph = self._graphs[number]
        inputs["graph"], inputs["lead"] = number, self._choose(t)

    def _rated(self, state: kernel.TeamState) -> np.ndarray:
        """
        Return how well robots moved; the leader's counts times the share of the packets that it
        received, where it rests the share alone. NaN where there is nothing to judge by.
        """
        run, leader = self.simulation, self._now.leader
        packets = state.arrives[0, run.done - run.every : run.done]
        received, rated = packets.mean(), state.rated.copy()
        rated[leader] = received * (1.0 if np.isnan(rated[leader]) else rated[leader])
        return np.where(self._graph.present, rated, np.nan)

    def _judge(self, performance: np.ndarray) -> None:
        """Step trust in every robot; it stays where none was judged."""
        if self._courses:
            judged = zip(self._courses, performance, strict=True)
            self._share = np.array([course.step(value) for course, value in judged])
        else:
            model = self._settings.human_to_robot
            rates = model.decay(self._step), model.b / model.a
            after = trust_step.py_func(self._share, performance, *rates)  # (4.1)
            self._share = np.where(np.isnan(performance), self._share, after)

    def _able(self) -> list:
        """Return the names of the robots that can lead."""
        return [self.robots[i] for i in np.flatnonzero(self._graph.may_lead)]

    def _choose(self, t: float) -> int:
        """Return who leads: whom the operator named, or else the policy's pick, after τ_min."""
        graph = self._graph
        able = graph.may_lead
        trust = np.where(able, self.trust, -np.inf)
        # A new one at each decision: a policy may keep those before.
        self._now = now = replace(self._now, t=t, present=graph.present, may_lead=able, trust=trust)
        if self._named is not None and not able[self._named]:
            self._named = None
        pick = self._named
        if pick is None:
            where = f"the leader policy {self._policy.title!r}, at t = {t:g} s"
            pick = asked(where, self._picked, now)
        if pick != now.leader and now.free:
            now.leader, now.since = pick, t
        return now.leader

    def _picked(self, now: TeamSituation) -> int:
        """Return whom the policy picks, who can lead."""
        pick = self._policy.leader(now)
        pick = whole_number("the number of a robot", pick, 0, len(self.robots) - 1)
        if not now.may_lead[pick]:
            raise ValueError(
                f"robot {self.robots[pick]!r} is not in the team then, or not all others see it, "
                f"directly or through others, so that it cannot lead; who can: {self._able()}"
            )
        return pick

    # --- the run ----------------------------------------------------------------------------------

    def so_far(self) -> TeamRun:
        """Return the run so far."""
        run, T = self.simulation, self._trial.sample_time
        rows = np.arange(0, self._done, self._trial.samples_per_row)
        graphs = run.inputs["graph"][rows]
        states = run.log.table[: rows.size].view(float).reshape(rows.size, -1)
        t = pd.Index(np.round(T * rows, 9), name="t")
        present = np.array([graph.present for graph in self._graphs])[graphs]
        facts = {
            "policy": self._policy.title,
            "filter": self._settings.channel.filters,
            "seed": str(self.seed),
            "delay": self._delay,
            "min_dwell": self._dwell,
            "note": NOTE,
            "performance": self._performance,
            "trust": self._trust_title,
            "operator": changes(self._operator, OPERATOR),
            "settings": changes(self._settings, SETTINGS),
            "trial": changes(self._trial, TRIAL),
        }
        return TeamRun(
            self.robots,
            self._goal,
            pd.DataFrame(states[:, : len(kernel.COLUMNS)].copy(), t, list(kernel.COLUMNS)),
            self._placed(run.log.places[: rows.size], present),
            np.array(self._levels)[rows // run.every],
            np.round(T * (np.flatnonzero(np.diff(run.inputs["lead"][: run.done])) + 1), 9),
            run.setup.numbers["budget"].item(),
            self._trial.tolerance,
            facts,
        )


def _drawn(decisions: int, robots: int, rate: float, rng) -> tuple[np.ndarray, np.ndarray]:
    """
    Return performance at random, shape (M, N), drawn anew at this rate per decision, and where
    trust starts, shape (N,).
    """
    performance, start = np.empty((decisions, robots)), np.empty(robots)
    for robot, stream in enumerate(rng.spawn(robots)):
        draws = stream.random((decisions + 1, 2))
        performance[:, robot] = draws[np.cumsum(draws[1:, 0] < rate), 1]
        start[robot] = draws[0, 0]
    return performance, start
