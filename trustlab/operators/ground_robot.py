"""
Simulated operators of the ground robot: how well they drive, how fast they react, when they switch.
"""

from collections import namedtuple
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np

from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    Share,
    between,
    check_participant,
    of_class,
    one_of,
    set_in_order,
    shown,
)
from trustlab.models.compiled import inner
from trustlab.models.tsc import HumanModel, RobotModel, TscModel

# What may be assumed of people beyond the identified models, with its range; 0 is off.
ASSUMPTIONS = {
    "attention_cost": (0.0, 0.5),
    "trust_bias": (-2.0, 2.0),
    "take_over_lag": (0.0, 60.0),
    "r0": (0.0, 1.0),
    "load_utilization": (0.0, 1.0),
    "load_switching": (0.0, 1.0),
}


@inner
def driving_style(performance, robot_floor, robot_gain):
    """
    Return cruising speed [m/s], wander [m] and steering activity [rad/s] for a given performance
    [m/s].

    They are such that (2.7) comes out as `performance` and (2.4), after long, as robot_floor +
    robot_gain · performance, or as much of it as `performance` leaves room for; what is left of
    (2.7) is steering. A regression on laps of the default course.
    """
    p_r = min(robot_floor + robot_gain * performance, performance - 0.029)
    steering = performance - p_r
    speed = 1.264 * p_r + 0.607 * steering - 0.018
    wander = 0.32 - 0.04 * (performance - 0.39) / 0.07
    activity = 2.385 * np.sqrt(max(steering - 0.029 - 0.02 * p_r, 0.0))
    return max(speed, 0.05), max(wander, 0.05), min(activity, 1.0)


@inner
def joystick(bearing, speed, gain, easing):
    """
    Return the commands v, w of a hand that steers towards what it looks at, slower the farther that
    is aside.
    """
    return speed * max(1.0 - easing * abs(bearing), 0.2), gain * bearing


@dataclass(frozen=True)
class Operator(Checked):
    """
    A simulated operator with a joystick: a stand-in for a person.

    Parameters
    ----------
    participant : str or int
        Who this stands for.
    human : HumanModel
        Utilization (2.5) and performance (2.6), in the unit of (2.7) [m/s], which sets how the
        operator drives. Its samples are 0.1 s: the `a` of a model fitted at another step [s] is
        ``a ** (0.1 / step)`` here.
    robot_floor, robot_gain : float
        What robot performance comes to in the operator's hand, robot_floor + robot_gain · P_h
        [m/s]: where (2.3) settles under manual control, P_r,min + b_pr/(1 − a_pr) P_h. The defaults
        are the pilot operator's.
    delay : float
        Visuomotor delay: the hand acts on what the eye saw this long ago [s], in whole samples of
        0.1 s; at most 5 s.
    noise : float
        Scale of wander and of steering activity; 1 as calibrated, 0 a hand without noise.
    hand_lag : float
        Time constant of the hand [s].
    look_ahead : float
        How far ahead on the path the operator looks [m].
    steering_gain : float
        Turn rate per angle to what the operator looks at [1/s].
    easing : float
        Share of speed given up per radian of that angle [1/rad].
    idle_share : float
        The robot being autonomous, the hand stays on the joystick and keeps making commands, which
        are logged and have no effect; this is the share of steering that it keeps.
    wander_time : float
        Correlation time of the wander about the path [s].
    reaction_lag, reaction_spread : float
        Median [s] and logarithmic standard deviation of the lag between deciding for a mode and
        switching to it.
    follow_tsc, follow_performance : float
        Probability of following a suggestion by TSC (C2) and by robot performance (C4).
    ignoring_time : float
        A suggestion not followed is taken up, if it still stands, after 15 s and a further time
        that is exponentially distributed with this mean [s].
    lower, upper : float
        The operator's own thresholds of TSC when free to choose (C1): manual below, autonomous
        above.
    lower_spread, upper_spread : float
        Standard deviations of the thresholds, which are drawn anew at every switch.
    attention_cost : float
        Assumption, as all that follow; 0 is off. Share of performance (2.6) lost while the operator
        must decide: in all of C1, and in C2 and C4 while a suggestion stands that is not followed
        yet; at most 0.5.
    trust_bias : float
        Perceived minus measured TSC, in [-2, 2]: positive where the operator trusts the robot too
        much (C1).
    take_over_lag : float
        Added to the lag between deciding for the manual mode and switching to it [s]; at most 60 s.
    r0 : float
        Utilization at the beginning of a run for which none is given, in [0, 1]; 0 is a rested
        operator.
    load_utilization, load_switching : float
        Share of the scale of task load at r = 1, and per switch or judged suggestion a minute
        (`allocation_answers`), in [0, 1]. With both 0 the operator answers no questionnaire.

    Raises
    ------
    ValueError
        If a number is not finite or out of range, or own thresholds are in the wrong order.

    Notes
    -----
    The defaults of the driving parameters are calibrated on the ground-robot testbed; they are not
    measurements of people.

    Examples
    --------
    >>> import trustlab as tl
    >>> tsc = tl.published_models()["2"]
    >>> me = tl.Operator("me", tsc.human, delay=0.2, attention_cost=0.05)
    >>> run = tl.run_condition("C3", operator=me, model=tsc, thresholds=(0.0, 0.35), laps=4, seed=0)
    >>> run.session.metadata.participant, run.session.metadata.synthetic
    ('me', True)
    """

    participant: str | int
    human: HumanModel
    robot_floor: Share = 0.24
    robot_gain: NotNegative = 0.326
    delay: Annotated[float, (0.0, 5.0)] = 0.3
    noise: NotNegative = 1.0
    hand_lag: Positive = 0.15
    look_ahead: Positive = 2.4
    steering_gain: Positive = 1.2
    easing: NotNegative = 0.3
    idle_share: Share = 0.7
    wander_time: Positive = 4.0
    reaction_lag: NotNegative = 2.0
    reaction_spread: NotNegative = 0.5
    follow_tsc: Share = 0.7857
    follow_performance: Share = 0.6389
    ignoring_time: NotNegative = 30.0
    lower: float = 0.0
    upper: float = 0.4
    lower_spread: NotNegative = 0.1
    upper_spread: NotNegative = 0.1
    attention_cost: float = 0.0
    trust_bias: float = 0.0
    take_over_lag: float = 0.0
    r0: float = 0.0
    load_utilization: float = 0.0
    load_switching: float = 0.0

    def __post_init__(self):
        of_class("human", self.human, HumanModel, "of a TscModel take .human")
        super().__post_init__()
        check_participant(self.participant)
        checked_assumptions({name: getattr(self, name) for name in ASSUMPTIONS})
        set_in_order(self, "lower", "upper")
        if self.human.p_min < 0.1 or self.human.p_max > 1.0:
            raise ValueError(
                "an operator drives at a performance (2.7) in m/s, between 0.1 and 1, but human "
                f"has p_min = {self.human.p_min} and p_max = {self.human.p_max}; rescale the "
                "model or fit it to ground-robot sessions"
            )

    @property
    def numbers(self) -> Any:
        """The operator as plain numbers, `OperatorNumbers`."""
        human = self.human
        rest = (getattr(self, name) for name in NUMBERS)
        return OperatorNumbers._make((human.a, human.beta, human.p_min, human.p_max, *rest))


# All but the participant and the human model.
NUMBERS = [item.name for item in fields(Operator)][2:]

# An `Operator` as plain numbers for compiled loops, by its names and those of its human model.
OperatorNumbers = namedtuple(  # type: ignore[misc]
    "OperatorNumbers", ["a", "beta", "p_min", "p_max", *NUMBERS]
)


def checked_assumptions(
    assumptions: Mapping[str, Any] | None, ranges: Mapping[str, tuple] = ASSUMPTIONS
) -> dict[str, float]:
    """Return assumptions about operators by name, each within its range, (least, most, …)."""
    if not isinstance(assumptions, Mapping | None):
        raise ValueError(f"assumptions must map names to numbers, got {shown(assumptions)}")
    return {
        name: between(name, value, *ranges[one_of("an assumption", name, ranges)][:2])
        for name, value in (assumptions or {}).items()
    }


def operator(participant: str | int, model: TscModel | HumanModel, **more: Any) -> Operator:
    """
    Return the operator that a participant's identified model makes.

    Parameters
    ----------
    participant : str or int
        Who, for example "pilot" or 3.
    model : TscModel or HumanModel
        The participant's model, for example `trustlab.published_models()["3"]`; from a `TscModel`
        robot_floor and robot_gain follow, unless given.
    **more : float or int
        Any other argument of `Operator`.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    if isinstance(model, TscModel):
        robot = model.robot
        more = {"robot_floor": robot.p_min, "robot_gain": robot.b / (1.0 - robot.a)} | more
        model = model.human
    return Operator(participant, model, **more)


def model_of(values: Mapping[str, Any]) -> TscModel:
    """Return the model of one row of a population's draw."""
    human = HumanModel(values["a_r"], values["beta"], values["p_h_min"], values["p_h_max"])
    return TscModel(
        RobotModel(values["a_pr"], values["p_r_min"], values["p_r_max"], human.p_max), human
    )


def person_of(values: Mapping[str, Any]) -> tuple[Operator, TscModel, tuple[float, float]]:
    """
    Return the simulated operator, model and thresholds of TSC of one row of a population's draw.

    Parameters
    ----------
    values : mapping
        The row; whatever else an `Operator` has, as assumptions, is taken from it where it is
        there.

    Raises
    ------
    ValueError
        If the numbers make no model or operator.
    """
    model = model_of(values)
    habits = {name: values[name] for name in NUMBERS if name in values}
    name = values["participant"]
    name = name if isinstance(name, str) else int(name)
    person = operator(name, model, **habits)
    return person, model, (float(values["tsc_l"]), float(values["tsc_u"]))
