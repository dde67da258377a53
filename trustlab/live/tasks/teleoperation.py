"""Shared teleoperation as a live task: a UAV after its target, under the schemes of Chapter 3."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from trustlab.live.hands import TrackingHand
from trustlab.live.task import (
    PERIOD,
    HandSettings,
    LiveTask,
    force_shown,
    hand_config,
    trust_of,
)
from trustlab.models.checks import one_of
from trustlab.models.simulation import DivergenceError, PartError
from trustlab.operators.teleoperator import REACH, Teleoperator
from trustlab.sessions.session import Session
from trustlab.teleoperation.loop.kernel import GUIDANCE
from trustlab.testbeds.uav_tracking import TASKS, TeleoperationLoop, TrackingTask

COMMANDS = ("pointer_x", "pointer_y", "alpha_choice")
VECTORS = ("robot", "reference", "guide", "f_m")
NUMBERS = (
    "path_error",
    "p_r",
    "p_h",
    "alpha",
    "beta",
    "trust_hr",
    "trust_rh",
    "energy_operator",
    "energy_channel",
    "energy_robot",
    "energy_port",
)
COLUMNS = (*COMMANDS, *(f"{name}_{axis}" for name in VECTORS for axis in "xy"), *NUMBERS)

DEFLECTION = 2.0
"""
At the edge of the hand's square the command is so many times the largest one of the study's
simulated operators.
"""

UNBOUNDED = 1e6
"""The `view` of a task whose camera always has its target in the picture [m]."""


@dataclass(frozen=True, kw_only=True)
class TeleoperationSettings(HandSettings):
    """
    The flights of a live study of shared teleoperation.

    Parameters
    ----------
    duration : float
        Length of each flight under a scheme [s].
    training : float
        Length of the training flight, in M [s].
    study : {"main", "preliminary"}
        Printed settings of device, channel, trust and target.
    guidance : {"at_operator", "through_channel"}
        How the guiding force reaches the device.
    least_delay : float
        How late pictures are shown at least [s], so that connections make no difference among
        people; the camera's delay counts where it is longer.
    trust : TrustDynamics or TrustInLoop, optional
        One of `trustlab.trust.MODELS` in place of (3.2).

    Raises
    ------
    ValueError
        If a value is not understood.

    Examples
    --------
    >>> from trustlab.live import TeleoperationSettings
    >>> TeleoperationSettings(duration=60.0).duration
    60.0
    """

    study: str = "main"
    guidance: str = "at_operator"

    def __post_init__(self):
        one_of("study", self.study, TASKS)
        one_of("guidance", self.guidance, GUIDANCE)
        super().__post_init__()


class LiveFlight:
    """A flight, stepped by a hand's place in its square and, in MMI, the share it allocates."""

    def __init__(self, config: dict, **parts: Any):
        task, reach = TASKS[config["study"]], REACH[config["study"]]
        arguments = {name: config[name] for name in ("scheme", "study", "guidance", "seed")}
        arguments |= {"trust": trust_of(config), "duration": config["samples"] * PERIOD}
        arguments |= {"operator": Teleoperator("live", reach=reach, noise=0.0), "task": task}
        self.loop = TeleoperationLoop(**{**arguments, **parts})
        self.settings, self.task = self.loop.settings, self.loop.task
        self.reach = DEFLECTION * reach / np.broadcast_to(self.settings.weight, 3)[:2]
        self.samples = config["samples"]
        self.every = round(PERIOD / self.settings.sample_time)
        self.periods = 0
        self.share = config["limits"]["alpha_choice"][1]
        self.last: Any = None
        self.values = [0.0] * (len(COLUMNS) - len(COMMANDS))
        self.failed = ""

    @property
    def done(self) -> bool:
        """Whether the flight is at its end; one that diverged stands still until then."""
        return self.periods >= self.samples

    def step(self, *command: float) -> list[float]:
        """Fly one period; a share below 0 is left to the scheme."""
        x, y, self.share = command
        ends = self.settings.scattering
        alpha = None
        if self.share >= 0.0:
            alpha = ends.alpha_min + self.share * (ends.alpha_max - ends.alpha_min)
        hand = np.array([x * self.reach[0], y * self.reach[1], 0.0])
        try:
            for _ in range(0 if self.failed else self.every):
                self.loop.step(hand=hand, alpha=alpha)
        except (DivergenceError, PartError) as error:
            self.failed = str(error)  # the row of before stays
        else:
            run = self.loop.simulation
            self.last = run.log[run.done - 1]
            vectors = np.concatenate([self.last[name][:2] for name in VECTORS])
            self.values = [*vectors.tolist(), *(float(self.last[name]) for name in NUMBERS)]
        self.periods += 1
        return [*command, *self.values]

    def picture(self) -> dict:
        """Return what the page draws: what the camera sees now, the device and the forces."""
        about: dict = {"share": self.share}
        if self.failed:  # its numbers may be infinite
            return about | {"over": self.failed}
        if self.last is None:
            nothing = [0.0, 0.0]
            return about | dict.fromkeys(("target", "robot", "device", "force", "guide"), nothing)
        now, scaling = self.last, -self.settings.force_scaling
        error = now["error"][:2]
        places = {
            "target": error,
            "robot": now["robot"][:2],
            "device": now["device"][:2] / self.reach,
            "force": scaling * now["f_m"][:2],
            "guide": scaling * now["guide"][:2],
        }
        shown = about | {name: np.round(place, 5).tolist() for name, place in places.items()}
        seen = bool((np.abs(error) <= self.task.view).all())
        return shown if seen else shown | {"target": None}


def flight_config(
    content: dict,
    condition: str,
    seed: int,
    known: dict | None = None,
    task: TrackingTask | None = None,
) -> dict:
    """Return the settings of a flight after the study's target, or one of your own."""
    allocates = condition == "MMI"
    task = task or TASKS[content["study"]]
    return hand_config(
        "teleoperation",
        content,
        condition,
        seed,
        [0.0, 1.0] if allocates else [-1.0, -1.0],
        scheme="M" if condition == "training" else condition,
        allocates=allocates,
        study=content["study"],
        guidance=content["guidance"],
        half=task.view if task.view < UNBOUNDED else task.size_x,
        columns=COLUMNS,
        late=task.camera_delay,
    )


def flight_measures(session: Session) -> dict[str, float]:
    """
    Return the means of error, performance and shares, the root mean square of the force shown and
    the energy that the hand gave.
    """
    measures = {name: float(session[name].mean()) for name in NUMBERS[:5]}
    measures["worst_error"] = float(session["path_error"].max())
    measures["force"] = force_shown(session)
    measures["energy_operator"] = float(session["energy_operator"][-1])
    return measures


TASK = LiveTask(
    name="teleoperation",
    conditions=("M", "MI", "MMI", "TMIG", "OMI"),
    reported=("path_error", "p_r", "p_h", "alpha", "force"),
    settings=TeleoperationSettings,
    config=flight_config,
    begin=LiveFlight,
    hand=TrackingHand,
    measures=flight_measures,
)


def task_of(**parts: Any) -> LiveTask:
    """Return the task with parts of your own in place of the study's: scheme, task, delay, …."""
    return replace(TASK, begin=partial(LiveFlight, **parts))
