"""
Who decides when in conditions C1–C5 (Section 2.4.1.2): one step of own thresholds and of
suggestions, for all testbeds.
"""

import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.rules import decision, performance_suggestion, prepared_rule
from trustlab.models.checks import Seed, one_of, shown, warn, whole_seed
from trustlab.models.compiled import inner
from trustlab.models.records import columns_of
from trustlab.models.tsc import TscModel, next_utilization, performance_at, threshold_mode
from trustlab.operators.ground_robot import Operator
from trustlab.sessions.session import Metadata

# Who allocates: modes from outside (a sequence or a rule), the operator, suggestions by (2.8), by
# Algorithm 2, at random.
SCHEDULE = 0
OWN = 1
TSC = 2
PERFORMANCE = 3
RANDOM = 4

# Who allocates in each condition of Section 2.4.1.2, and whether suggestions must be followed.
CONDITIONS = {
    "C1": (OWN, False),
    "C2": (TSC, False),
    "C3": (TSC, True),
    "C4": (PERFORMANCE, False),
    "C5": (PERFORMANCE, True),
}

# Besides, controls, suggestions forced, that tell better thresholds from the relief of deciding:
# "own", by the thresholds that the operator's switches in C1 show; "random", at random times.
KNOWN = CONDITIONS | {"own": (TSC, True), "random": (RANDOM, True)}

# Mean length of the phases of "random" [s]: the UAV is flown by hand about as long as in C1.
RANDOM_PHASE = 60.0

# Of Chapter 2 [s].
SAMPLE_TIME, WINDOW = 0.1, 100.0

# A suggestion counts as followed when the operator complies within this time [s].
DEADLINE = 15.0

# An operator, the model that rules and suggestions use, and the thresholds of suggestions, if any.
Driver = tuple[Operator, TscModel, tuple[float, float] | None]

# Nobody switches before this time [s], when the window of (2.4) and (2.7) is full for the first
# time: means of the first few samples, of a robot that has just been put on the path, are far above
# what they become.
SETTLING = 100.0


# Performance summed over the window, utilization, own or suggested thresholds, and when a decision
# takes effect. −1 stands for no suggestion, no decision under way and no suggestion being
# considered.
NUMBERS = "sum_r sum_h p_r p_h tsc r lower upper due episode_seen"
COUNTS, FLAGS = "mode suggested decided episode", "willing"


class Task(NamedTuple):
    """
    What is to be done, for the compiled loops; scheme is one of SCHEDULE, OWN, TSC, PERFORMANCE and
    RANDOM.
    """

    scheme: int
    e_max: float
    forced: bool = False
    laps: int = 0
    lower: float = 0.0
    upper: float = 0.0
    first_mode: int = 1
    r0: float = 0.0
    a_T: float = 0.0  # noqa: N815
    b_T: float = 0.0  # noqa: N815
    p_min: float = 0.0
    p_max: float = 0.0
    window: int = round(WINDOW / SAMPLE_TIME)
    sample_time: float = SAMPLE_TIME

    def suggesting(self, model: TscModel) -> "Task":
        """Return the task with TSC and suggestions of a model."""
        robot = model.robot
        return self._replace(a_T=model.a_T, b_T=model.b_T, p_min=robot.p_min, p_max=robot.p_max)


def suggested_by_tsc(condition: str) -> bool:
    """Return whether thresholds of TSC can be chosen for the suggestions: in C2 and C3."""
    return condition in ("C2", "C3")


def task_for(
    condition: str | None,
    rule: Any,
    driver: Driver,
    thresholds: tuple[float, float] | None,
    **bed: Any,
) -> tuple[Task, tuple[float, float] | None, Callable | None]:
    """
    Return the task of a condition, or of a rule where there is one, with the thresholds of its
    suggestions, checked, and what decides in the rule's place.

    `thresholds` apply only to C2 and C3, where those of the driver, if any, are the usual ones.
    bed: further fields of the task.
    """
    operator, model, usual = driver
    task = Task(SCHEDULE, r0=operator.r0, **bed).suggesting(model)
    if rule is not None:
        rule, mode = prepared_rule(rule)
        return task._replace(first_mode=mode), None, obeying(rule)
    condition = one_of("condition", condition, KNOWN, "rule=")
    if suggested_by_tsc(condition):
        pair = usual if thresholds is None else thresholds
        if pair is None:
            raise ValueError(
                f"{condition} needs thresholds=(TSC_l, TSC_u) for an Operator: take .lower and "
                ".upper of trustlab.choose_thresholds(model), or those of Table 2.2"
            )
        thresholds = check_thresholds(model, pair)
    elif thresholds is not None:
        raise ValueError(
            f"thresholds have no effect in {condition}, where the operator's own, "
            "Operator(lower=, upper=), Algorithm 2 or chance decide; leave them out"
        )
    lower, upper = thresholds or (operator.lower, operator.upper)
    if condition == "own":  # switches in C1 come at these values of measured TSC
        lower, upper = lower - operator.trust_bias, upper - operator.trust_bias
    scheme, forced = KNOWN[condition]
    return task._replace(scheme=scheme, forced=forced, lower=lower, upper=upper), thresholds, None


def obeying(rule: Any) -> Callable:
    """Return the `decide` that asks a rule, from the time on at which somebody may switch."""
    samples = itertools.count()

    def decide(state: Any, inputs: np.ndarray) -> None:
        t = next(samples) * SAMPLE_TIME
        if t >= SETTLING:
            (now,) = state.now
            mode = decision(rule, f"t = {t:.1f} s", float(now["tsc"]), float(now["p_r"]))
            if mode is not None:
                inputs[:] = mode

    return decide


def checked_rules(rules: Any, known: Mapping) -> tuple[str, ...]:
    """Return the names of known conditions and of a user's own, with what makes their rules."""
    if not isinstance(rules, Mapping):
        raise ValueError(f"rules must map names to what makes a rule; got {shown(rules)}")
    for name, make in rules.items():
        if not isinstance(name, str) or name in known or not callable(make):
            raise ValueError(
                f"rules: {name!r} must be a name of its own, for a class or function that makes a "
                f"rule, so that no run begins in the state of another; got {shown(make)}"
            )
    return (*known, *rules)


def warn_if_too_short(longest: float) -> None:
    """Warn where runs of at most `longest` seconds end before anybody may switch."""
    if longest <= SETTLING:
        warn(
            f"nobody may switch in the first {SETTLING:g} s, when the window of measured "
            f"performance fills, and no run lasts longer than {longest:.0f} s: all conditions are "
            "the same but for noise; take more laps"
        )


def sample_times(count: int) -> np.ndarray:
    """Return the times of so many samples [s]."""
    return np.round(np.arange(count) * SAMPLE_TIME, 6)


def framed(log: np.ndarray) -> pd.DataFrame:
    """Return a log, all numbers, as a table over time."""
    table = log.view(float).reshape(log.size, -1)
    return pd.DataFrame(
        table, index=pd.Index(sample_times(log.size), name="t"), columns=columns_of(log.dtype)
    )


def metadata_of(
    testbed: str, operator: Operator, condition: str, seed: Seed, **facts: Any
) -> Metadata:
    """
    Return metadata that say how a run was made; facts: what it stands for (`note`), how
    `performance` is measured, and more.
    """
    if isinstance(seed, np.random.SeedSequence):
        facts |= {"seed": str(seed.entropy), "spawn_key": ".".join(map(str, seed.spawn_key))}
    else:
        facts["seed"] = whole_seed(seed)
    facts["performance"] += f", window {WINDOW:g} s"
    facts["performance_window"] = WINDOW
    return Metadata(operator.participant, condition, f"trustlab.testbeds.{testbed}", True, facts)


@inner
def draw_thresholds(task, person, state, rng):
    """Set the thresholds of TSC; own ones are drawn."""
    state.lower, state.upper = task.lower, task.upper
    if task.scheme == OWN:
        state.lower += person.lower_spread * rng.standard_normal()
        state.upper += person.upper_spread * rng.standard_normal()


@inner
def begin(task, person, state, rng):
    """Set utilization, mode and thresholds at the beginning."""
    state.r = task.r0
    state.mode = task.first_mode
    state.episode_seen = -1e9
    state.suggested = state.decided = state.episode = -1
    draw_thresholds(task, person, state, rng)


@inner
def skill_now(task, person, state):
    """
    Return human performance (2.6), as the attention that deciding takes leaves it.
    """
    skill = performance_at(state.r, person.beta, person.p_min, person.p_max)
    free_to_decline = not task.forced and state.suggested >= 0 and state.suggested != state.mode
    if task.scheme == OWN or free_to_decline:
        skill *= 1.0 - person.attention_cost
    return skill


@inner(_nrt=False)
def measure(task, k, z_r, z_h, state):
    """
    Move performance as measured, (2.4) and (2.7), to the window that ends at sample k, and TSC
    (2.1) with it.
    """
    state.sum_r += z_r[k]
    state.sum_h += z_h[k]
    if k >= task.window:
        state.sum_r -= z_r[k - task.window]
        state.sum_h -= z_h[k - task.window]
    used = min(k + 1, task.window)
    state.p_r = state.sum_r / used  # (2.4)
    state.p_h = state.sum_h / used  # (2.7)
    state.tsc = task.a_T * state.p_r - task.b_T * state.p_h  # (2.1)


@inner
def reaction(person, wanted, rng):
    """
    Return the time between a decision and its execution [s]; its logarithm is normal, and
    taking over adds to it.
    """
    late = person.reaction_lag * np.exp(person.reaction_spread * rng.standard_normal())
    return late + person.take_over_lag if wanted == 1 else late


@inner
def own_decision(person, t, state, rng):
    """
    Let the operator decide by thresholds of TSC of their own, and TSC as they perceive it (C1).
    """
    perceived = state.tsc + person.trust_bias
    if (
        state.decided < 0
        and threshold_mode(perceived, state.lower, state.upper, state.mode) != state.mode
    ):
        state.decided, state.willing = 1 - state.mode, True
        state.due = t + reaction(person, state.decided, rng)


@inner
def suggest(task, state):
    """Make the suggestion of the scheme, by (2.8) or Algorithm 2 (C2–C5)."""
    if task.scheme == TSC:
        standing = state.mode if state.suggested < 0 else state.suggested
        state.suggested = threshold_mode(state.tsc, state.lower, state.upper, standing)  # (2.8)
    else:
        # Algorithm 2
        state.suggested = performance_suggestion(state.p_r, task.p_min, task.p_max)


@inner
def consider(task, person, t, state, rng):
    """
    Make the suggestion of the scheme, and let the operator decide once per suggestion whether to
    follow.
    """
    if task.scheme == RANDOM:
        standing = state.mode if state.suggested < 0 else state.suggested
        ends = rng.random() < task.sample_time / RANDOM_PHASE
        state.suggested, follow = 1 - standing if ends else standing, 1.0
    else:
        suggest(task, state)
        follow = person.follow_tsc if task.scheme == TSC else person.follow_performance
    if state.suggested == state.mode:
        state.decided = state.episode = -1
    elif state.suggested >= 0:
        if state.suggested != state.episode or t - state.episode_seen > DEADLINE:
            state.willing = task.forced or rng.random() < follow
            late = reaction(person, state.suggested, rng)
            if not state.willing:
                late += DEADLINE + person.ignoring_time * rng.standard_exponential()
            state.decided = state.episode = state.suggested
            state.due = t + late
        state.episode_seen = t


@inner
def allocate(task, person, given, t, state, rng):
    """Set who drives in this sample: a mode given from outside, or, where it is NaN, the scheme."""
    before = state.mode
    if task.scheme == SCHEDULE:
        state.suggested = -1
    if not np.isnan(given):
        state.mode = state.suggested = int(given)
    elif task.scheme == SCHEDULE or t < SETTLING:
        pass
    elif task.scheme == OWN:
        own_decision(person, t, state, rng)
    else:
        consider(task, person, t, state, rng)
    if state.decided >= 0 and t >= state.due:
        if state.willing or state.suggested == state.decided:
            state.mode = state.decided
        state.decided = -1
    if state.mode != before:
        state.episode = -1
        draw_thresholds(task, person, state, rng)  # anew at every switch


@inner
def log_decision(row, state):
    """Log who drives, and what that was decided by."""
    row.mode = state.mode
    row.suggested_mode = state.suggested
    row.r = state.r
    row.p_r = state.p_r
    row.p_h = state.p_h
    row.tsc = state.tsc


@inner
def tire(person, state):
    """Step utilization (2.5)."""
    state.r = min(max(next_utilization(state.r, state.mode, person.a), 0.0), 1.0)
