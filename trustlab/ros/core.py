"""
Who drives, and which command the robot gets, sample by sample from what was heard until then.

The order within a step: watchdogs, measures, the rule, the source of the command, its bounds.
"""

import math
import re
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trustlab.allocation.correction import ThresholdCorrector
from trustlab.allocation.correction_run import OnlineCorrection
from trustlab.allocation.rules import PerformanceRule, ThresholdRule, prepared_rule
from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    between,
    of_class,
    one_of,
    table_of,
)
from trustlab.models.tsc import TscModel, next_utilization
from trustlab.sessions.errors import SessionError
from trustlab.sessions.metrics import goal_speed, manoeuvring
from trustlab.sessions.session import Metadata, Session
from trustlab.testbeds.deciding import CONDITIONS

COLUMNS = (
    "mode",
    "p_r",
    "p_h",
    "tsc",
    "r",
    "path_error",
    "step_distance",
    "v_command",
    "w_command",
    "suggested_mode",
)
_DRIVERS = {None: "nobody", 0.0: "autonomy", 1.0: "operator"}
# A step that comes later than this share of the period is noted.
LATE_STEP = 1.5
# A robot moves no faster than so many times v_max: what does is a place found anew, or a fault.
FASTEST = 5.0
# So many notes that differ in numbers alone are kept; further ones are counted.
MOST_NOTES = 20


# The actions that make sense when an input falls silent, the usual one first. A velocity is never
# held: the robot would drive on blindly; and nobody can take over the task of odometry.
INPUTS = {
    "odometry": ("stop",),
    "operator": ("hand over", "stop"),
    "autonomy": ("hand over", "stop"),
    "path_error": ("hold", "stop"),
}
# Nothing on a ground robot measures more, in metres or in m/s; sums of squares stay finite.
LARGEST = 1e6
# How far ahead of the clock a stamp may be [s]: clocks of two computers, and rounding.
AHEAD = 0.01


@dataclass(frozen=True)
class Watchdog(Checked):
    """
    What happens when an input falls silent.

    Parameters
    ----------
    after : float
        Greatest age of the latest message, by its stamp [s].
    action : {"stop", "hand over", "hold"}
        Bring the robot to rest; let the other of operator and autonomy drive, while that is heard;
        or hold the last path error, without asking the rule.

    Raises
    ------
    ValueError
        If the time is not positive.
    """

    after: Positive
    action: str


@dataclass(frozen=True)
class CoreSettings(Checked):
    """
    Bounds, rates, watchdogs and the window of a run.

    Parameters
    ----------
    period : float
        Time between steps [s], the sample time of the log.
    window : float
        Length W of the means (2.4) and (2.7) [s].
    e_max : float
        Greatest acceptable deviation from the path [m].
    v_max, w_max : float
        Bounds of the linear [m/s] and angular [rad/s] velocity sent to the robot.
    v_rate, w_rate : float
        How fast these may change [m/s², rad/s²], at a handover too.
    watchdogs : dict
        A `Watchdog` for those of odometry, operator, autonomy and path_error that differ from the
        usual ones: after half a second, and the first action that makes sense.
    model_sample_time : float
        Sample time that a_r and a_pr of the model are of [s]; 0.1 s as printed.
    wait : float, optional
        Time before the rule is asked [s]; by default the window, which means fill until then.

    Raises
    ------
    ValueError
        If a number is not positive, or a watchdog does what makes no sense.
    """

    period: Positive = 0.05
    window: Positive = 100.0
    e_max: Positive = 2.0
    v_max: Positive = 0.5
    w_max: Positive = 1.0
    v_rate: Positive = 1.0
    w_rate: Positive = 2.0
    watchdogs: dict[str, Watchdog] = field(default_factory=dict)
    model_sample_time: Positive = 0.1
    wait: NotNegative | None = None

    def __post_init__(self):
        super().__post_init__()
        if self.wait is None:
            self.__dict__["wait"] = self.window
        if self.window < self.period:
            raise ValueError(f"window = {self.window} s is shorter than one step ({self.period} s)")
        for name, watchdog in table_of("watchdogs", self.watchdogs).items():
            of_class(f"watchdogs[{name!r}]", watchdog, Watchdog)
            actions = INPUTS[one_of("watchdogs", name, INPUTS)]
            one_of(f"action of the watchdog of {name}", watchdog.action, actions)
        usual = {name: Watchdog(0.5, actions[0]) for name, actions in INPUTS.items()}
        self.__dict__["watchdogs"] = usual | self.watchdogs


@dataclass
class Input:
    """The latest accepted message of one input; what is refused is passed to `note`."""

    name: str
    watchdog: Watchdog
    note: Callable[[str], None]
    stamp: float = -math.inf
    values: Any = None
    silent: bool = False

    def take(self, stamp: float, values: tuple[float, ...], now: float) -> bool:
        """Take a message over, or note its fault and return False."""
        if fault := self._fault(stamp, values, now):
            self.note(f"{self.name}: {fault}")
            return False
        if now - stamp > self.watchdog.after:
            self.note(f"{self.name}: late by {now - stamp:.3g} s")
        elif stamp - self.stamp > self.watchdog.after and self.values is not None:
            self.note(f"{self.name}: messages lost, none for {stamp - self.stamp:.3g} s")
        self.stamp = stamp
        self.values = values
        return True

    def _fault(self, stamp: float, values: tuple[float, ...], now: float) -> str | None:
        if not math.isfinite(stamp):
            return f"stamp is {stamp}"
        if not all(math.isfinite(value) and abs(value) <= LARGEST for value in values):
            return f"not a finite value of usual size: {values}"
        if self.name == "path_error" and values[0] < 0.0:
            return f"a deviation cannot be negative: {values[0]:.6g}"
        if stamp > now + AHEAD:
            return f"stamp is {stamp - now:.3g} s ahead of the clock"
        if stamp == self.stamp:
            return f"repeated, stamp {stamp:.6f}"
        if stamp < self.stamp:
            return f"out of order, {self.stamp - stamp:.3g} s before the latest"
        return None

    def watch(self, now: float) -> bool:
        """Return whether the input has fallen silent, and note when that begins and ends."""
        if self.values is None:  # not heard yet: nothing begins or ends
            return True
        silent = now - self.stamp > self.watchdog.after
        if silent != self.silent:
            said = f"silent, {self.watchdog.action}" if silent else "heard again"
            self.note(f"{self.name}: {said}")
        self.silent = silent
        return silent


@dataclass(frozen=True)
class Decision:
    """
    The outcome of one step.

    Parameters
    ----------
    v, w : float
        The command to send, within bounds [m/s, rad/s].
    driver : {"operator", "autonomy", "both", "nobody"}
        Where the command comes from; with "nobody" the robot comes to rest or stands.
    mode : float
        1 manual, 0 autonomous, between them the operator's share: as allocated, also while a
        watchdog acts.
    suggestion : int
        The mode suggested, or −1.
    tsc : float
        TSC (2.1), NaN until every input was heard.
    lower, upper : float
        The thresholds TSC_l and TSC_u of this step, NaN without any.
    """

    v: float
    w: float
    driver: str
    mode: float
    suggestion: int = -1
    tsc: float = math.nan
    lower: float = math.nan
    upper: float = math.nan


class AllocationCore:
    """
    The allocation rule on line: stamped messages in, a bounded velocity command out.

    It knows no middleware, reads no clock and writes no file: the caller passes the time, all
    stamps by the same clock. `RunSettings.core` makes it, from arguments that go together. P_r and
    P_h are the window means (2.4) and (2.7) of what was heard. What is heard counts within what a
    robot can do: velocities within the bounds, and no distance where odometry jumps.

    The robot comes to rest until every input was heard once. The operator's `stop` wins over
    everything, at once, until `release`; a rule that fails stops the robot, too. Refused or late
    messages, silent inputs and late steps are named in `notes`, the first twenty of a kind.
    """

    def __init__(
        self,
        model: TscModel,
        condition: str | None,
        thresholds: tuple[float, float] | None,
        rule: Any,
        correction: ThresholdCorrector | None,
        settings: CoreSettings,
    ):
        self.model, self.condition, self.settings = model, condition, settings
        self.rule: Any = None
        self.mode: float = 1
        self.forced = True
        if rule is not None:
            self.rule, self.mode = prepared_rule(rule)
        else:
            _, self.forced = CONDITIONS[condition]
            if thresholds is not None:
                self.rule = ThresholdRule(*thresholds)
            elif condition != "C1":
                self.rule = PerformanceRule(model.robot.p_min, model.robot.p_max)
        self.correction = None
        if correction is not None:
            self.correction = OnlineCorrection(correction, thresholds, outside="nearest")
        # The model's a_r is of its own sample time, at which thresholds are corrected, too.
        steps = settings.model_sample_time / settings.period
        self.correct_every = max(1, round(steps))
        self.a_r = model.human.a ** (1.0 / steps)
        self.r = 0.0
        self.notes: list[tuple[float, str]] = []
        self.kinds = Counter()
        self.now = -math.inf
        self.last_step = math.nan
        self.stopped = False
        self.command = (0.0, 0.0)
        self.rows: list[tuple] = []
        self.placed: tuple | None = None
        samples = round(settings.window / settings.period)
        self.speeds = deque(maxlen=samples)
        self.skills = deque(maxlen=samples)
        watchdogs = settings.watchdogs.items()
        self.inputs = {name: Input(name, watchdog, self.note) for name, watchdog in watchdogs}

    def note(self, text: str) -> None:
        """Add a note, with the time of the latest message or step."""
        kind = re.sub(r"[\d.]+(e[+-]\d+)?", "#", text)
        self.kinds[kind] += 1
        if self.kinds[kind] <= MOST_NOTES:
            self.notes.append((self.now, text))

    def hear(self, name: str, stamp: float, values: tuple[float, ...], now: float) -> bool:
        """
        Take a message over, or note its fault, keep the message before and return False.

        stamp: when it was measured [s]; watchdogs count from here. values: x, y [m]; v, w [m/s,
        rad/s], twice, which count within the bounds; or the path error, (e,) [m]. now: the clock
        [s].
        """
        self.now = max(self.now, now)
        entry = self.inputs[name]
        if not entry.take(stamp, values, now):
            return False
        if name in ("operator", "autonomy"):
            entry.values = tuple(self._within(values).tolist())
            if entry.values != values:
                v, w = values
                self.note(f"{name}: {v:.3g} m/s, {w:.3g} rad/s count within the bounds alone")
        return True

    def press(self, mode: int) -> None:
        """
        Choose the mode by the operator's button, 1 manual, 0 autonomous; where a rule allocates at
        once this has no effect, and a note says so.
        """
        if self.forced:
            self.note("button: no effect where a rule allocates")
        else:
            self.mode = mode

    def stop(self) -> None:
        """Stop the robot by the operator's wish, from the next step on until `release`."""
        self.stopped = True
        self.note("operator's stop")

    @property
    def heard(self) -> bool:
        """Whether every input was heard."""
        return all(entry.values for entry in self.inputs.values())

    def rest(self, reason: str) -> None:
        """Take the robot to be at rest, for a reason that is noted: commands rise from there."""
        self.command = (0.0, 0.0)
        self.note(reason)

    def release(self) -> None:
        """End the operator's stop."""
        self.stopped = False
        self.note("operator's stop released")

    def step(self, now: float) -> Decision:
        """Decide at a tick of the loop, at a time [s] that rises from step to step."""
        if now < self.now:
            self.note(f"clock went back by {self.now - now:.3g} s")
        self.now = max(self.now, now)
        elapsed = self.now - self.last_step  # NaN in the first step
        if elapsed > LATE_STEP * self.settings.period:
            self.note(f"step late: {elapsed:.3g} s after the one before")
        self.last_step = self.now
        silent = {name for name, entry in self.inputs.items() if entry.watch(self.now)}
        lower = getattr(self.rule, "lower", math.nan)
        upper = getattr(self.rule, "upper", math.nan)
        tsc, suggestion = self._measured(silent) if self.heard else (math.nan, -1)
        share = self._share(silent)
        # Steps made up for after a gap come at once, and together change the command by no more
        # than one does.
        self.command = self._bounded(share, min(self.settings.period, elapsed))
        driver = _DRIVERS.get(share, "both")
        return Decision(*self.command, driver, self.mode, suggestion, tsc, lower, upper)

    def _measured(self, silent: set[str]) -> tuple[float, int]:
        """Measure performance, ask the rule unless an input is silent, and log the sample."""
        settings = self.settings
        error, command = self.inputs["path_error"].values, self.inputs["operator"].values
        measured = (*error, self._distance(), *command)
        error, distance, v, w = np.array([measured]).T
        self.speeds += goal_speed(distance, error, settings.period, settings.e_max).tolist()
        self.skills += manoeuvring(v, w, error, settings.e_max).tolist()
        p_r = math.fsum(self.speeds) / len(self.speeds)
        p_h = math.fsum(self.skills) / len(self.skills)
        tsc = float(self.model.value(p_r, p_h))
        suggestion = -1
        waited = len(self.rows) * settings.period >= settings.wait
        if waited and not (silent or self.stopped):
            try:
                suggestion = self._asked(tsc, p_r, p_h)
            except Exception as error:
                self.note(
                    f"rule.step failed at t = {self.now:g} s: {type(error).__name__}: {error}; "
                    "the robot is stopped"
                )
                self.stopped = True
        self.rows.append((self.mode, p_r, p_h, tsc, self.r, *measured, suggestion))
        self.r = next_utilization.py_func(self.r, self.mode, self.a_r)  # (2.5)
        return tsc, suggestion

    def _distance(self) -> float:
        """Return how far the robot went since the last sample, 0 where odometry jumps."""
        stamp, place = self.inputs["odometry"].stamp, self.inputs["odometry"].values
        before, origin = self.placed or (stamp, place)
        self.placed = stamp, place
        distance = math.dist(place, origin)
        elapsed = max(stamp - before, self.settings.period)
        if distance <= FASTEST * self.settings.v_max * elapsed:
            return distance
        self.note(f"odometry: jumps by {distance:.3g} m within {elapsed:.3g} s, not counted")
        return 0.0

    def _asked(self, tsc: float, p_r: float, p_h: float) -> int:
        """Ask rule and correction; change the mode where the rule allocates, else suggest one."""
        if self.rule is None:
            return -1
        if isinstance(self.rule, ThresholdRule) and not self.forced:
            self.rule.mode = int(self.mode)  # hysteresis goes with the mode that the button chose
        mode = self.rule.step(tsc=tsc, p_r=p_r)
        if mode is not None and self.forced:
            mode = self.mode = between("the operator's share", float(mode), 0.0, 1.0)
        correction = self.correction
        if correction is not None and len(self.rows) % self.correct_every == 0:
            correction.r = self.r
            correction.update(p_r, p_h, int(self.mode))
            # for the next step
            self.rule.lower, self.rule.upper = correction.lower, correction.upper
        return -1 if mode is None or mode == self.mode else mode

    def _share(self, silent: set[str]) -> float | None:
        """Return the operator's share as allocated, or as watchdogs leave it; None: nobody's."""
        lost = any(self.settings.watchdogs[name].action == "stop" for name in silent)
        if self.stopped or lost or not self.heard or silent >= {"operator", "autonomy"}:
            return None
        if "operator" in silent:
            return 0.0
        return 1.0 if "autonomy" in silent else self.mode

    def _bounded(self, share: float | None, elapsed: float) -> tuple[float, float]:
        """Return the blended command within the bounds, approached at the rates allowed."""
        if self.stopped:
            return 0.0, 0.0
        wanted = np.zeros(2)
        if share is not None:
            operator, autonomy = self.inputs["operator"].values, self.inputs["autonomy"].values
            wanted = share * np.array(operator) + (1.0 - share) * np.array(autonomy)
        s, before = self.settings, np.array(self.command)
        change = np.array([s.v_rate, s.w_rate]) * elapsed
        v, w = np.clip(self._within(wanted), before - change, before + change).tolist()
        return v, w

    def _within(self, velocities: Any) -> np.ndarray:
        bounds = np.array([self.settings.v_max, self.settings.w_max])
        return np.clip(velocities, -bounds, bounds)

    def session(self, **facts: Any) -> Session:
        """
        Return the log so far as a session, from the sample on at which every input was heard, with
        `notes` and these facts in its metadata; a SessionError where it has fewer than two samples.
        """
        import pandas as pd

        if len(self.rows) < 2:
            unheard = [name for name, entry in self.inputs.items() if entry.values is None]
            reason = f"; never heard: {', '.join(unheard)}" if unheard else ""
            raise SessionError(f"a session needs two samples, logged {len(self.rows)}{reason}")
        t = [k * self.settings.period for k in range(len(self.rows))]
        frame = pd.DataFrame(self.rows, columns=COLUMNS, index=t)
        notes = [f"{when:.6f} s: {text}" for when, text in self.notes]
        kinds = self.kinds.items()
        notes += [f"{n - MOST_NOTES} more: {kind}" for kind, n in kinds if n > MOST_NOTES]
        window = self.settings.window
        metadata = Metadata(condition=self.condition, source="trustlab.ros.AllocationCore").changed(
            notes=notes,
            performance=f"(2.4), window {window:g} s",
            performance_window=window,  # where fits look
            **facts,
        )
        return Session(frame, metadata)
