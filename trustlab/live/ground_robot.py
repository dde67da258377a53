"""
`tl.LiveGroundRobot`: a person drives the ground robot in a notebook; the kernel stays out of the
loop.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trustlab.allocation.limits import check_thresholds, threshold_limits, threshold_pair
from trustlab.live.attempt import Attempt
from trustlab.live.build import STATIC, WASM
from trustlab.live.runs import drive_config, warn_if_too_short
from trustlab.live.study.pages import read_words
from trustlab.models.checks import check_participant, flag, of_class, one_of
from trustlab.models.extras import extra
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session
from trustlab.testbeds.deciding import CONDITIONS, suggested_by_tsc

if TYPE_CHECKING:
    from trustlab.identification.result import FitResult

with extra("live"):
    import anywidget
    import traitlets


MODULES = (
    "page.js",
    "rows.js",
    "physics.js",
    "hands.js",
    "view.js",
    "drive.js",
    "pad.js",
    "steer.js",
    "widget.js",
)
"""The browser modules of the widget, each behind those that it imports."""


def module_of(*names: str) -> str:
    """Return browser modules of the package joined to one, as a notebook loads it."""
    text = "\n".join((STATIC / name).read_text(encoding="utf-8") for name in names)
    # What the modules import from each other stands in the joined one.
    return re.sub(r'^import .* from "\./[a-z_]+\.js";\n', "", text, flags=re.M)


def checked_thresholds(
    condition: str, model: TscModel, thresholds: Any
) -> tuple[float, float] | None:
    """
    Return the thresholds of a condition's suggestions within Theorem 1's limits; needed in C2 and
    C3, refused elsewhere.
    """
    if suggested_by_tsc(condition):
        if thresholds is None:
            raise ValueError(
                f"{condition} needs thresholds=(TSC_l, TSC_u): take those of "
                "trustlab.choose_thresholds(model)"
            )
        return check_thresholds(
            model, *threshold_pair("threshold", thresholds), threshold_limits(model)
        )
    if thresholds is not None:
        raise ValueError(f"thresholds have no effect in {condition}; leave them out")
    return None


class LiveWidget(anywidget.AnyWidget):
    """A task in a notebook, whose rows an attempt keeps."""

    _esm = module_of(*MODULES)
    config = traitlets.Dict().tag(sync=True)
    wasm = traitlets.Bytes().tag(sync=True)
    key = traitlets.Unicode().tag(sync=True)

    def __init__(self, attempt: Attempt, language: str):
        self.attempt = attempt
        config = {**attempt.config, "words": read_words(language)}
        wasm = b"" if config.get("served") else WASM.read_bytes()
        super().__init__(config=config, wasm=wasm, key=attempt.key)
        self.on_msg(self._answer)

    def _answer(self, _widget: Any, message: dict[str, Any], _buffers: Any) -> None:
        self.send({"id": message["id"]} | self.attempt.answer(message))

    @property
    def session(self) -> Session:
        """What has been driven so far."""
        return self.attempt.session

    @property
    def verified(self) -> bool:
        """Whether all rows so far are what numba computes from their commands."""
        return self.attempt.verified


class LiveGroundRobot(LiveWidget):
    """
    A drive of the ground robot by a person, in a notebook.

    The robot, its sensing and the suggestions are those of `run_condition`, computed in the browser
    by the same compiled steps; what is logged is replayed by numba, bit for bit. In C1 the person
    switches when they like; in C2 and C4 suggestions, by (2.8) and Algorithm 2, may be followed
    with the space bar; in C3 and C5 they are carried out 3 s later at the latest. As in
    `run_condition`, nobody switches in the first 100 s. The camera shows the posts of 4 m ahead,
    0.2 s late; the robot drives at most 0.5 m/s.

    Parameters
    ----------
    condition : {"C1", "C2", "C3", "C4", "C5"}
        Who allocates.
    model : TscModel
        What TSC (2.1) and suggestions come from: of the person, for example
        `fit_tsc(session).model`.
    thresholds : (float, float), optional
        TSC_l and TSC_u of (2.8), in C2 and C3 only.
    laps : int
        How many laps, at most 8. For a fit of the driver's model take 8, in a condition with both
        modes.
    participant : str or int
        Who drives.
    seed : int
        Of the robot's sensing.
    show_map : bool
        Whether a small map shows where the robot is; for experimenters, since it makes the task
        easier.
    folder : str or Path
        Where rows are kept: each is on the disk before the browser forgets it.
    language : {"en", "de"}
        Language of what the widget says.

    Attributes
    ----------
    session : Session
        What has been driven so far, also in mid-run; its metadata hold `verified`, pauses and the
        log period.
    verified : bool
        Whether all rows so far are, bit for bit, what numba computes from their commands.

    Raises
    ------
    ValueError
        If an argument is not understood, or thresholds lie outside the limits of Theorem 1.

    Notes
    -----
    After a restart of the kernel, run the cell again: rows that were on their way come back, and
    the drive goes on where it was. A finished drive is followed by a new attempt. Needs the extra
    `trustlab[live]`.

    Examples
    --------
    >>> import trustlab as tl
    >>> live = tl.LiveGroundRobot("C1", model=tl.published_models()["2"], laps=2, folder="live")
    >>> live.attempt.rows
    []
    """

    session = LiveWidget.session  # a member of its own has a place in the documentation

    def __init__(
        self,
        condition: str,
        model: TscModel | None = None,
        thresholds: tuple[float, float] | None = None,
        laps: int = 2,
        participant: str | int = "me",
        seed: int = 0,
        show_map: bool = False,
        folder: str | Path = "live",
        language: str = "en",
    ):
        one_of("condition", condition, CONDITIONS)
        model = of_class("model", model, TscModel)
        check_participant(participant)
        thresholds = checked_thresholds(condition, model, thresholds)
        config = drive_config(
            condition, model, thresholds, laps, seed, map=flag("show_map", show_map)
        )
        warn_if_too_short(config)
        self.model = model
        super().__init__(Attempt.of(folder, str(participant), config), language)

    def fit(self) -> "FitResult":
        """
        Identify the driver's model: `fit_tsc`, with what the drive leaves undetermined held at the
        values of `model`.

        Eight laps in both modes determine levels of performance and hardly a time constant:
        `fit_tsc(live.session)` marks the others weak. Here what it calls weak or at its bound is
        held and the rest fitted again, as for a participant of `LiveStudy`; the table of parameters
        says which ("fixed"). Two laps determine hardly anything: half of them passes until the
        window of (2.4) is full.

        Raises
        ------
        IdentificationError
            If no level of performance remains that is the driver's own.
        """
        from trustlab.live.fit import fit_holding  # compiles only where it is called

        return fit_holding(self.session, self.model)
