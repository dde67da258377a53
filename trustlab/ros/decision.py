"""
Who drives, and which command the robot gets, sample by sample from what was heard until then.

The order within a step: watchdogs, measures, the rule, the source of the command, its bounds.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.allocation.rules import PerformanceRule, ThresholdRule, decision, prepared_rule
from trustlab.models.checks import finite_number, of_class, one_of, whole_number
from trustlab.models.tsc import TscModel
from trustlab.ros.inputs import FIELDS, Input
from trustlab.ros.settings import CoreSettings
from trustlab.ros.window import WindowMean
from trustlab.sessions.errors import SessionError
from trustlab.sessions.metadata import Metadata
from trustlab.sessions.metrics import goal_speed, manoeuvring
from trustlab.sessions.session import Session
from trustlab.testbeds.deciding import CONDITIONS

COLUMNS = (
    "mode",
    "p_r",
    "p_h",
    "tsc",
    "path_error",
    "step_distance",
    "v_command",
    "w_command",
    "suggested_mode",
)
# A step that comes later than this share of the period is noted.
LATE_STEP = 1.5


@dataclass(frozen=True)
class Decision:
    """
    The outcome of one step.

    Parameters
    ----------
    v, w : float
        The command to send, within bounds [m/s, rad/s].
    driver : {"operator", "autonomy", "nobody"}
        Where the command comes from; with "nobody" the robot comes to rest or stands.
    mode : int
        1 manual, 0 autonomous: the mode allocated, also while a watchdog acts.
    suggestion : int
        The mode suggested, or −1.
    tsc : float
        TSC (2.1), NaN until every input was heard.
    """

    v: float
    w: float
    driver: str
    mode: int
    suggestion: int = -1
    tsc: float = math.nan


class AllocationCore:
    """
    The allocation rule on line: stamped messages in, a bounded velocity command out.

    It knows no middleware, reads no clock and writes no file: the caller passes the time, all
    stamps by the same clock. P_r and P_h are the window means (2.4) and (2.7) of what was heard,
    with the bits that `Session.with_performance` has for the logged session.

    The robot comes to rest until every input was heard once. The operator's `stop` wins over
    everything, at once, until `release`. Refused or late messages, silent inputs and late steps
    are named in `notes`.

    Parameters
    ----------
    model : TscModel
        Of the person who drives, for example `fit_tsc(session).model`.
    condition : {"C1", "C2", "C3", "C4", "C5"}, optional
        Who allocates: the button alone (C1), suggestions by (2.8) or Algorithm 2 that the button
        may follow (C2, C4), or these rules at once (C3, C5).
    thresholds : tuple of float, optional
        TSC_l and TSC_u; needed in C2 and C3, refused elsewhere.
    rule : object, optional
        A rule of your own, which allocates at once; takes the place of `condition`.
    settings : CoreSettings, optional
        Bounds, rates, watchdogs, window.

    Raises
    ------
    ValueError
        If neither or both of condition and rule are present, or thresholds are missing or unused.

    Examples
    --------
    >>> import trustlab as tl
    >>> model = tl.published_models()["1"]
    >>> core = AllocationCore(model, "C3", thresholds=(0.02, 0.45))
    >>> core.hear("odometry", 0.0, (0.0, 0.0), now=0.0)
    True
    >>> core.hear("operator", 0.0, (float("nan"), 0.0), now=0.0)
    False
    >>> core.step(0.0).driver
    'nobody'
    >>> core.notes[0][1]
    'operator: not a finite value of usual size: (nan, 0.0)'
    """

    def __init__(
        self,
        model: TscModel,
        condition: str | None = None,
        thresholds: tuple[float, float] | None = None,
        rule: Any = None,
        settings: CoreSettings | None = None,
    ):
        self.model = of_class("model", model, TscModel, TscModel.how_to_get)
        self.settings = settings or CoreSettings()
        of_class("settings", self.settings, CoreSettings)
        self.condition = condition
        self.rule, self.forced = _rule_of(model, condition, thresholds, rule)
        self.mode = 1
        if rule is not None:
            self.rule, self.mode = prepared_rule(rule, None)
        self.notes: list[tuple[float, str]] = []
        self.now = -math.inf
        self.last_step = math.inf
        self.stopped = False
        self.command = (0.0, 0.0)
        self.rows: list[tuple[float, ...]] = []
        self.place: tuple[float, ...] | None = None
        samples = round(self.settings.window / self.settings.period)
        self.means = WindowMean(samples), WindowMean(samples)
        self.inputs = {
            name: Input(name, watchdog, self._note)
            for name, watchdog in self.settings.watchdogs.items()
        }

    def _note(self, text: str) -> None:
        self.notes.append((self.now, text))

    def hear(self, name: str, stamp: float, values: tuple[float, ...], now: float) -> bool:
        """
        Take a message over, or note its fault and keep the message before.

        Parameters
        ----------
        name : {"odometry", "operator", "autonomy", "path_error"}
            The input.
        stamp : float
            When it was measured [s]; watchdogs count from here.
        values : tuple of float
            x, y [m]; v, w [m/s, rad/s], twice; or the path error, (e,) [m].
        now : float
            The clock [s].

        Returns
        -------
        bool
            Whether the message was taken over.

        Raises
        ------
        ValueError
            If the input is unknown, the number of values is wrong, or the clock not finite.
        """
        one_of("name", name, FIELDS)
        values = tuple(float(value) for value in values)
        if len(values) != len(FIELDS[name]):
            raise ValueError(f"{name} needs {', '.join(FIELDS[name])}; got {len(values)} values")
        self.now = max(self.now, finite_number("now", now))
        return self.inputs[name].take(float(stamp), values, now)

    def press(self, mode: int) -> bool:
        """
        Choose the mode by the operator's button.

        Parameters
        ----------
        mode : int
            1 manual, 0 autonomous.

        Returns
        -------
        bool
            Whether it had an effect; where a rule allocates at once it has none, and a note says
            so.

        Raises
        ------
        ValueError
            If the mode is not 0 or 1.
        """
        whole_number("mode", mode, least=0, most=1)
        if self.forced:
            self._note("button: no effect where a rule allocates")
            return False
        self.mode = mode
        return True

    def stop(self) -> None:
        """Stop the robot by the operator's wish, from the next step on until `release`."""
        self.stopped = True
        self._note("operator's stop")

    def release(self) -> None:
        """End the operator's stop."""
        self.stopped = False
        self._note("operator's stop released")

    def step(self, now: float) -> Decision:
        """
        Decide at a tick of the loop.

        Parameters
        ----------
        now : float
            The clock [s], rising from step to step.

        Returns
        -------
        Decision
            What to send, and why.

        Raises
        ------
        ValueError
            If the clock is not finite, or the rule fails; send zeros then.
        """
        previous = self.now
        self.now = finite_number("now", now)
        if now < previous:
            self.now = previous
            self._note(f"clock went back by {previous - now:.3g} s")
        if self.now - self.last_step > LATE_STEP * self.settings.period:
            self._note(f"step late: {self.now - self.last_step:.3g} s after the one before")
        self.last_step = self.now
        silent = {name for name, entry in self.inputs.items() if entry.watch(self.now)}
        tsc = math.nan
        suggestion = -1
        if all(entry.values is not None for entry in self.inputs.values()):
            tsc, suggestion = self._measured(silent)
        driver = self._driver(silent)
        self.command = self._bounded(driver)
        return Decision(*self.command, driver, self.mode, suggestion, tsc)

    def _values(self, name: str) -> tuple[float, ...]:
        values = self.inputs[name].values
        assert values is not None  # called once every input was heard
        return values

    def _measured(self, silent: set[str]) -> tuple[float, int]:
        """Measure performance, ask the rule unless an input is silent, and log the sample."""
        settings = self.settings
        place = self._values("odometry")
        distance = math.dist(place, self.place) if self.place else 0.0
        self.place = place
        (error,) = self._values("path_error")
        v, w = self._values("operator")
        off_path = np.array([error])
        speed = goal_speed(np.array([distance]), off_path, settings.period, settings.e_max)
        skill = manoeuvring(np.array([v]), np.array([w]), off_path, settings.e_max)
        p_r = self.means[0].step(float(speed[0]))
        p_h = self.means[1].step(float(skill[0]))
        tsc = float(self.model.value(p_r, p_h))
        suggestion = -1
        waited = len(self.rows) * settings.period >= settings.wait
        if self.rule is not None and waited and not silent and not self.stopped:
            suggestion = self._asked(tsc, p_r)
        row = (self.mode, p_r, p_h, tsc, error, distance, v, w, suggestion)
        self.rows.append(row)
        return tsc, suggestion

    def _asked(self, tsc: float, p_r: float) -> int:
        if isinstance(self.rule, ThresholdRule) and not self.forced:
            self.rule.mode = self.mode  # hysteresis goes with the mode that the button chose
        mode = decision(self.rule, f"t = {self.now:g} s", tsc, p_r)
        if mode is not None and self.forced:
            self.mode = mode
        return -1 if mode is None or mode == self.mode else mode

    def _driver(self, silent: set[str]) -> str:
        """Return who drives: whom the mode says, or whom the watchdogs leave."""
        lost = {name for name in silent if self.settings.watchdogs[name].action == "stop"}
        unheard = any(entry.values is None for entry in self.inputs.values())
        if self.stopped or lost or unheard:
            return "nobody"
        first, second = ("operator", "autonomy") if self.mode == 1 else ("autonomy", "operator")
        if first not in silent:
            return first
        return "nobody" if second in silent else second

    def _bounded(self, driver: str) -> tuple[float, float]:
        """Return the driver's command within the bounds, approached at the rates allowed."""
        if self.stopped:
            return 0.0, 0.0
        v, w = (0.0, 0.0) if driver == "nobody" else self._values(driver)
        s = self.settings
        return (
            _approached(self.command[0], v, s.v_max, s.v_rate * s.period),
            _approached(self.command[1], w, s.w_max, s.w_rate * s.period),
        )

    def session(self, **facts: Any) -> Session:
        """
        Return the log so far as a session, from the sample on at which every input was heard.

        Parameters
        ----------
        **facts : object
            Entries of the metadata, for example participant=3, synthetic=True.

        Returns
        -------
        Session
            With `notes` in its metadata. What the operator commanded is logged as heard.

        Raises
        ------
        SessionError
            If fewer than two samples were logged.
        """
        import pandas as pd

        if len(self.rows) < 2:
            unheard = [name for name, entry in self.inputs.items() if entry.values is None]
            reason = f"; never heard: {', '.join(unheard)}" if unheard else ""
            raise SessionError(f"a session needs two samples, logged {len(self.rows)}{reason}")
        t = [k * self.settings.period for k in range(len(self.rows))]
        frame = pd.DataFrame(self.rows, columns=list(COLUMNS), index=t)
        notes = [f"{when:.6f} s: {text}" for when, text in self.notes]
        metadata = Metadata(condition=self.condition, source="trustlab.ros.AllocationCore")
        return Session(frame, metadata.changed(notes=notes, **facts))


def _rule_of(
    model: TscModel, condition: str | None, thresholds: tuple[float, float] | None, rule: Any
) -> tuple[Any, bool]:
    """Return the rule of a condition, and whether it allocates at once."""
    if (condition is None) == (rule is None):
        raise ValueError("AllocationCore needs a condition, C1 to C5, or a rule, and not both")
    if condition is None:
        if thresholds is not None:
            raise ValueError("thresholds have no effect beside a rule; leave them out")
        return rule, True
    _, forced = CONDITIONS[one_of("condition", condition, CONDITIONS)]
    if condition in ("C2", "C3"):
        if thresholds is None:
            raise ValueError(
                f"{condition} needs thresholds=(TSC_l, TSC_u): take those of "
                "trustlab.choose_thresholds(model)"
            )
        return ThresholdRule(*thresholds), forced
    if thresholds is not None:
        raise ValueError(f"thresholds have no effect in {condition}; leave them out")
    if condition == "C1":
        return None, False
    return PerformanceRule(model.robot.p_min, model.robot.p_max), forced


def _approached(present: float, target: float, bound: float, step: float) -> float:
    """Return the target within its bounds, or as near to it as a step allows."""
    target = min(max(target, -bound), bound)
    return min(max(target, present - step), present + step)
