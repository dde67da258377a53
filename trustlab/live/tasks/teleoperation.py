"""Shared teleoperation as a live task: a UAV after its target, under the schemes of Chapter 3."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from trustlab.live.flight import UNBOUNDED, Flight
from trustlab.live.tasks.browser import offset, plan_of
from trustlab.live.tasks.flown import ADDRESSES, HAND, SAMPLE
from trustlab.live.tasks.task import PERIOD, LiveTask, trust_as_json, trust_of
from trustlab.models.checks import between, one_of
from trustlab.models.simulation import DivergenceError
from trustlab.operators.teleoperator import REACH, Teleoperator
from trustlab.sessions.session import Session
from trustlab.testbeds.uav_tracking import TASKS

SCHEMES = ("M", "MI", "MMI", "TMIG", "OMI")
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

GAIN = 0.5
"""Deflection of a scripted hand for a distance to the target [1/m]."""


@dataclass(frozen=True)
class TeleoperationSettings:
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

    duration: float = 120.0
    training: float = 60.0
    study: str = "main"
    guidance: str = "at_operator"
    trust: Any = None

    def __post_init__(self):
        one_of("study", self.study, TASKS)
        trust_as_json(self.trust)
        between("duration", self.duration, 1.0, 3600.0)
        between("training", self.training, 1.0, 3600.0)

    def as_json(self) -> dict[str, Any]:
        """Return the settings as plain values for `study.json`."""
        plain = {each.name: getattr(self, each.name) for each in fields(self)}
        return plain | {"trust": trust_as_json(self.trust)}


class LiveFlight:
    """A flight, stepped by a hand's place in its square and, in MMI, the share it allocates."""

    def __init__(self, config: Mapping[str, Any]):
        task = TASKS[config["study"]]
        operator = Teleoperator("live", reach=REACH[config["study"]], noise=0.0)
        arguments = {name: config[name] for name in ("scheme", "study", "guidance", "seed")}
        arguments |= {"trust": trust_of(config), "duration": config["samples"] * PERIOD}
        self.flight = Flight({**arguments, "operator": operator, "task": task})
        self.samples = config["samples"]
        self.periods = 0
        self.every = round(config["sample_time"] / self.flight.sample_time)
        ends = self.flight.settings.scattering
        self.bounds = ends.alpha_min, ends.alpha_max
        self.values = [0.0] * (len(COLUMNS) - len(COMMANDS))
        self.failed = ""

    @property
    def done(self) -> bool:
        """Whether the flight is at its end; one that diverged stands still until then."""
        return self.periods >= self.samples

    def step(self, *command: float) -> list[float]:
        """Fly one period; a share below 0 is left to the scheme."""
        x, y, choice = command
        low, high = self.bounds
        alpha = None if choice < 0.0 else low + choice * (high - low)  # as flown.fly_there does
        try:
            if not self.failed:
                self._fly(x, y, alpha)
        except DivergenceError as error:
            self.failed = str(error)  # the row of before stays
        self.periods += 1
        return [x, y, choice, *self.values]

    def _fly(self, x: float, y: float, alpha: float | None) -> None:
        """Fly the samples of a period, and keep what the row holds."""
        for _ in range(self.every):
            row = self.flight.sample(self.flight.held(x, y), alpha)
        vectors = [float(row[name][axis]) for name in VECTORS for axis in (0, 1)]
        self.values = [*vectors, *(float(row[name]) for name in NUMBERS)]

    def picture(self) -> dict[str, Any]:
        """Return what the page draws."""
        if self.failed:  # its numbers may be infinite
            return {"t": self.periods * PERIOD, "over": self.failed}
        return self.flight.shown()

    def memory(self) -> dict[str, Any]:
        """
        Return the loop's arrays as a browser needs them, and where in them stands what it logs and
        shows.
        """
        flight, loop = self.flight, self.flight.loop
        run, reach = loop.simulation, flight.reach.tolist()
        optimal = loop.scheme.shares == "optimal"
        arrays = {
            **run.setup._asdict(),
            **run.state._asdict(),
            "inputs": run.inputs,
            "log": run.log,
        }
        arrays["hand"] = np.array([(*reach, *self.bounds, run.log.size, optimal)], HAND)
        vectors = [offset(SAMPLE, name) + 8 * axis for name in VECTORS for axis in (0, 1)]
        return plan_of(arrays, ADDRESSES, WRITTEN) | {
            "row": SAMPLE.itemsize,
            "logged": vectors + [offset(SAMPLE, name) for name in NUMBERS],
            "shown": [offset(SAMPLE, name) for name in ("device", "f_m", "guide")],
            "seen": [offset(SAMPLE, name) for name in ("error", "robot")],
            "every": self.every,
            "late": flight.late,
            "view": flight.task.view,
            "reach": reach,
            "scaling": flight.settings.force_scaling,
        }


WRITTEN = ("sent", "log")
"""Arrays that are empty before a run."""


class TrackingHand:
    """A scripted hand that points where the camera shows the target, and the better half of α."""

    def __init__(self, by_hand: bool, rng: np.random.Generator):
        self.choice = 0.5 if by_hand else -1.0
        self.rng = rng
        self.gain = GAIN * rng.uniform(0.6, 1.4)

    def __call__(self, picture: Mapping[str, Any]) -> tuple[float, float, float]:
        """Return the command that follows a picture."""
        target = picture.get("target") or (0.0, 0.0)
        x, y = np.clip(self.gain * np.array(target) + 0.03 * self.rng.normal(size=2), -1.0, 1.0)
        return float(x), float(y), self.choice


class TeleoperationTask(LiveTask):
    """Flights after a target, under M, MI, MMI, TMIG and OMI."""

    name: ClassVar[str] = "teleoperation"
    conditions: ClassVar[tuple[str, ...]] = SCHEMES
    reported: ClassVar[tuple[str, ...]] = ("path_error", "p_r", "p_h", "alpha", "force")
    settings: ClassVar[type] = TeleoperationSettings

    def config(
        self, content: Mapping[str, Any], condition: str, known: Mapping[str, Any], seed: int
    ) -> dict[str, Any]:
        """Return the settings of a flight."""
        training = condition == "training"
        duration = content["training" if training else "duration"]
        scheme = "M" if training else condition
        view = TASKS[content["study"]]
        commands = list(COMMANDS)
        least, most = (0.0, 1.0) if scheme == "MMI" else (-1.0, -1.0)
        limits = {"pointer_x": [-1.0, 1.0], "pointer_y": [-1.0, 1.0], "alpha_choice": [least, most]}
        return {
            "live_task": self.name,
            "condition": condition,
            "scheme": scheme,
            "allocates": scheme == "MMI",
            "study": content["study"],
            "guidance": content["guidance"],
            "trust": content.get("trust"),
            "seed": seed,
            "sample_time": PERIOD,
            "samples": round(duration / PERIOD),
            "duration": duration,
            "half": view.view if view.view < UNBOUNDED else view.size_x,
            "columns": list(COLUMNS),
            "commands": commands,
            "served": content.get("trust") is not None,
            "limits": limits,
            "clock": "real",
            "hand": None,
        }

    def begin(self, config: Mapping[str, Any]) -> LiveFlight:
        """Return a flight at its beginning."""
        return LiveFlight(config)

    def memory(self, config: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the loop's arrays for a browser; a model of trust in it runs in Python alone."""
        return None if config["served"] else LiveFlight(config).memory()

    def hand(self, config: Mapping[str, Any], rng: np.random.Generator) -> TrackingHand:
        """Return a scripted hand."""
        return TrackingHand(config["allocates"], rng)

    def measures(self, session: Session) -> dict[str, float]:
        """
        Return the means of error, performance and shares, the root mean square of the force shown
        and the energy that the hand gave.
        """
        measures = {name: float(session[name].mean()) for name in NUMBERS[:5]}
        measures["worst_error"] = float(session["path_error"].max())
        square = session["f_m_x"] ** 2 + session["f_m_y"] ** 2
        measures["force"] = float(np.sqrt(square.mean()))
        measures["energy_operator"] = float(session["energy_operator"][-1])
        return measures


TASK = TeleoperationTask()
