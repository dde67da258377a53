"""
Testbeds behind one protocol, the runs of conditions C1–C5 on two of them, and their names.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol

import pandas as pd

from trustlab.allocation.rules import prepared_rule
from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    Seed,
    of_class,
    one_of,
    whole_number,
)
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator, person_of
from trustlab.teleoperation.loop.settings import SCHEMES
from trustlab.testbeds import deciding, uav_following as flight
from trustlab.testbeds.condition_run import ConditionRun
from trustlab.testbeds.deciding import (
    CONDITIONS,
    KNOWN,
    SAMPLE_TIME,
    Driver,
    Task,
    checked_rules,
)
from trustlab.testbeds.ground_robot import kernel as ground
from trustlab.testbeds.ground_robot.course import Course, default_course
from trustlab.testbeds.populations import (
    OperatorPopulation,
    TeleoperatorPopulation,
    following_operator,
    printed_person,
)
from trustlab.testbeds.team_testbed import RobotTeam
from trustlab.testbeds.teleoperation_measures import measures_of
from trustlab.testbeds.uav_tracking import simulate_teleoperation

Person = Mapping[str, Any]


class Testbed(Protocol):
    """
    What studies know of a testbed.

    Attributes: `name`, one word everywhere; `title`, its name in sentences; `conditions`, all that
    can be run; `printed_conditions` and `printed_n`, those and the participants of the
    dissertation's study; `measures`, those that figures show by default; `takes_rules`, whether a
    rule can be a condition; `setting_names`, those of `settings`, the length of a run first;
    `population`, from which people are drawn.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    conditions: ClassVar[tuple[str, ...]]
    printed_conditions: ClassVar[tuple[str, ...]]
    printed_n: ClassVar[int]
    measures: ClassVar[tuple[str, ...]]
    takes_rules: ClassVar[bool] = False
    setting_names: ClassVar[tuple[str, ...]]

    population: Any

    @property
    def origin(self) -> str:
        """Where the people come from."""
        return self.population.origin

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of all runs, by name."""
        return {name: getattr(self, name) for name in self.setting_names}

    def people(
        self, n: int, assumptions: Mapping[str, float] | None = None, seed: int = 0
    ) -> pd.DataFrame:
        """
        Return a row of numbers per person: participant, from 1, and their parameters, as drawn.

        Parameters
        ----------
        n : int
            How many.
        assumptions : mapping of str to float, optional
            What is assumed of all of them, by name.
        seed : int
            Seed of the draws; people of a smaller n are the first of a larger one.
        """
        return self.population.draw(n, seed, assumptions)

    def run(self, condition: str, person: Person, seed: Seed) -> Any:
        """
        Run one session; return an object with the log as `.session` and outcome measures by name as
        `.measures`.

        Parameters
        ----------
        condition : str
            One of `conditions`.
        person : mapping
            A row of `people`.
        seed : int or numpy.random.SeedSequence
            Seed of the session.
        """

    def next_session(self, person: Person, run: Any) -> Person:
        """
        Return the person as they come to the session after this run; the same unless a testbed
        carries something over.

        Parameters
        ----------
        person : mapping
            As for `run`.
        run : object
            What `run` returned.
        """
        return person


@cache
def usual_population(testbed: str) -> OperatorPopulation:
    """Return the population of a testbed of C1 to C5 where none is given."""
    return getattr(OperatorPopulation, testbed)()


@dataclass(frozen=True, eq=False, kw_only=True)
class ConditionTestbed(Checked, Testbed):
    """
    What the testbeds of C1 to C5 have in common.

    Parameters
    ----------
    rest : float, optional
        Pause between the sessions of a study [s], in which utilization decays by (2.5) from its
        value at the end of the session before. When it is left out, every session begins with the
        operator's r0, 0 unless assumed otherwise.
    population : OperatorPopulation, optional
        From whom operators are drawn.
    rules : mapping of str to callable, optional
        Conditions of one's own by name: a function or class that makes a new rule for each run, as
        `make()` or, where it needs an argument, as `make(model)` with the operator's model.

    Raises
    ------
    ValueError
        If a setting is out of range or the population is of another testbed.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    module: ClassVar[Any]  # with E_MAX and FACTS
    _numbered: ClassVar[Callable]  # returns who goes by a number or a name
    laps: ClassVar[int] = 0
    conditions = tuple(KNOWN)
    printed_conditions = tuple(CONDITIONS)
    printed_n = 20
    measures = ("p_r", "p_h", "r", "path_error")
    takes_rules = True
    setting_names: ClassVar[tuple[str, ...]] = ("duration", "rest")

    rest: NotNegative | None = None
    population: OperatorPopulation | None = field(default=None, repr=False)
    rules: Mapping[str, Callable] = field(default_factory=dict)

    def __post_init__(self):
        super().__post_init__()
        conditions = checked_rules(self.rules, KNOWN)
        population = self.population or usual_population(self.name)
        one_of("the testbed of population", population.testbed, [self.name])
        self.__dict__.update(conditions=conditions, population=population)

    def run(self, condition: str, person: Person, seed: Seed) -> ConditionRun:
        """
        Run one session with the operator of a row of `people`.

        Parameters
        ----------
        condition : str
            One of `conditions`.
        person : mapping
            The row.
        seed : int or numpy.random.SeedSequence
            As for `run_condition`.
        """
        rule = self.rule_of(condition, person) if condition in self.rules else None
        return self.conducted(condition, person_of(person), seed, rule=rule)

    def rule_of(self, condition: str, person: Person) -> Any:
        """
        Return a new rule of a condition of one's own.

        Parameters
        ----------
        condition : str
            A name in `rules`.
        person : mapping
            As for `run`, for what makes a rule of the operator's model.

        Raises
        ------
        ValueError
            If what was made is no rule; and what making it raises.
        """
        make = self.rules[condition]
        try:
            inspect.signature(make).bind()
        except TypeError:  # it needs an argument
            rule = make(person_of(person)[1])
        else:
            rule = make()
        prepared_rule(rule)
        return rule

    def conducted(
        self,
        condition: str | None,
        person: Driver,
        seed: Seed,
        thresholds: tuple[float, float] | None = None,
        rule: Any = None,
    ) -> ConditionRun:
        """
        Run one session.

        Parameters
        ----------
        condition, seed, thresholds, rule : object
            As for `run_condition`; with a rule, the condition is a name for the metadata.
        person : (Operator, TscModel, (float, float) or None)
            The operator who drives, the model that rules and suggestions use, and the thresholds of
            suggestions where `thresholds` are not given.
        """
        operator, model, _ = person
        task, thresholds, decide = deciding.task_for(
            condition, rule, person, thresholds, e_max=self.module.E_MAX, laps=self.laps
        )
        length = self.setting_names[0]
        facts = {length: getattr(self, length), "settling": deciding.SETTLING} | self.module.FACTS
        if thresholds is not None:
            facts |= zip(("TSC_l", "TSC_u"), thresholds, strict=True)
        metadata = deciding.metadata_of(self.name, operator, condition, seed, **facts)
        log, lap_times = self._simulated(task, operator, seed, decide)
        return ConditionRun(log, metadata, operator, model, thresholds, lap_times)

    def _simulated(self, task: Task, operator: Operator, seed: Seed, decide: Any) -> tuple:
        """Return the log of a run, and when laps ended, where there are any."""
        raise NotImplementedError

    def next_session(self, person: Person, run: ConditionRun) -> Person:
        """
        Return the operator as they come to the session after this run.

        Parameters
        ----------
        person : mapping
            As for `run`.
        run : ConditionRun
            The run.
        """
        if self.rest is None:
            return person
        last = float(run.log["r"][-1])
        return {**person, "r0": last * run.operator.human.a ** (self.rest / SAMPLE_TIME)}  # (2.5)


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundRobot(ConditionTestbed):
    """
    The ground robot of Section 2.4.1.

    Parameters
    ----------
    laps : int
        Laps of each run; 8 as printed, at most 1000.
    rest, population : object
        As for a `ConditionTestbed`; `OperatorPopulation.ground_robot()` by default.
    robot : Pioneer, optional
        The robot, if not the calibrated one.
    course : Course, optional
        The course, if not the default one.

    Raises
    ------
    ValueError
        If a setting is not understood.
    """

    name = "ground_robot"
    title = "the ground-robot testbed"
    module: ClassVar[Any] = ground
    _numbered = staticmethod(printed_person)
    setting_names = ("laps", "rest")

    laps: int = 8  # type: ignore[misc]  # of other testbeds a constant
    robot: ground.Pioneer = field(default_factory=ground.Pioneer)
    course: Course = field(default_factory=default_course)

    def __post_init__(self):
        super().__post_init__()
        self.__dict__["laps"] = whole_number("laps", self.laps, most=ground.MOST_LAPS)

    def _simulated(self, task, operator, seed, decide):
        return ground.driven(task, self.robot, self.course, operator, seed, decide=decide)


@dataclass(frozen=True, eq=False, kw_only=True)
class UavFollowing(ConditionTestbed):
    """
    The UAV of Section 2.4.2 that follows a leader for six minutes.

    Performance is the window mean over 100 s of (e_max − e)/e_max and of 1 − ‖u_i − u_h‖₁/Δu_max
    (Section 2.4.2, where the deviation itself is printed). While the operator flies, the autopilot
    knows where the leader is; left alone, it drifts away. What is not printed (e_max, Δu_max, the
    leader's path, ranges of performance) is plausible, not measured.

    Parameters
    ----------
    rest, population : object
        As for a `ConditionTestbed`; `OperatorPopulation.uav_following()` by default.
    """

    name = "uav_following"
    title = "the testbed of the UAV that follows a leader"
    module: ClassVar[Any] = flight
    duration = flight.DURATION
    _numbered = staticmethod(following_operator)

    def _simulated(self, task, operator, seed, decide):
        return flight.flown(task, operator, seed, decide), None


@dataclass(frozen=True, eq=False, kw_only=True)
class UavTracking(Checked, Testbed):
    """
    The teleoperated UAV of Chapter 3, with the settings of `simulate_teleoperation`.

    Parameters
    ----------
    duration : float
        Length of each run [s].
    population : TeleoperatorPopulation, optional
        From whom operators are drawn, and whose study is simulated; `TeleoperatorPopulation()` by
        default.

    Raises
    ------
    ValueError
        If a setting is not understood.
    """

    name = "uav_tracking"
    title = "the UAV testbed"
    conditions = tuple(SCHEMES)
    printed_conditions = ("M", "OMI", "MMI", "TMIG")
    printed_n = 32
    measures = ("tracking_error", "p_r", "p_h", "hand_force")
    setting_names = ("duration",)

    duration: Positive = 120.0
    population: TeleoperatorPopulation = field(default_factory=TeleoperatorPopulation)

    def run(self, condition: str, person: Person, seed: Seed) -> SimpleNamespace:
        """
        Run one session with the operator of a row of `people`.

        Parameters
        ----------
        condition : str
            The scheme.
        person : mapping
            The row.
        seed : int or numpy.random.SeedSequence
            As for `simulate_teleoperation`.
        """
        operator, study = self.population.person(person), self.population.study
        session = simulate_teleoperation(condition, operator, study, seed, self.duration)
        return SimpleNamespace(session=session, measures=measures_of(session))


TESTBEDS: dict[str, Any] = {
    bed.name: bed for bed in (GroundRobot, UavFollowing, UavTracking, RobotTeam)
}


def named_testbed(testbed: Any, laps: int | None = None, among: Any = TESTBEDS) -> Any:
    """Return a testbed by its name, or the one given; with so many laps where they are given."""
    bed = testbed
    if isinstance(testbed, type) or not callable(getattr(testbed, "run", None)):
        bed = TESTBEDS[one_of("testbed", testbed, among, "a Testbed")]()
    if laps is None:
        return bed
    if not isinstance(bed, GroundRobot):
        raise ValueError(f"laps has no effect on {bed.title}; leave it out")
    return replace(bed, laps=laps)


def run_condition(
    condition: str | None = None,
    participant: int | str | Operator | None = None,
    model: TscModel | None = None,
    thresholds: tuple[float, float] | None = None,
    laps: int | None = None,
    seed: Seed = 0,
    r0: float | None = None,
    operator: Operator | None = None,
    testbed: str | ConditionTestbed = "ground_robot",
    rule: Any = None,
) -> ConditionRun:
    """
    Drive laps, or fly after a leader, under one of the conditions C1–C5 of Section 2.4.1.2.

    C1: the operator allocates by thresholds of TSC of their own. C2, C3: suggestions by (2.8), free
    to follow and forced. C4, C5: suggestions by Algorithm 2, free and forced. Two controls are not
    printed: "own", forced suggestions by the thresholds that the operator's switches in C1 show,
    and "random", forced suggestions at random times. TSC (2.1) and the suggestions come from
    performance as measured, (2.4) and (2.7) over 100 s, and the given model. A condition begins in
    the manual mode, rolling on the path; nobody switches before that window is full.

    Parameters
    ----------
    condition : {"C1", "C2", "C3", "C4", "C5", "own", "random"}, optional
        The condition; either this or `rule`.
    participant : int, str or Operator
        Who drives: the stand-in for a printed participant, 1 to 5, "1" to "5" or "pilot"
        (`published_operator`), or any `Operator`. On the UAV the seeded operators 1 to 20 of
        `following_operator`, or an `Operator` with a model in shares of 1.
    model : TscModel, optional
        The model which TSC and P_max of Algorithm 2 are taken from: the operator's identified one.
        For a participant by number it is known; needed for an `Operator`. Its samples are 0.1 s, as
        those of the operator's own model.
    thresholds : (float, float), optional
        TSC_l and TSC_u of (2.8), in C2 and C3 only; for a printed participant those of Table 2.2
        when not given. In C1 the operator's own thresholds, `Operator.lower` and `.upper`, decide;
        in C4 and C5 Algorithm 2.
    laps : int, optional
        How many laps of the ground robot; at least one, at most 1000; 8, as printed, when not
        given.
    seed : int or numpy.random.SeedSequence
        Streams are spawned from it: the robot's sensing, the operator's hand, the operator's
        decisions, and the leader's start.
    r0 : float, optional
        Utilization at the beginning, in [0, 1]; that of the operator when not given, 0 (rested)
        unless assumed otherwise.
    operator : Operator, optional
        The same as an `Operator` given as participant.
    testbed : {"ground_robot", "uav_following"}, GroundRobot or UavFollowing
        The testbed by name, or with settings: `GroundRobot(robot=…, course=…)`.
    rule : object, optional
        What decides who drives, in place of a condition: an object with a method step(tsc=…,
        p_r=…), as for `simulate_allocation`. A copy of it is called every 0.1 s, from the time on
        at which the window is full, with TSC and P_r as measured, and what it returns is the mode
        at once, without a reaction. The first mode is `rule.mode`, or 1 (manual) where it has none.

    Returns
    -------
    ConditionRun
        With `.session`, `.measures`, `.suggestions()` and `.plot()`; of the ground robot with
        `.lap_times` besides.

    Raises
    ------
    ValueError
        If an argument is not understood or would have no effect, thresholds lie outside the limits
        of Theorem 1 at δ_Ph = 0 (which are quoted), the laps are not finished at 0.15 m/s on
        average, or a rule fails or returns something else.

    Warns
    -----
    UserWarning
        If the run ends before the window is full, so that nobody could switch and all conditions
        are the same.

    Notes
    -----
    Simulated: no person took part, and the robot's and the hand's parameters are calibrated, not
    measured.

    In C1 an operator whose threshold is passed within the first 100 s switches at their end, one
    reaction later, whatever TSC is by then: this first switch says nothing about the threshold. The
    metadata hold these 100 s as `settling`, and `estimate_thresholds` leaves such switches out with
    after=110.0. Every switch lags its cause by one reaction, see there.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.run_condition("C3", participant=2, laps=2, seed=1)
    >>> run.session.metadata.synthetic
    True
    """
    bed = named_testbed(testbed, laps, (GroundRobot.name, UavFollowing.name))
    of_class("testbed", bed, ConditionTestbed, "or a name")
    if (participant is None) == (operator is None):
        raise ValueError(
            "who drives? give either participant= or operator=, not both, and model= for an "
            "Operator"
        )
    who: Any = participant
    own = usual = None
    if operator is not None:
        who = of_class("operator", operator, Operator, ground.MAKE_OPERATOR)
    if not isinstance(who, Operator):
        who, own, usual = bed._numbered(str(who))
    model = of_class("model", own if model is None else model, TscModel)
    if r0 is not None:
        who = replace(who, r0=r0)
    if rule is not None:
        if condition is not None or thresholds is not None:
            raise ValueError(
                "condition and thresholds have no effect beside rule=, which decides; leave them "
                "out"
            )
        condition = f"rule {type(rule).__name__}"
    run = bed.conducted(condition, (who, model, usual), seed, thresholds, rule)
    deciding.warn_if_too_short(run.log.size * SAMPLE_TIME)
    return run
