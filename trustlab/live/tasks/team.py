"""A team as a live task: one person leads it to goals through whichever robot leads."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
import pandas as pd

from trustlab.live.hands import ScriptedLeader
from trustlab.live.task import (
    PERIOD,
    HandSettings,
    LiveTask,
    force_shown,
    hand_config,
    trust_of,
)
from trustlab.models.checks import Positive, whole_number
from trustlab.sessions.session import Session
from trustlab.teleoperation.team.decisions import POLICIES, LeaderPolicy, TeamSituation
from trustlab.teleoperation.team.settings import (
    TeamOperator,
    TeamRobot,
    TeamSettings,
    TeamTrial,
)
from trustlab.testbeds.condition_run import suggestions_followed
from trustlab.testbeds.robot_team import TeamLoop
from trustlab.testbeds.team_testbed import ring

BY_HAND, SUGGESTED = "by_hand", "suggested"
ADVISERS: dict = {name: POLICIES[name] for name in ("most_trusted", "hysteresis")}
"""Policies whose picks are logged, in every condition."""

COMMANDS = ("pointer_x", "pointer_y", "leader_choice")
COLUMNS = (
    *COMMANDS,
    *(f"{name}_{axis}" for name in ("robot", "team", "reference", "f_m") for axis in "xy"),
    "path_error",
    "leader",
    "leader_suggested",
    "leader_most_trusted",
    "leader_hysteresis",
    "may_switch",
    "goals_reached",
)

ABILITIES = (
    TeamRobot(),
    TeamRobot(speed=0.4),
    TeamRobot(loss=0.5),
    TeamRobot(drift=0.05),
    TeamRobot(speed=0.7),
    TeamRobot(loss=0.25),
)
"""How well robots do what they should; who has which is drawn for each run."""

SAMPLE_TIME = 0.01
PULL = 0.12
"""Where a hand at the edge of its square wants the device to be [m]."""

GAINS = ("coupling", "lead_gain", "force_gain")
WITHIN = 40.0
"""
Gains that depend on the team's size, and the time in which they let a leader that is held at a goal
draw the others there [s].
"""

FIELD = 4.0
NEAREST = 3.0
START = 1.0
"""Goals lie within ± FIELD, at least NEAREST from the one before; robots begin within START [m]."""


@dataclass(frozen=True, kw_only=True)
class LeadingSettings(HandSettings):
    """
    The runs of a live study of a team.

    Parameters
    ----------
    robots : int
        How many robots, on a ring, 3 to 6.
    goals : int
        How many goals the team is led to, one after the other.
    duration : float
        When a run ends at the latest [s].
    training : float
        The same for the training run, in which people choose the leader by hand [s].
    min_dwell : float
        τ_min, how long a leader leads at the least [s].
    tolerance : float
        How near to a goal all robots must be [m].
    least_delay : float
        How late pictures are shown at least [s], so that connections make no difference among
        people; the camera's delay counts where it is longer.
    trust : TrustDynamics or TrustInLoop, optional
        One of `trustlab.trust.MODELS` in place of (4.1).

    Raises
    ------
    ValueError
        If a value is not understood.

    Examples
    --------
    >>> from trustlab.live import LeadingSettings
    >>> LeadingSettings(robots=5).as_json()["robots"]
    5
    """

    robots: int = 4
    goals: int = 3
    min_dwell: Annotated[float, (1.0, 60.0)] = 5.0
    tolerance: Positive = 0.4

    def __post_init__(self):
        super().__post_init__()
        self.__dict__["robots"] = whole_number("robots", self.robots, least=3, most=6)
        self.__dict__["goals"] = whole_number("goals", self.goals, most=20)


class PersonLeads:
    """
    A leader policy that asks a person, or a policy in the person's place; what the policies would
    pick is kept for the log.
    """

    def __init__(self, condition: str, policy: LeaderPolicy | None = None):
        self.condition, self.policy = condition, policy
        self.title = policy.title if policy else "a person"
        self.wish = 0
        self.picks = dict.fromkeys(ADVISERS, 1)
        self.free = False
        self.left = 0.0

    def leader(self, now: TeamSituation) -> int:
        """Return the number of the robot that leads from now on."""
        self.picks = {name: policy.leader(now) + 1 for name, policy in ADVISERS.items()}
        self.free = now.free
        self.left = max(now.dwell - (now.t - now.since), 0.0)
        if self.policy is not None:
            return self.policy.leader(now)
        if self.condition in ADVISERS:
            return self.picks[self.condition] - 1
        return self.wish - 1 if self.wish else now.leader or 0

    def suggestion(self, leader: int) -> int:
        """Return the number of the robot suggested as leader, 0 for none."""
        pick = self.picks["hysteresis"]
        return pick if self.condition == SUGGESTED and self.free and pick != leader else 0


class LeadingRun:
    """A team, stepped by the place of a hand in its square and the robot that is to lead."""

    def __init__(self, config: dict, policy: LeaderPolicy | None = None):
        robots = tuple(TeamRobot(**robot) for robot in config["robots"])
        settings = TeamSettings(robots=robots, min_dwell=config["min_dwell"], **config["gains"])
        self.config, self.goals = config, config["goals"]
        self.policy = PersonLeads(config["condition"], policy)
        self.loop = TeamLoop(
            ring(len(robots)),
            self.policy,
            (*self.goals[-1], 0.0),
            config["seed"],
            (config["samples"] + 1) * PERIOD,
            TeamOperator(guarded=False),
            settings,
            TeamTrial(SAMPLE_TIME, start=np.array(config["start"])),
            trust=trust_of(config),
        )
        self.periods = self.reached = self.leader = 0

    @property
    def done(self) -> bool:
        """Whether all goals were reached, or time is over."""
        return self.reached == len(self.goals) or self.periods >= self.config["samples"]

    @property
    def goal(self) -> list[float]:
        """The goal now; the last one at the end."""
        return self.goals[min(self.reached, len(self.goals) - 1)]

    def step(self, *command: float) -> list[float]:
        """Lead for one period."""
        x, y, choice = command
        self.policy.wish = int(choice)
        state = self.loop.step((PULL * x, PULL * y, 0.0), samples=round(PERIOD / SAMPLE_TIME))
        self.periods += 1
        self.leader = self.loop.robots.index(self.loop.leader) + 1
        places, goal = self.loop.positions[:, :2], self.goal
        error = float(np.hypot(*(places - goal).T).max())
        self.reached += error <= self.config["tolerance"]
        vectors = (places[self.leader - 1], places.mean(axis=0), goal, state.f_m[:2])
        return [
            *command,
            *np.concatenate(vectors).tolist(),
            error,
            self.leader,
            self.policy.suggestion(self.leader),
            *self.policy.picks.values(),
            float(self.policy.free),
            self.reached,
            *self.loop.trust.tolist(),
        ]

    def picture(self) -> dict:
        """Return what the page draws."""
        start = np.array(self.config["start"])
        return {
            "robots": (self.loop.positions if self.periods else start)[:, :2].tolist(),
            "trust": self.loop.trust.tolist(),
            "leader": self.leader,
            "suggested": self.policy.suggestion(self.leader),
            "wait": self.policy.left,
            "goal": self.goal,
            "reached": self.reached,
            "force": (-self.loop.state.f_m[:2]).tolist(),
        }


def team_config(content: dict, condition: str, seed: int, known: dict | None = None) -> dict:
    """Return the settings of a run; start, goals and abilities are drawn from its seed."""
    rng = np.random.default_rng(seed)
    count = content["robots"]
    scaled = TeamSettings.scaled(ring(count), WITHIN)
    start = np.zeros((count, 3))
    start[:, :2] = rng.uniform(-START, START, (count, 2))
    abilities = [ABILITIES[i] for i in rng.permutation(count)]
    return hand_config(
        content,
        condition,
        seed,
        [0, count],
        live_task="team",
        chooses=condition in ("training", BY_HAND, SUGGESTED),
        start=start.tolist(),
        goals=_goals(content["goals"], rng),
        robots=[asdict(robot) for robot in abilities],
        gains={name: getattr(scaled, name) for name in GAINS},
        min_dwell=content["min_dwell"],
        facts={"min_dwell": content["min_dwell"]},
        tolerance=content["tolerance"],
        field=FIELD + START,
        columns=[*COLUMNS, *(f"trust_{i + 1}" for i in range(count))],
        late=0.0,
    )


def _goals(count: int, rng: np.random.Generator) -> list[list[float]]:
    """Return goals, each some way from the one before."""
    goals = [[0.0, 0.0]]
    while len(goals) <= count:
        goal = rng.uniform(-FIELD, FIELD, 2)
        if np.hypot(*(goal - goals[-1])) >= NEAREST:
            goals.append(goal.tolist())
    return goals[1:]


def team_measures(session: Session) -> dict[str, float]:
    """
    Return the time that the run took, the way of the team's middle, goals reached, the mean
    distance to the goal, switches, suggestions and how many of them were followed, counted as in
    `run_condition`, and the root mean square of the force shown.
    """
    leader, suggested = session["leader"], session["leader_suggested"]
    moves = np.diff(np.column_stack([session["team_x"], session["team_y"]]), axis=0)
    return {
        "duration": len(session) * session.sample_time,
        "path": float(np.hypot(*moves.T).sum()),
        "goals_reached": int(session["goals_reached"][-1]),
        "path_error": float(session["path_error"].mean()),
        "switches": int(np.count_nonzero(np.diff(leader))),
        **suggestions_followed(session.t, leader, np.where(suggested > 0, suggested, -1.0)),
        "force": force_shown(session),
    }


TASK = LiveTask(
    name="team",
    conditions=(BY_HAND, *ADVISERS, SUGGESTED),
    reported=("duration", "path", "goals_reached", "switches", "force"),
    settings=LeadingSettings,
    config=team_config,
    begin=LeadingRun,
    hand=ScriptedLeader,
    measures=team_measures,
    decisions=COLUMNS[-6:],
)


def task_of(policy: LeaderPolicy) -> LiveTask:
    """Return the task with a leader policy of your own in the person's place."""
    return replace(TASK, begin=partial(LeadingRun, policy=policy))


# how often people choose the leader that a policy would pick, beyond chance
# --------------------------------------------------------------------------------------------------


def occasions(session: Session, dwell: float) -> pd.DataFrame:
    """
    Return the occasions on which a person might have changed the leader of a team.

    The first begins when the leader has led for the dwell time. Each lasts until the person lets
    another robot lead, at most for another dwell time; the next begins when a switch is possible
    again.

    Parameters
    ----------
    session : Session
        A run of a team.
    dwell : float
        τ_min [s].

    Returns
    -------
    pandas.DataFrame
        A row per occasion: t, when it begins [s]; most_trusted and hysteresis, whom the policies
        would pick then; chosen, who leads at its end.
    """
    leader = session["leader"].astype(int)
    length = round(dwell / session.sample_time)
    rows = []
    end = length  # the first leader begins with the run
    for k in np.flatnonzero(session["may_switch"] > 0):
        if k < end:
            continue
        ahead = leader[k : k + length + 1]
        # Who led before: a switch possible in row k, wished before, is made in that row.
        switched = np.flatnonzero(ahead != leader[k - 1])
        if len(ahead) <= length and not switched.size:
            break  # the run ended before the person had the time
        end = int(k + (switched[0] if switched.size else length))
        picks = (int(session[f"leader_{name}"][k]) for name in ADVISERS)
        rows.append((session.t[k], *picks, leader[end]))
        if switched.size:
            end += length  # `may_switch` is of before the decision, so 1 in the rows of a switch
    return pd.DataFrame(rows, columns=["t", *ADVISERS, "chosen"])


DRAWS, ENDS = 2000, (2.5, 97.5)
"""Resamples of participants for an interval of κ, and its percentiles."""


def policy_agreement(sessions: Iterable[Session], seed: int = 0) -> pd.DataFrame:
    """
    Return how often people's choice of the leader agrees with each policy, beyond chance.

    κ = (agreement − chance)/(1 − chance). Chance is what choices and picks of the same run would
    share if they were independent, Cohen (1960), with each run's own frequencies: somebody who
    keeps one robot agrees with a policy that keeps it too by chance only.

    Parameters
    ----------
    sessions : iterable of Session
        Runs of a team in which a person chose by hand; others are left out.
    seed : int
        Of the resamples of participants, for the interval.

    Returns
    -------
    pandas.DataFrame
        Index policy; participants, occasions, agreement (share of occasions), chance, kappa, low
        and high: of the 95 % interval by participants drawn with replacement, NaN for fewer than
        two.

    Raises
    ------
    ValueError
        If there is no occasion to choose.
    """
    people: dict[str, np.ndarray] = defaultdict(lambda: np.zeros((len(ADVISERS), 3)))
    for session in sessions:
        about = session.metadata
        if about.condition == BY_HAND:
            table = occasions(session, about.more["min_dwell"])
            people[str(about.participant)] += [_sums(table, name) for name in ADVISERS]
    sums = np.array([*people.values()])
    if not sums.any():
        raise ValueError(f"nobody had an occasion to choose; runs in {BY_HAND!r} are needed")
    rng = np.random.default_rng(seed)
    drawn = rng.integers(len(people), size=(DRAWS, len(people)))
    low = high = np.nan
    if len(people) > 1:
        low, high = np.nanpercentile(_kappa(sums[drawn].sum(axis=1)), ENDS, axis=0)
    total = sums.sum(axis=0)
    count, agreed, chance = total.T
    columns = {"participants": len(people), "occasions": count.astype(int)}
    columns |= {"agreement": agreed / count, "chance": chance / count, "kappa": _kappa(total)}
    index = pd.Index(ADVISERS, name="policy")
    return pd.DataFrame(columns | {"low": low, "high": high}, index)


def _sums(table: pd.DataFrame, policy: str) -> tuple[float, float, float]:
    """Return occasions of a run, agreements, and those expected by chance."""
    chosen, picked = table["chosen"], table[policy]
    shares = chosen.value_counts(normalize=True)
    expected = shares.mul(picked.value_counts(), fill_value=0.0).sum()
    return len(table), (chosen == picked).sum(), expected


def _kappa(sums: np.ndarray) -> np.ndarray:
    """Return κ of occasions, agreements and expected agreements; NaN where chance is certain."""
    count, agreed, expected = np.moveaxis(sums, -1, 0)
    room = np.where(count - expected > 1e-9, count - expected, np.nan)
    return (agreed - expected) / room
