"""What a run of the decision core is set to: bounds, rates, watchdogs, measures of performance."""

from dataclasses import dataclass, field

from trustlab.models.checks import not_negative, of_class, positive, set_checked
from trustlab.ros.inputs import INPUTS, Watchdog


def _watchdogs() -> dict[str, Watchdog]:
    return {
        "odometry": Watchdog(0.5, "stop"),
        "operator": Watchdog(0.5, "hand over"),
        "autonomy": Watchdog(0.5, "hand over"),
        "path_error": Watchdog(0.5, "hold"),
    }


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
            object.__setattr__(self, "wait", self.window)
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
