"""The three tasks as widgets of a notebook: the page sends commands, the kernel does them."""

import itertools
import json
import os
import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar
from weakref import WeakValueDictionary

import pandas as pd

from trustlab.allocation.limits import check_thresholds
from trustlab.live.condition import LiveCondition, given_thresholds
from trustlab.live.log import LogError
from trustlab.live.study.pages import read_words
from trustlab.live.task import LiveTask, prepare
from trustlab.live.tasks import ground_robot, team, teleoperation
from trustlab.live.tasks.ground_robot import DriveSettings
from trustlab.live.tasks.team import LeadingSettings
from trustlab.live.tasks.teleoperation import TeleoperationSettings
from trustlab.live.trial import Trial, read_record
from trustlab.models.checks import check_participant, of_class, one_of, whole_number, whole_seed
from trustlab.models.digest import digest
from trustlab.models.extras import extra
from trustlab.models.files import path_of, writing
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session
from trustlab.teleoperation.loop.settings import (
    Guidance,
    LoopSettings,
    Scheme,
    scheme_named,
    study_named,
)
from trustlab.teleoperation.team.decisions import LeaderPolicy, policy_named
from trustlab.testbeds.deciding import CONDITIONS
from trustlab.testbeds.uav_tracking import TrackingTask

if TYPE_CHECKING:
    from trustlab.identification.result import FitResult

with extra("live"):
    import anywidget
    import traitlets

STATIC = Path(__file__).parent / "static"
MODULES = (
    "page.js",
    "pad.js",
    "hands.js",
    "view.js",
    "tasks.js",
    "playout.js",
    "socket.js",
    "play.js",
    "widget.js",
)
"""The browser modules of the widget, each behind those that it imports."""

FACTS = {
    "robot": "simulated",
    "note": "a person's hand on a simulated haptic device, channel and robot; forces are shown as "
    "cues and not felt",
    "cues": "visual cue; with a gamepad, vibration cue",
}
"""What metadata say of flights in a notebook."""


def module_of(*names: str) -> str:
    """Return browser modules of the package joined to one, as a notebook loads it."""
    text = "\n".join((STATIC / name).read_text(encoding="utf-8") for name in names)
    # What the modules import from each other stands in the joined one.
    return re.sub(r'^import [^"]* from "\./[a-z_]+\.js";\n', "", text, flags=re.M)


def goes_on(path: Path, settings: dict, participant: str) -> bool:
    """Whether a log is missing, or holds the beginning of a run with these settings."""
    if not path.exists() or not path.stat().st_size:
        return True
    record, _, _ = read_record(path)
    same = record is not None and record.header.get("participant") == participant
    return same and record.settings == settings and not record.end and not record.other_maker


def place_of(settings: dict, participant: str) -> Path:
    """
    Return the log of a run with these settings that is not over, or a new one, under the user's
    state folder.
    """
    home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    text = digest(json.dumps([settings, participant], sort_keys=True))[:12]
    name = f"trustlab/live/{settings['condition']}-{text}"
    paths = (Path(home, f"{name}-{number}.jsonl") for number in itertools.count(1))
    return next(path for path in paths if goes_on(path, settings, participant))


class LiveWidget(anywidget.AnyWidget):
    """A task in a notebook: a trial, and the page that commands it."""

    _esm = module_of(*MODULES)
    words = traitlets.Dict().tag(sync=True)
    path = traitlets.Unicode().tag(sync=True)
    trials: ClassVar = WeakValueDictionary()

    def __init__(
        self,
        task: LiveTask,
        settings: dict,
        participant: str | int,
        log: str | Path | None,
        language: str = "en",
    ):
        check_participant(participant)
        self.participant = str(participant)
        settings = json.loads(json.dumps(settings))  # as it will be read again
        path = path_of("log", place_of(settings, self.participant) if log is None else log)
        path = path.absolute()
        with writing(path):
            self.trial = self._trial(path, task, settings)
        super().__init__(words=read_words(language), path=str(path))
        self.on_msg(self._answer)

    def _trial(self, path: Path, task: LiveTask, settings: dict) -> Trial:
        """Return the trial of a log, which goes on where a cell is run again."""
        path.parent.mkdir(parents=True, exist_ok=True)
        if not goes_on(path, settings, self.participant):
            raise ValueError(f"{path} holds another run, or one that is over; name another log")
        trial = self.trials.get(path) if path.exists() else None
        if trial is None:
            prepare(task, settings)
            try:
                trial = Trial(path, task, settings, participant=self.participant)
            except LogError as error:
                raise ValueError(
                    f"{error}; shut the other kernel down, or name another log: log='….jsonl'"
                ) from error
            self.trials[path] = trial
        return trial

    def _answer(self, _widget: Any, message: dict, _buffers: Any) -> None:
        try:
            if "end" in message:
                self.trial.finish("stopped by the person")
            answer = self.trial.take(message)
        except OSError as error:
            answer = {"trouble": f"The log cannot be written: {error.strerror or error}."}
        except ValueError as error:
            answer = {"refused": str(error)}
        if "begin" in message:
            answer["config"] = self.trial.settings | {"words": self.words}
        self.send(answer)

    @property
    def session(self) -> Session:
        """What has been done so far."""
        return self.trial.session(participant=self.participant)

    @property
    def verified(self) -> bool:
        """Whether a replay of the log's commands gives its rows."""
        return bool(self.trial.rows) and not self.trial.fault


class LiveGroundRobot(LiveWidget):
    """
    A drive of the ground robot by a person, in a notebook.

    The robot, its sensing and the suggestions are those of `run_condition`, and stay in the kernel;
    the page sends commands and draws. In C1 the person switches when they like; in C2 and C4
    suggestions, by (2.8) and Algorithm 2, may be followed with the space bar; in C3 and C5 they are
    carried out 3 s later at the latest. As in `run_condition`, nobody switches in the first 100 s.
    The camera shows the posts of 4 m ahead, 0.2 s late, or as late as the kernel answers; the robot
    drives at most 0.5 m/s.

    Parameters
    ----------
    condition : {"C1", "C2", "C3", "C4", "C5"} or LiveCondition
        Who allocates.
    model : TscModel
        What TSC (2.1) and suggestions come from: of the person, for example
        `fit_tsc(session).model` of a log with a sample time of 0.1 s.
    thresholds : (float, float), optional
        TSC_l and TSC_u of (2.8), in C2, C3 and conditions of your own with suggestions by TSC only.
    laps : int
        How many laps, at most 8. For a fit of the driver's model take 8, in a condition with both
        modes.
    participant : str or int
        Who drives.
    seed : int
        Of the robot's sensing.
    log : path-like, optional
        The file of the run's log; one under the user's state folder when not given. Each command
        is on the disk before it is done.
    language : {"en", "de"}
        Language of what the widget says.

    Attributes
    ----------
    session : Session
        What has been driven so far, also in mid-run; its metadata hold `verified`, pauses and the
        log period.
    verified : bool
        Whether a replay of the log's commands gives its rows.
    path : str
        The log.

    Raises
    ------
    ValueError
        If an argument is not understood, thresholds lie outside the limits of Theorem 1, or the log
        holds another run.

    Notes
    -----
    After a restart of the kernel, run the cell again: the drive goes on where it was. A finished
    drive is followed by a new one. While another cell computes, the drive stands still. Needs the
    extra `trustlab[live]`.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> log = tempfile.mkdtemp() + "/drive.jsonl"
    >>> live = tl.LiveGroundRobot("C1", model=tl.published_models()["2"], laps=2, log=log)
    >>> live.trial.rows
    []
    """

    session = LiveWidget.session  # a member of its own has a place in the documentation

    def __init__(
        self,
        condition: str | LiveCondition,
        model: TscModel | None = None,
        thresholds: tuple[float, float] | None = None,
        laps: int = 2,
        participant: str | int = "me",
        seed: int = 0,
        log: str | Path | None = None,
        language: str = "en",
    ):
        own = condition if isinstance(condition, LiveCondition) else None
        name = own.name if own else one_of("condition", condition, CONDITIONS, "a LiveCondition")
        self.model = of_class("model", model, TscModel)
        pair = given_thresholds(name, thresholds, own)
        pair = (0.0, 0.0) if pair is None else check_thresholds(self.model, pair)
        seed = whole_seed(seed, 2**53 - 1)  # JSON keeps no larger one
        content = DriveSettings(laps=whole_number("laps", laps, most=8)).as_json()
        content["own_conditions"] = {own.name: asdict(own)} if own else {}
        known = {"model": asdict(model), "thresholds": pair}
        config = ground_robot.drive_config(content, name, seed, known)
        ground_robot.warn_if_too_short(config)
        super().__init__(ground_robot.TASK, config, participant, log, language)

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


class LiveTracking(LiveWidget):
    """
    A person flies the UAV that follows a target, in a notebook.

    The person's hand is the pointer in a square, a finger or a gamepad's stick. A simulated spring
    and damper (the hand of `Teleoperator`, without its motor noise) holds a simulated two-axis
    haptic device there; device, channel, robot and the ledger of energy are those of
    `TeleoperationLoop` and stay in the kernel. Nothing is felt. The guiding force that the device
    would give is shown as a *visual cue*, an arrow (the column `guide`) and a drawn spring from
    hand to device; and as a *vibration cue* of a gamepad. The ledger is that of the
    simulated device.

    Parameters
    ----------
    scheme : {"M", "MI", "MMI", "TMIG", "TMIS", "OMI"} or Scheme
        Who sets the scales, as of `TeleoperationLoop`; in MMI the mouse wheel or the right trigger
        allocates.
    study : {"preliminary", "main"} or LoopSettings
        Printed settings, or own ones.
    guidance : {"at_operator", "through_channel"} or Guidance
        How the guiding force reaches the device, and what keeps it passive.
    delay : float, callable, Delay, or a pair of these, optional
        Delay both ways [s], or (to the robot, back); random walks of the study when not given. The
        kernel's round trip comes on top.
    seed : int
        Of the path's start, losses of the target, and delays.
    duration : float
        When the run ends [s], 1 to 3600; pauses do not count.
    participant : str or int
        Who flies.
    task : TrackingTask, optional
        The target; the study's own when not given. With `view`, the target can leave the picture,
        and is not shown then.
    log : path-like, optional
        The file of the run's log; one under the user's state folder when not given.

    Attributes
    ----------
    session : Session
        What has been flown so far, at 20 Hz: hand, robot, target, forces, performance, shares,
        trust and energies. Not synthetic, for a person flew; its metadata say that the robot is
        simulated.
    energy : pandas.DataFrame
        The ledger [J]: the session's columns of energies.
    verified : bool
        Whether a replay of the log's commands gives its rows.
    path : str
        The log.

    Raises
    ------
    ValueError
        If an argument is not understood, or the log holds another run.

    Notes
    -----
    The page sends the hand's place 20 times a second, and draws pictures as late as the task's
    camera is, or as late as the kernel answers: the log holds which picture was seen with each
    command. As long as the kernel is busy with another cell the flight stands still; after a
    restart of the kernel, run the cell again and start, and it goes on where it was. The device
    moves on two horizontal axes; at the edge of the square the hand asks for twice the largest
    command of the study's simulated operators. Needs the extra `trustlab[live]`.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> live = tl.LiveTracking("M", seed=0, log=tempfile.mkdtemp() + "/flight.jsonl")
    >>> answer = live.trial.take({"begin": True})  # as its page would say it
    >>> answer = live.trial.take({"k": 0, "seen": 0, "commands": [[0.4, 0.0, -1.0]] * 10})
    >>> answer["k"], live.session.duration, live.verified
    (10, 0.45, True)
    """

    session = LiveWidget.session  # a member of its own has a place in the documentation

    def __init__(
        self,
        scheme: str | Scheme = "TMIG",
        study: str | LoopSettings = "main",
        guidance: str | Guidance = "at_operator",
        delay: Any = None,
        seed: int = 0,
        duration: float = 120.0,
        participant: str | int = "me",
        task: TrackingTask | None = None,
        log: str | Path | None = None,
    ):
        self.scheme, loop = scheme_named(scheme), study_named(study)
        if task is not None:
            of_class("task", task, TrackingTask)
        given = {"scheme": scheme, "study": study, "guidance": guidance, "task": task}
        parts = {name: part for name, part in given.items() if not isinstance(part, str | None)}
        if delay is not None:
            parts["delay"] = delay
        where = guidance.where if isinstance(guidance, Guidance) else guidance
        settings = TeleoperationSettings(duration=duration, study=loop.study, guidance=where)
        seed = whole_seed(seed, 2**32 - 1)
        config = teleoperation.flight_config(settings.as_json(), self.scheme.name, seed, task=task)
        # What parts of your own are recognized by after a restart of the kernel, where they lie
        # elsewhere in memory.
        texts = {name: str(getattr(part, "__qualname__", part)) for name, part in parts.items()}
        names = {name: re.sub(" at 0x[0-9a-f]+", "", text) for name, text in texts.items()}
        facts = {"scheme": self.scheme.title.replace("force feedback", "cues"), **FACTS}
        config |= {"parts": names, "facts": facts}
        super().__init__(teleoperation.task_of(**parts), config, participant, log)

    @property
    def energy(self) -> pd.DataFrame:
        """The ledger of the simulated device, channel and robot [J]."""
        return self.session.data.filter(like="energy_")


class LiveTeam(LiveWidget):
    """
    A person leads a team of three to six robots to goals, in a notebook.

    The person pulls the robot that leads; the others follow it by (4.22), and the robots differ in
    speed, lost packets and drift. Trust (4.1) in each robot comes from how it moves. Whoever leads
    does so for τ_min at least. Physics is that of `TeamLoop` and stays in the kernel; each command
    is on the disk before it is done. Nothing is felt: the force is an arrow, a visual cue, and the
    vibration of a gamepad, a vibration cue without a direction.

    Parameters
    ----------
    condition : {"by_hand", "most_trusted", "hysteresis", "suggested"} or LeaderPolicy
        Who chooses the leader: the person, with the keys 1 to N; a policy, which may be your own;
        or the person, to whom the policy with hysteresis suggests one that the space bar accepts.
    settings : LeadingSettings, optional
        Robots, goals, length and τ_min.
    participant : str or int
        Who leads.
    seed : int
        Of start, goals, and which robot can do what.
    log : path-like, optional
        The file of the run's log; one under the user's state folder when not given.
    language : {"en", "de"}
        Language of what the widget says.

    Attributes
    ----------
    session : Session
        What has been done so far, at 20 Hz: hand, leader, choice and suggestion, whom each policy
        would pick, trust in each robot, distance to the goal, force.
    verified : bool
        Whether a replay of the log's commands gives its rows.
    path : str
        The log.

    Raises
    ------
    ValueError
        If an argument is not understood, or the log holds another run.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> live = tl.LiveTeam("by_hand", seed=0, log=tempfile.mkdtemp() + "/team.jsonl")
    >>> live.trial.rows
    []
    """

    session = LiveWidget.session  # a member of its own has a place in the documentation

    def __init__(
        self,
        condition: str | LeaderPolicy = "by_hand",
        settings: LeadingSettings | None = None,
        participant: str | int = "me",
        seed: int = 0,
        log: str | Path | None = None,
        language: str = "en",
    ):
        task, parts = team.TASK, {}
        if hasattr(condition, "leader"):
            policy = policy_named(condition)
            condition, task, parts = "own", team.task_of(policy), {"policy": policy.title}
        else:
            one_of("condition", condition, task.conditions, also="a LeaderPolicy")
        settings = LeadingSettings() if settings is None else settings
        content = of_class("settings", settings, LeadingSettings).as_json()
        seed = whole_seed(seed, 2**32 - 1)
        config = team.team_config(content, condition, seed)
        config |= {"parts": parts, "late": settings.least_delay}
        config["facts"] |= parts
        super().__init__(task, config, participant, log, language)
