"""The team of robots as a testbed, whose conditions are leader policies."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import Checked, Positive, Seed, list_of, spawned
from trustlab.operators.ground_robot import checked_assumptions
from trustlab.teleoperation.team.decisions import POLICIES, policy_named
from trustlab.teleoperation.team.graphs import graphs_in_time
from trustlab.teleoperation.team.settings import TeamOperator, TeamRobot, TeamSettings, TeamTrial
from trustlab.testbeds.deciding import checked_rules
from trustlab.testbeds.populations import drawn_people
from trustlab.testbeds.robot_team import simulate_team
from trustlab.testbeds.team_run import TeamRun

# Mixed into the seed, so that people and their runs have different streams.
LEADERS_OF_TEAMS = 0x7465616D

# A faultless robot, a slow one, one that loses every second packet, and one that drifts.
ABILITIES = (TeamRobot(), TeamRobot(speed=0.4), TeamRobot(loss=0.5), TeamRobot(drift=0.02))

# Distance to the goal that counts as arrived [m].
ARRIVED = 0.1

# By how much, as a share, operators' hands differ from those of a `TeamOperator`.
SPREAD = 0.3
HAND = ("push", "reach", "drag")


def ring(count: int) -> np.ndarray:
    """Return the graph of a team in which each robot sees its two neighbours."""
    after = np.roll(np.eye(count), 1, axis=0)
    return np.maximum(after, after.T)


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotTeam(Checked):
    """
    The team of Chapter 4, led to a goal by one operator; conditions are leader policies.

    Hands are drawn, uniformly within 30 % of those of a `TeamOperator`; the start of the robots,
    and which of them has which fault, are drawn for each session. The numbers are plausible, not
    measured.

    Parameters
    ----------
    graph : array_like, shape (N, N), or networkx.Graph, optional
        Who sees whom; a ring of as many as `robots` when not given.
    robots : sequence of TeamRobot
        What robots make of (4.22).
    duration : float
        Length of each run [s].
    blocks : TeamSettings, optional
        Device, channel, trust and gains, without robots; gains with which such a team arrives
        within some 40 s when not given; needed for a directed graph.
    rules : mapping of str to callable, optional
        Conditions of one's own by name: what makes the policy, called for each run.

    Raises
    ------
    ValueError
        If a setting is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> study = tl.virtual_study(n=4, testbed="robot_team", conditions=["most_trusted", "sequence"])
    >>> study.analysis("time").dv
    'time'
    """

    name = "robot_team"
    title = "the team of robots"
    conditions = tuple(POLICIES)
    printed_conditions = ("most_trusted", "sequence", "random")
    printed_n = 12
    measures = ("time", "distance", "force", "trust")
    takes_rules = True
    origin = "hands within 30 % of the usual one"

    graph: Any = None
    robots: tuple[TeamRobot, ...] = ABILITIES
    duration: Positive = 120.0
    blocks: TeamSettings | None = None
    rules: Mapping[str, Callable] = field(default_factory=dict)

    def __post_init__(self):
        super().__post_init__()
        robots = tuple(list_of("robots", self.robots))
        graph = ring(len(robots)) if self.graph is None else self.graph
        conditions = checked_rules(self.rules, POLICIES)
        settings = TeamSettings.scaled(graph, 40.0) if self.blocks is None else self.blocks
        blocks = replace(settings, robots=robots)
        if settings.robots not in (TeamSettings.robots, blocks.robots):
            raise ValueError("the robots of blocks would do nothing: give robots=…")
        blocks.per_robot(len(graphs_in_time(graph, True)[0]))  # refused if they are too few
        self.__dict__.update(robots=robots, graph=graph, blocks=blocks, conditions=conditions)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of all runs, by name."""
        return {"robots": len(self.robots), "duration": self.duration}

    def people(
        self, n: int, assumptions: Mapping[str, float] | None = None, seed: int = 0
    ) -> pd.DataFrame:
        """
        Return a row per operator: participant, from 1, and the numbers of their hand.

        Parameters
        ----------
        n : int
            How many; those of a smaller n are the first of a larger one.
        assumptions : mapping of str to float, optional
            Any of push, reach and drag, for all of them.
        seed : int
            Seed of the draws.
        """
        assumed: Any = checked_assumptions(assumptions, dict.fromkeys(HAND, (0.0, 1e3)))
        TeamOperator(**assumed)  # refused now, not in every run

        def draw(number: int, rng: np.random.Generator) -> dict[str, float]:
            return {
                name: getattr(TeamOperator, name) * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD)
                for name in HAND
            }

        return drawn_people(n, seed, LEADERS_OF_TEAMS, draw).assign(**assumed)

    def rule_of(self, condition: str, person: Mapping[str, Any]) -> Any:
        """
        Return a new policy of a condition of one's own.

        Parameters
        ----------
        condition : str
            A name in `rules`.
        person : mapping
            A row of `people`; not used.

        Raises
        ------
        ValueError
            If what was made is no policy; and what making it raises.
        """
        return policy_named(self.rules[condition]())

    def run(self, condition: str, person: Mapping[str, Any], seed: Seed) -> TeamRun:
        """
        Run one session.

        Parameters
        ----------
        condition : str
            One of `conditions`.
        person : mapping
            A row of `people`.
        seed : int or numpy.random.SeedSequence
            Seed of the session.
        """
        policy = self.rule_of(condition, person) if condition in self.rules else condition
        faults, rest = spawned(seed, 2)
        order = np.random.default_rng(faults).permutation(len(self.robots))
        robots = tuple(self.robots[i] for i in order)
        return simulate_team(
            self.graph,
            policy,
            seed=rest,
            duration=self.duration,
            operator=TeamOperator(**{name: person[name] for name in HAND}),
            settings=replace(self.blocks, robots=robots),
            trial=TeamTrial(0.01, record_every=0.1, tolerance=ARRIVED),
        )

    def next_session(self, person: Mapping[str, Any], run: TeamRun) -> Mapping[str, Any]:
        """
        Return the same operator: nothing is carried from session to session.

        Parameters
        ----------
        person : mapping
            As for `run`.
        run : TeamRun
            The run.
        """
        return person
