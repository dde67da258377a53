"""
`tl.LiveTracking`: a person flies the UAV that follows a target; the simulated haptic device stays
in the kernel.
"""

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from trustlab.live.attempt import LATE
from trustlab.live.flight import UNBOUNDED, Flight
from trustlab.live.ground_robot import module_of
from trustlab.models.checks import between, finite_array, flag, not_negative, of_class
from trustlab.models.digest import digest
from trustlab.models.extras import extra
from trustlab.models.simulation import DivergenceError, PartError
from trustlab.operators.teleoperator import REACH, Teleoperator
from trustlab.sessions.session import Session
from trustlab.teleoperation.loop.settings import (
    Guidance,
    LoopSettings,
    Scheme,
    scheme_named,
    study_named,
)
from trustlab.testbeds.uav_tracking import TASKS, TeleoperationLoop, TrackingTask

with extra("live"):
    import anywidget
    import traitlets

SILENCE = 0.5
"""Where the page sends nothing for longer than this, the robot pauses [s]."""

LONGEST = 3600.0
"""The longest live run [s]."""

HAND = ("hand_x", "hand_y", "hand_z")
NOTE = (
    "a person's hand on a simulated haptic device, channel and robot; forces are shown as "
    "cues and not felt"
)


class HandDrivenLoop(Flight):
    """
    A teleoperation loop that advances by the times of the messages that bring a hand's position.
    """

    def __init__(self, duration: float, arguments: Mapping[str, Any]):
        super().__init__({**arguments, "duration": between("duration", duration, 1.0, LONGEST)})
        self.samples = self.loop.simulation.log.size
        self.hands: list[tuple[float, float, float]] = []
        self.notes: list[str] = []
        self.hand = (0.0, 0.0, 0.0)
        self.heard: float | None = (
            None  # the page's clock at its last message; None before the first and in a pause
        )
        self.elapsed = 0.0
        self.finished = False
        self.failed = False
        self.window = ""
        # A notebook's kernel may hear in one thread and show a session in another.
        self.lock = threading.RLock()

    def hear(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """
        Return the answer to a message: the beginning, a hand's position with its time, a pause, or
        the end.
        """
        window = str(message.get("window", ""))[:40]
        with self.lock:
            if "begin" in message:
                self.window = window
                self._resume(message["begin"])
            elif window != self.window:
                return {"refused": LATE}
            self._take(message)
            return self._shown()

    def _take(self, message: Mapping[str, Any]) -> None:
        if "hand" in message and not self.finished:
            x, y = finite_array("hand", message["hand"], length=2)
            if max(abs(x), abs(y)) > 1.0:
                raise ValueError(f"hand lies in the square [-1, 1] × [-1, 1], got ({x:g}, {y:g})")
            self._until(not_negative("time", message.get("time")))
            # from now on: samples before this message had the hand of the message before
            self.hand = self.held(x, y)
        elif "pause" in message and self.heard is not None:
            self._note(f"paused: {str(message['pause'])[:200]}")
            self.heard = None
        elif "end" in message:
            self._end(str(message["end"])[:200])

    def _resume(self, messages: Any) -> None:
        """
        Fly again what a page has kept of a flight that this kernel does not know: the same messages
        give the same samples, bit for bit.
        """
        if self.heard is not None or self.hands or not messages:
            return
        for message in messages:
            self._take(message)
        self._note("taken up again by a new kernel")
        self.heard = None

    def _until(self, time: float) -> None:
        """Advance to a time of the page's clock, or take up again there after a pause."""
        before, self.heard = self.heard, time
        if before is None:
            return
        gap = time - before
        if gap > SILENCE:
            return self._note(f"paused for {gap:.2f} s: nothing was heard")
        if gap < 0.0:
            return self._note("paused: the page began anew")
        self.elapsed += gap
        due = int(self.elapsed / self.sample_time + 1e-6)
        try:
            while len(self.hands) < min(due, self.samples):
                self._step()
        except (DivergenceError, PartError) as error:
            self.failed = True
            self._end(str(error))

    def _step(self) -> None:
        self.sample(self.hand)
        self.hands.append(self.hand)
        if len(self.hands) == self.samples:
            self._end("complete")

    def _note(self, text: str) -> None:
        self.notes.append(f"t = {self.loop.t:.2f} s: {text}")

    def _end(self, why: str) -> None:
        if not self.finished:
            self.finished = True
            self._note(f"ended: {why}")

    def _shown(self) -> dict[str, Any]:
        """Return what the page draws, and how the run ended."""
        if self.failed:  # its numbers may be infinite
            return {"over": self.notes[-1]}
        return {**self.shown(), "over": self.notes[-1] if self.finished else None}

    @property
    def rows(self) -> pd.DataFrame:
        """What has been logged so far, and the hand that each sample had."""
        if len(self.hands) < 2:
            raise ValueError("a session has at least two samples; wait until 0.02 s are flown")
        with self.lock:
            hands = np.array(self.hands, dtype=float)
            data = self.loop.session.data
        return data.assign(**{name: hands[:, i] for i, name in enumerate(HAND)})

    @property
    def verified(self) -> bool:
        """Whether a fresh loop gives the same bits under the logged hand."""
        if len(self.hands) < 2:
            return False
        again, rows = TeleoperationLoop(**self.arguments), self.rows
        try:
            for hand in rows[list(HAND)].to_numpy():
                again.step(hand=hand)
        except (DivergenceError, PartError):
            return False
        flown = rows.drop(columns=list(HAND))
        return again.session.data[list(flown)].to_numpy().tobytes() == flown.to_numpy().tobytes()


def checked_scheme(scheme: str | Scheme) -> Scheme:
    """
    Return a scheme that a person can drive; MMI's α would be set by a simulated operator's hand.
    """
    chosen = scheme_named(scheme)
    if chosen.name == "MMI" and not isinstance(scheme, Scheme):
        raise ValueError(
            "in MMI the operator allocates by hand, which a live run has no key for: drive M, "
            "MI, TMIG, TMIS or OMI, or give a trustlab.Scheme of your own"
        )
    return chosen


class LiveTracking(anywidget.AnyWidget):
    """
    A person flies the UAV that follows a target, in a notebook.

    The person's hand is the pointer in a square, a finger or a gamepad's stick. A simulated spring
    and damper (the hand of `Teleoperator`, without its motor noise) holds a simulated two-axis
    haptic device there; device, channel, robot and the ledger of energy are those of
    `TeleoperationLoop` and stay in the kernel. Nothing is felt. The guiding force that the device
    would give is shown as a *visual cue*, an arrow (the column `guide`, in a scale of its own,
    stated beside it) and a drawn spring from hand to device; and on wish as a *vibration cue* of
    the gamepad. The ledger is that of the simulated device.

    Parameters
    ----------
    scheme : {"M", "MI", "TMIG", "TMIS", "OMI"} or Scheme
        Who sets the scales, as of `TeleoperationLoop`; MMI, where the operator allocates by hand,
        is refused.
    study : {"preliminary", "main"} or LoopSettings
        Printed settings, or own ones.
    guidance : {"at_operator", "through_channel"} or Guidance
        How the guiding force reaches the device, and what keeps it passive.
    delay : float, callable, Delay, or a pair of these, optional
        Delay both ways [s], or (to the robot, back); random walks of the study when not given. The
        kernel's round trip comes on top.
    seed : int or numpy.random.SeedSequence
        Of the path's start, losses of the target, and delays.
    duration : float
        When the run ends [s], 1 to 3600; pauses do not count.
    participant : str or int
        Who flies.
    task : TrackingTask, optional
        The target; the study's own when not given. With `view`, the target can leave the picture,
        and is not shown then.
    vibration : bool
        Whether a gamepad rumbles with the size of the force: a vibration cue, without a direction.

    Attributes
    ----------
    session : Session
        What has been flown so far, also in mid-run, from two samples on: the columns of
        `simulate_teleoperation`, and `hand_x`, `hand_y` and `hand_z` [m], the hand that each sample
        had. Not synthetic, for a person flew; its metadata say that the robot is simulated, and
        hold notes of pauses and, at the end, `verified`.
    energy : pandas.DataFrame
        The ledger [J]: the session's columns of energies.
    verified : bool
        Whether a fresh loop with the same seed gives the same bits under the logged hand.

    Raises
    ------
    ValueError
        If an argument is not understood.

    Notes
    -----
    The page sends the hand's position with its time 30 times a second; the kernel advances by the
    samples of 0.01 s that have passed by the page's clock, each under the newest hand sent before
    it, and answers with what is to be drawn. A round trip takes 40 ms in the median on one machine,
    and as long as the kernel is busy with another cell nothing moves, unless it answers in a thread
    of its own, as ipykernel 7 does in JupyterLab: this is a delay in the eye, besides the camera's,
    which the log does not know. For studies of reaction times use `LiveGroundRobot`, which is
    computed in the browser.

    The device moves on two horizontal axes. The third is held at zero: no climb is commanded, and
    the UAV starts at the target's height, which does not change. At the edge of the square the hand
    asks for twice the largest command of the study's simulated operators. The run pauses while the
    page is hidden and where nothing was heard for 0.5 s. The page keeps what it has sent: after a
    restart of the kernel, run the cell again and start, and the flight goes on where it was. Needs
    the extra `trustlab[live]`.

    Examples
    --------
    >>> import trustlab as tl
    >>> live = tl.LiveTracking("M", seed=0, participant="me")
    >>> for time in (0.0, 0.25, 0.5):  # as a page would say it
    ...     answer = live.hear({"hand": [0.4, 0.0], "time": time})
    >>> live.session.duration, live.verified
    (0.49, True)
    """

    _esm = module_of("page.js", "rows.js", "pad.js", "tracking.js")
    config = traitlets.Dict().tag(sync=True)

    def __init__(
        self,
        scheme: str | Scheme = "TMIG",
        study: str | LoopSettings = "main",
        guidance: str | Guidance = "at_operator",
        delay: Any = None,
        seed: int | np.random.SeedSequence = 0,
        duration: float = 120.0,
        participant: str | int = "me",
        task: TrackingTask | None = None,
        vibration: bool = False,
    ):
        settings = study_named(study)
        arguments: dict[str, Any] = {
            "scheme": checked_scheme(scheme),
            "operator": Teleoperator(participant, reach=REACH[settings.study], noise=0.0),
            "study": settings,
            "seed": seed,
            "task": of_class("task", TASKS[settings.study] if task is None else task, TrackingTask),
            "guidance": guidance,
            "delay": delay,
        }
        self.vibration, self.run = flag("vibration", vibration), HandDrivenLoop(duration, arguments)
        target = self.run.task
        config = {
            "half": target.view if target.view < UNBOUNDED else target.size_x,
            "duration": self.run.samples * self.run.sample_time,
            "vibration": self.vibration,
            "key": f"flight/{digest(arguments['scheme'].name, self._settings(arguments))}",
        }
        super().__init__(config=config)
        self.on_msg(self._answer)

    def _settings(self, arguments: Mapping[str, Any]) -> str:
        """Return what a flight is recognized by after a restart of the kernel."""
        rest = [value for name, value in arguments.items() if name not in ("scheme", "delay")]
        delay = arguments["delay"]
        return repr((rest, getattr(delay, "__qualname__", delay), self.run.samples))

    def _answer(self, _widget: Any, message: dict[str, Any], _buffers: Any) -> None:
        self.send({"id": message.get("id")} | self.hear(message))

    def hear(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """
        Take one message of the page and return the answer.

        Parameters
        ----------
        message : mapping
            {"hand": [x, y], "time": seconds} with the hand in [−1, 1] on each axis, {"pause": why},
            {"end": why}, or {"begin": messages} with those of a flight that a kernel which is gone
            has heard. Each may have a "window": the one that began last flies.
        """
        return self.run.hear(message)

    @property
    def session(self) -> Session:
        """What has been flown so far."""
        run, rows = self.run, self.run.rows
        cues = "visual cue, vibration cue" if self.vibration else "visual cue"
        title = run.arguments["scheme"].title.replace("force feedback", "cues")
        facts = {"scheme": title, "robot": "simulated", "note": NOTE, "cues": cues}
        facts |= {"finished": run.finished, "notes": list(run.notes)}
        facts |= {"verified": self.verified} if run.finished else {}
        about = run.loop.session.metadata.changed(source="trustlab.live", synthetic=False, **facts)
        return Session(rows, about)

    @property
    def energy(self) -> pd.DataFrame:
        """The ledger of the simulated device, channel and robot [J]."""
        return self.run.rows.filter(like="energy_")

    @property
    def verified(self) -> bool:
        """Whether a fresh loop gives the same bits under the logged hand."""
        return self.run.verified
