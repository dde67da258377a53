"""What a robot's loop is set to, and its inputs: the latest message, its age, its faults."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from trustlab.models.checks import not_negative, of_class, one_of, positive, set_checked

# The actions that make sense when an input falls silent, the usual one first. A velocity is never
# held: the robot would drive on blindly; and nobody can take over the task of odometry.
INPUTS = {
    "odometry": ("stop",),
    "operator": ("hand over", "stop"),
    "autonomy": ("hand over", "stop"),
    "path_error": ("hold", "stop"),
}
FIELDS = {
    "odometry": ("x", "y"),
    "operator": ("v", "w"),
    "autonomy": ("v", "w"),
    "path_error": ("e",),
}
# Nothing on a ground robot measures more, in metres or in m/s; sums of squares stay finite.
LARGEST = 1e6
# How far ahead of the clock a stamp may be [s]: clocks of two computers, and rounding.
AHEAD = 0.01


@dataclass(frozen=True)
class Watchdog:
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
        If the time is not positive or the action unknown.
    """

    after: float
    action: str

    def __post_init__(self):
        set_checked(self, positive, "after")
        one_of("action", self.action, ("stop", "hand over", "hold"))


class Input:
    """The latest accepted message of one input; what is refused is passed to `note`."""

    def __init__(self, name: str, watchdog: Watchdog, note: Callable[[str], None]):
        self.name = name
        self.watchdog = watchdog
        self.note = note
        self.stamp = -math.inf
        self.values: Any = None
        self.silent = False

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


def _watchdogs() -> dict[str, Watchdog]:
    return {name: Watchdog(0.5, actions[0]) for name, actions in INPUTS.items()}


@dataclass(frozen=True)
class CoreSettings:
    """
    Settings of `AllocationCore`.

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
        A `Watchdog` for each of odometry, operator, autonomy and path_error.
    model_sample_time : float
        Sample time that a_r and a_pr of the model are of [s]; 0.1 s as printed.
    wait : float, optional
        Time before the rule is asked [s]; by default the window, which means fill until then.

    Raises
    ------
    ValueError
        If a number is not positive, or a watchdog is missing or unknown.
    """

    period: float = 0.05
    window: float = 100.0
    e_max: float = 2.0
    v_max: float = 0.5
    w_max: float = 1.0
    v_rate: float = 1.0
    w_rate: float = 2.0
    watchdogs: dict[str, Watchdog] = field(default_factory=_watchdogs)
    model_sample_time: float = 0.1
    wait: float | None = None

    def __post_init__(self):
        names = ("period", "window", "e_max", "v_max", "w_max", "v_rate", "w_rate")
        set_checked(self, positive, *names, "model_sample_time")
        if self.wait is None:
            self.__dict__["wait"] = self.window
        set_checked(self, not_negative, "wait")
        if self.window < self.period:
            raise ValueError(f"window = {self.window} s is shorter than one step ({self.period} s)")
        if set(self.watchdogs) != set(INPUTS):
            raise ValueError(
                f"watchdogs must name {', '.join(INPUTS)}; got {', '.join(self.watchdogs)}"
            )
        for name, watchdog in self.watchdogs.items():
            of_class(f"watchdogs[{name!r}]", watchdog, Watchdog)
            if watchdog.action not in INPUTS[name]:
                raise ValueError(
                    f"the watchdog of {name} must {' or '.join(INPUTS[name])}, "
                    f"got {watchdog.action!r}"
                )
