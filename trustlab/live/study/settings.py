"""How long people drive in a study, where, and whose model stands in for theirs."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from trustlab.allocation.limits import check_thresholds
from trustlab.live.task import MOST_DELAY
from trustlab.models.checks import between, of_class, positive, shown, whole_number
from trustlab.models.tsc import HumanModel, RobotModel, TscModel
from trustlab.testbeds.ground_robot.course import Course
from trustlab.testbeds.ground_robot.pioneer import Pioneer
from trustlab.testbeds.populations import published_model, published_thresholds

IDENTIFICATION = ((1, 200.0), (0, 200.0), (1, 150.0), (0, 150.0), (1, 150.0), (0, 150.0))
"""
Modes of the identification drive and how long each lasts [s]: Section 2.2.2's manual, autonomous
and mixed phases, in 17 minutes.
"""

STAND_IN = "2"
"""
The printed participant whose model and thresholds stand in where an identification drive says too
little.
"""


@dataclass(frozen=True)
class DriveSettings:
    """
    The drives of a live study: their length, the course, the robot, and the stand-in model.

    `LiveStudy` takes these settings as keywords, or a `DriveSettings` as `drives`.

    Parameters
    ----------
    laps : int
        Laps of each drive under a condition; 8 as printed.
    training : float
        Length of the training drive [s].
    identification : sequence of (int, float)
        Mode (1 manual, 0 autonomous) and length [s] of each phase of the identification drive.
    model : TscModel, optional
        What stands in for a participant's own model where the identification drive does not
        determine it; that of the printed participant 2 by default.
    thresholds : (float, float), optional
        TSC_l and TSC_u that go with `model`; those of Table 2.2 by default.
    course : Course, optional
        The course; that of the ground robot's testbed by default.
    robot : Pioneer, optional
        The robot; by default that of the testbed, not faster than 0.5 m/s.
    least_delay : float
        How late pictures are shown at least [s], so that connections make no difference among
        people; the camera's delay counts where it is longer.

    Raises
    ------
    ValueError
        If a value is not understood.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> drives = tl.DriveSettings(laps=4, training=60.0)
    >>> folder = tempfile.mkdtemp() + "/rehearsal"
    >>> tl.LiveStudy(folder, ["C1", "C3"], 4, drives=drives, rehearsal=True)
    LiveStudy('rehearsal': 4 participants, C1, C3)
    """

    laps: int = 8
    training: float = 120.0
    identification: Sequence[tuple[int, float]] = IDENTIFICATION
    model: TscModel | None = None
    thresholds: tuple[float, float] | None = None
    course: Course | None = None
    robot: Pioneer | None = None
    least_delay: float = 0.0

    def __post_init__(self):
        if (self.model is None) != (self.thresholds is None):
            raise ValueError("model and thresholds belong together; give both or neither")
        self.as_json()

    def as_json(self) -> dict:
        """Return the settings as plain values for `study.json`."""
        model = self.model or published_model(STAND_IN)
        pair = self.thresholds or published_thresholds(STAND_IN)
        pair = check_thresholds(model, pair)
        return {
            "laps": whole_number("laps", self.laps, most=1000),
            "training": positive("training", self.training),
            "least_delay": between("least_delay", self.least_delay, 0.0, MOST_DELAY),
            "identification": _schedule(self.identification),
            "stand_in": {"model": asdict(model), "thresholds": pair},
            "course": _fields("course", self.course, Course),
            "robot": _fields("robot", self.robot, Pioneer),
        }


def model_of(content: dict) -> TscModel:
    """Return a model from what `asdict` made of it."""
    return TscModel(RobotModel(**content["robot"]), HumanModel(**content["human"]))


def _fields(name: str, part: Any, kind: type) -> dict | None:
    """Return what a course or a robot was made from; None for the usual one."""
    if part is None:
        return None
    of_class(name, part, kind)
    return {field: value for field, value in asdict(part).items() if not field.startswith("_")}


def _schedule(phases: Any) -> list[list[float]]:
    """Return the phases of the identification drive, checked: each of the modes must be driven."""
    try:
        pairs = [(mode, seconds) for mode, seconds in phases]
    except (TypeError, ValueError):
        raise ValueError(
            f"identification must be a list of (mode, seconds), got {shown(phases)}"
        ) from None
    checked = [
        [whole_number("a mode of identification", mode, 0, 1), positive("its seconds", seconds)]
        for mode, seconds in pairs
    ]
    if {mode for mode, _ in checked} != {0, 1}:
        raise ValueError("identification must have phases of both modes, 1 manual and 0 autonomous")
    return checked
