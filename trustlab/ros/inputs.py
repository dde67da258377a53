"""One input of the robot's loop: its latest message, how old that is, and what was refused."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from trustlab.models.checks import one_of, positive

# The actions that make sense when an input falls silent. A velocity is never held: the robot would
# drive on blindly; and nobody can take over the task of odometry.
INPUTS = {
    "odometry": ("stop",),
    "operator": ("stop", "hand over"),
    "autonomy": ("stop", "hand over"),
    "path_error": ("stop", "hold"),
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
        object.__setattr__(self, "after", positive("after", self.after))
        one_of("action", self.action, ("stop", "hand over", "hold"))


class Input:
    """The latest accepted message of one input; what is refused is passed to `note`."""

    def __init__(self, name: str, watchdog: Watchdog, note: Callable[[str], None]):
        self.name = name
        self.watchdog = watchdog
        self.note = note
        self.stamp = -math.inf
        self.values: tuple[float, ...] | None = None
        self.silent = False

    def take(self, stamp: float, values: tuple[float, ...], now: float) -> bool:
        """Take a message over, or note its fault and return False."""
        fault = self._fault(stamp, values, now)
        if fault:
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
        silent = now - self.stamp > self.watchdog.after
        if silent != self.silent and self.values is not None:
            self.note(
                f"{self.name}: silent, {self.watchdog.action}"
                if silent
                else f"{self.name}: heard again"
            )
        self.silent = silent
        return silent
