"""
A team of robots led to a goal by one operator through whichever of them leads: Chapter 4 as a
simulated task.
"""

from collections.abc import Callable, Hashable

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
from trustlab.models.simulation import DivergenceError, PartError, Simulation, View
from trustlab.models.trust import trust_run, trust_step
from trustlab.teleoperation.delays import delays_in_samples
from trustlab.teleoperation.filters import WaveFilter, passivity_margin
from trustlab.teleoperation.ports.ledger import READ_OUTS, accounts
from trustlab.teleoperation.records import filled, robot_numbers, signal
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.graphs import TeamGraph, formation_on, graphs_in_time
from trustlab.teleoperation.team.leader_policies import (
    LeaderPolicy,
    TeamSituation,
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
    policy: str | LeaderPolicy = "most_trusted",
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
    policy : {"most_trusted", "hysteresis", "sequence", "random"} or LeaderPolicy
        Who leads; decided every 0.1 s, or every sample where samples are longer. Your own policy is
        any object with a `title` and a method `leader(now)`, called at every decision with a
        `TeamSituation` (time, trust, positions, who is present, a memory of its own), which returns
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
    policy : {"most_trusted", "hysteresis", "sequence", "random"} or LeaderPolicy
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
        self._policy, self._measure = policy_named(policy), measure_named(performance)
        self._operator = _settings_of("operator", operator, TeamOperator)
        self._settings = _settings_of("settings", settings, TeamSettings)
        self._trial = _settings_of("trial", trial, TeamTrial)
        self.robots, self._graphs = graphs_in_time(graph, self._trial.require_connected)
        self._goal = finite_array("goal", goal, length=3)
        size = len(self.robots)
        count = _samples(duration, self._trial, size)
        per_decision = max(round(DECISION / self._trial.sample_time), 1)
        self._step = per_decision * self._trial.sample_time
        begins, drawn, self._rng, faults = map(np.random.default_rng, spawned(seed, 4))
        driver = None
        if trust is not None:
            driver = of_class("trust", TrustInLoop.of(trust), TrustInLoop, "see trust.MODELS")
        decisions = int(np.ceil(duration / self._step)) + 1
        self._begin_trust(driver, decisions, drawn)
        self._begin(count, per_decision, begins, faults)
        self._leader: int | None = None
        self._named: int | None = None
        self._graph = self._graphs[0]
        self._able = _able(self._graph)
        self._since = 0.0
        self._waits = 0  # decisions at which a wish to switch had to wait
        self._memory: dict = {}

    def _begin_trust(self, driver: TrustInLoop | None, decisions: int, rng) -> None:
        """Set trust at the start, or at every decision where performance is drawn."""
        settings, size = self._settings, len(self.robots)
        models = settings.per_robot("human_to_robot", size)
        self._decay = np.array([model.decay(self._step) for model in models])
        self._gain = np.array([model.b / model.a for model in models])
        self._low = np.array([model.t_min for model in models])
        self._span = np.array([model.t_max for model in models]) - self._low
        self._courses = [TrustCourse(driver, self._step) for _ in range(size if driver else 0)]
        self._share = np.full(size, driver.start if driver else 0.5)
        self._title_of_trust = driver.model.name if driver else "(4.1)"
        self._trust = np.full((decisions, size), np.nan)
        self._trust[0] = self._low + self._span * self._share
        if self._measure is None:
            self._trust = _trust(settings, size, decisions, self._step, rng, driver)

    def _begin(self, count: int, per_decision: int, begins, faults) -> None:
        """Set the records of the simulation."""
        settings, trial = self._settings, self._trial
        size, T = len(self.robots), trial.sample_time
        ends, channel = settings.per_robot("scattering", size), settings.channel
        rate = max(end.max_delay_rate for end in ends)
        delays = delays_in_samples(channel.delays, rate, channel.read_out, count, T)
        self._times = times = _times(settings, float(delays.max() * T), T)
        start, inner, pushed = _start(trial, size, count, begins)
        distance, operator = start - self._goal, self._operator
        budget = operator.budget * (1.0 + 0.5 * float(np.sum(distance**2) + np.sum(inner**2)))
        self._title, filtering = _filters(channel, float(np.mean([end.b for end in ends])))
        robots = _robots(settings, ends, T)
        root = robots["root"][:, None]
        draws, drift = _faults(robots, settings, self._step, (count, len(self._trust)), faults)
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
            per_decision=per_decision,
            per_row=trial.samples_per_row,
            drifting=drift.any(),
        )
        speeds = robots["root"] ** 2
        formations = [
            formation_on(graph, settings.coupling, 0.5 * T, speeds) for graph in self._graphs
        ]
        matrices, stiffness = map(np.array, zip(*formations, strict=True))
        setup = kernel.TeamSetup(
            numbers=np.array([numbers]),
            robots=robots,
            formations=matrices,
            stiffness=stiffness,
            storing=np.where(
                [graph.directed for graph in self._graphs],
                np.nan,
                settings.force_gain / settings.lead_gain,
            ),
            delays=delays,
            draws=draws,
            drift=0.5 * T * drift,
        )
        state = _state(distance / root, inner / root, count)
        inputs = np.zeros(count, kernel.INPUT)
        inputs["pushed"], inputs["hand"] = pushed, np.nan
        rows = -(-count // trial.samples_per_row)
        samples = np.zeros(count, kernel.SAMPLE)
        table = np.empty((rows, len(kernel.COLUMNS)))
        log = kernel.TeamLog(samples, table, np.empty((rows, size, 3)))
        records = setup, state, inputs, log
        self.simulation = Simulation(
            kernel.lead_team, *records, self._decide, per_decision, kernel.BLOCKS, T
        )
        self.state = View(state.now)

    @property
    def t(self) -> float:
        """Time that has been simulated [s]."""
        return self.simulation.done * self._trial.sample_time

    @property
    def leader(self) -> Hashable:
        """Name of the robot that leads; None before the first sample."""
        return None if self._leader is None else self.robots[self._leader]

    @property
    def trust(self) -> np.ndarray:
        """Human-to-robot trust (4.1) in every robot at the last decision, shape (N,)."""
        run = self.simulation
        return self._trust[max(run.done - 1, 0) // run.every].copy()

    @property
    def positions(self) -> np.ndarray:
        """Where the robots are [m], shape (N, 3); NaN where they are not in the team."""
        return np.where(self._graph.present[:, None], self._read("positions"), np.nan)

    def trust_records(self) -> dict[str, np.ndarray]:
        """Return trust in every robot, its share of its range, and what changes it, by name."""
        names = ("low", "span", "decay", "gain", "share")
        return {"trust": self.trust} | {name: getattr(self, f"_{name}") for name in names}

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
        run = self.simulation
        stop = run.done + whole_number("samples", samples)
        if stop > run.inputs.size:
            raise ValueError(
                f"the loop ends at t = {self.t:g} s; make it with a longer duration than "
                f"{self.duration:g} s"
            )
        if hand is not None:
            place = np.clip(finite_array("hand", hand, length=3), -FARTHEST_HAND, FARTHEST_HAND)
            run.inputs["hand"][run.done : stop] = place
        if leader is not None:
            able = [self.robots[i] for i in np.flatnonzero(self._able)]
            if leader not in able:
                raise ValueError(f"leader must be one of {able}, got {leader!r}")
            self._named = self.robots.index(leader)
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
        run = self.simulation
        most, T = run.inputs.size, self._trial.sample_time
        stop = most if until is None else round(finite_number("until", until) / T)
        if not max(run.done, 1) <= stop <= most:
            raise ValueError(
                f"until must lie between t = {self.t:g} s, where the loop is, and its duration "
                f"of {self.duration:g} s, got {until}"
            )
        self._advance(stop)
        return self._result()

    def _advance(self, stop: int) -> None:
        """Do the samples before `stop`."""
        try:
            self.simulation.advance(stop)
        except DivergenceError as error:
            raise DivergenceError(
                f"{error}; push less, switch the scattering with the leader, or use a filter that "
                "is passive"
            ) from None

    # --- decisions --------------------------------------------------------------------------------

    def _decide(self, state: kernel.TeamState, inputs: np.ndarray) -> None:
        """Judge the robots, take the graph of the time, and choose who leads."""
        run = self.simulation
        d = run.done // run.every
        t = d * self._step
        if d > 0 and self._measure is not None:
            self._trust[d] = self._judged(t, state)
        number = sum([graph.since <= t + 1e-9 for graph in self._graphs]) - 1
        if self._graph is not self._graphs[number]:
            self._graph = self._graphs[number]
            self._able = _able(self._graph)
        lead = self._choose(t, self._trust[d])
        inputs["graph"], inputs["lead"] = number, lead
        switched = self._settings.channel.switch_scattering or d == 0
        inputs["head"] = lead if switched else run.inputs["head"][0]

    def _judged(self, t: float, state: kernel.TeamState) -> np.ndarray:
        """Return trust, by (4.1) or a model, after what is measured of performance."""
        run = self.simulation
        packets = state.arrives[0, run.done - run.every : run.done]
        command = self._settings.lead_gain * run.log.samples["sent"][run.done - 1]
        graph, received = self._graph, np.count_nonzero(packets) / packets.size
        now = Motion(t, self._leader, graph.present, graph.adjacency, command, received, self._read)
        performance = measured(self._measure, now)
        if self._courses:
            judged = zip(self._courses, performance, strict=True)
            self._share = np.array([course.step(value) for course, value in judged])
        else:
            # (4.1); trust stays where there is nothing to judge by
            later = trust_step.py_func(self._share, performance, self._decay, self._gain)
            self._share = np.where(np.isnan(performance), self._share, later)
        return self._low + self._span * self._share

    def _read(self, name: str) -> np.ndarray:
        """Return what is measured of the robots' motion by name, shape (N, 3)."""
        state = self.simulation.state
        if name == "positions":
            return state.q * self.simulation.setup.robots["root"][:, None] + self._goal
        return state.velocity if name == "velocities" else state.asked

    def _choose(self, t: float, trust: np.ndarray) -> int:
        """Return who leads: whom the operator named, or else the policy's pick, after τ_min."""
        able = self._able
        if self._named is not None and not able[self._named]:
            self._named = None
        pick = self._asked(t, trust) if self._named is None else self._named
        if not able[pick]:
            self._refuse(pick, t)
        if pick != self._leader:
            stays = self._leader is not None and able[self._leader]
            if stays and t - self._since < self._times["min_dwell"] - 1e-6:
                self._waits += 1
                return self._leader
            self._leader, self._since = pick, t
        return pick

    def _asked(self, t: float, trust: np.ndarray) -> int:
        """Return whom the policy picks."""
        now = TeamSituation(
            t=t,
            robots=self.robots,
            present=self._graph.present,
            trust=np.where(self._graph.present, trust, -np.inf),
            leader=self._leader,
            since=self._since,
            dwell=self._times["min_dwell"],
            rng=self._rng,
            memory=self._memory,
            where=lambda: self._read("positions"),
        )
        try:
            pick = self._policy.leader(now)
        except Exception as error:
            raise PartError(
                f"the leader policy {self._policy.title!r} raised {type(error).__name__}: {error}, "
                f"at t = {t:g} s"
            ) from error
        if type(pick) is int and 0 <= pick < len(self.robots):
            return pick
        name = f"the policy's answer at t = {t:g} s"
        return robot_numbers(name, [pick], 1, len(self.robots)).item()

    def _refuse(self, pick: int, t: float) -> None:
        """Raise the error of a policy that picks a robot that cannot lead."""
        picks = f"at t = {t:g} s the policy picks robot {self.robots[pick]!r}, which"
        if not self._graph.present[pick]:
            raise ValueError(f"{picks} is not in the team then")
        able = [self.robots[i] for i in np.flatnonzero(self._graph.may_lead)]
        raise ValueError(
            f"{picks} not all others see, directly or through others, so that it cannot lead "
            f"them; who can: {able}"
        )

    # --- the run ----------------------------------------------------------------------------------

    def _result(self) -> TeamRun:
        """Return the run so far."""
        run = self.simulation
        setup, inputs = run.setup, run.inputs
        (numbers,) = setup.numbers
        every, T = self._trial.samples_per_row, self._trial.sample_time
        rows = -(-run.done // every)
        table = run.log.table[:rows].copy()
        table.view(kernel.LOG)[:, 0]["leader"] += self._goal
        graph = inputs["graph"][: run.done]
        places = run.log.places[:rows] * setup.robots["root"][:, None] + self._goal
        present = np.array([each.present for each in self._graphs])[graph[::every]]
        places[~present] = np.nan  # not in the team, nowhere
        t = pd.Index(np.round(T * every * np.arange(rows), 9), name="t")
        measure = self._measure
        named = getattr(measure, "__name__", repr(measure)) if callable(measure) else "random"
        facts: dict = {"policy": self._policy.title, "filter": self._title}
        facts |= {name: numbers[name].item() for name in ("k12", "k21")}
        facts |= {"seed": str(self.seed), "read_out": self._settings.channel.read_out}
        facts |= self._times
        facts |= {name: numbers[name].item() for name in ("sample_time", "push")} | {"note": NOTE}
        facts |= {"performance": named, "waits": self._waits}
        facts |= {"trust": self._title_of_trust}
        changed = np.flatnonzero(np.diff(graph)) + 1
        return TeamRun(
            self.robots,
            self._graphs[0].adjacency,
            self._goal,
            pd.DataFrame(table, index=t, columns=list(kernel.COLUMNS)),
            places,
            self._trust[np.arange(0, run.done, every) // run.every],
            numbers["budget"].item(),
            self._trial.tolerance,
            facts,
            tuple((round(T * k, 9), self._graphs[graph[k]].adjacency) for k in changed.tolist()),
        )


def _able(graph: TeamGraph) -> np.ndarray:
    """Return which robots can lead, shape (N,)."""
    return graph.present & graph.may_lead


def _settings_of(name: str, value, kind):
    """Return settings of a class, the usual ones where there are none."""
    return kind() if value is None else of_class(name, value, kind)


def _state(q: np.ndarray, zeta: np.ndarray, count: int) -> kernel.TeamState:
    """Return what samples hand on, at the start."""
    now = np.zeros(1, kernel.STATE)
    waves, vectors = np.zeros((2, count, 3)), np.zeros((3, *q.shape))
    return kernel.TeamState(
        now=now,
        row=now.view(float)[: len(kernel.COLUMNS)],
        q=q,
        zeta=zeta,
        middle=vectors[0],
        velocity=vectors[1],
        asked=vectors[2],
        trust=np.full(len(q), 0.5),
        arrives=np.ones((2, count), bool),
        u_l=waves[0],
        u_r=waves[1],
        accounts=accounts(),
    )


def _faults(
    robots: np.ndarray, settings: TeamSettings, step: float, size: tuple[int, int], rng
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what is drawn of robots that lose packets or drift, for `size` samples and decisions:
    uniform numbers (2, K), and velocities over √s (M, N, 3).
    """
    samples, decisions = size
    draws, blown = np.ones((2, samples)), np.zeros((decisions, len(robots), 3))
    drift = np.array([robot.drift for robot in settings.per_robot("robots", len(robots))])
    drifting = np.flatnonzero(drift)
    if not robots["loss"].any() and not drifting.size:
        return draws, blown
    draws = rng.random((2, samples))
    # a first-order process of this root mean square from the start on
    noise = drift[drifting] * rng.normal(size=(decisions, 3, drifting.size))
    keep = float(np.exp(-step / DRIFT_TIME))
    for d in range(1, decisions):
        noise[d] = keep * noise[d - 1] + np.sqrt(1.0 - keep**2) * noise[d]
    blown[:, drifting] = noise.transpose(0, 2, 1) / robots["root"][drifting, None]
    return draws, blown


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
    """Return what is constant of every robot, records of ROBOT."""
    models = settings.per_robot("robot_to_human", len(ends))
    kinds = settings.per_robot("robots", len(ends))
    out = np.zeros(len(ends), kernel.ROBOT)
    out["root"] = np.sqrt([kind.speed for kind in kinds])
    out["loss"] = [kind.loss for kind in kinds]
    for name in ("b", "beta_min", "beta_max"):
        out[name] = [getattr(end, name) for end in ends]
    out["decay"] = [model.decay(T) for model in models]
    out["gain"] = [model.b / model.a for model in models]
    for name in ("t_min", "t_max"):
        out[name] = [getattr(model, name) for model in models]
    return out


def _trust(settings: TeamSettings, size: int, count: int, step: float, rng, driver) -> np.ndarray:
    """
    Return human-to-robot trust at every decision, shape (M, N), by (4.1) or a model: performance is
    drawn anew at random times.
    """
    courses = [TrustCourse(driver, step) for _ in range(size if driver else 0)]
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
