"""
A UAV that follows a ground robot through a teleoperation loop: a simulated stand-in for Figs. 3.12
and 3.15.

The task (a target on a closed path, a controller that loses it, the vehicle flown), the loop that
is stepped or run, and what is drawn at random. One sample is `advance` in
`teleoperation/loop/kernel.py`; the state, and parts that a user may replace, are in `parts.py`
beside it.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    between,
    finite_array,
    finite_number,
    not_negative,
    of_class,
    one_of,
    positive,
    spawned,
)
from trustlab.models.uav import PRINTED_UAV, TransferFunction
from trustlab.operators.teleoperator import REACH, Teleoperator
from trustlab.sessions.session import Metadata, Session, keep_table
from trustlab.teleoperation.channel import lost_waves
from trustlab.teleoperation.delays import Delay, delays_in_samples, random_walk_delay
from trustlab.teleoperation.filters import first_order
from trustlab.teleoperation.loop import kernel
from trustlab.teleoperation.loop.parts import (
    AUTONOMY,
    COLUMNS,
    HISTORY,
    INPUT,
    LOG,
    PORTS,
    View,
    part_of,
)
from trustlab.teleoperation.loop.schemes import Scheme, by_hand, optimal, scheme_named
from trustlab.teleoperation.loop.settings import (
    DivergenceError,
    LoopSettings,
    PartError,
    blending_cost,
    setup_of,
    state_of,
    study_named,
    vehicle_matrices,
    vehicle_of,
)
from trustlab.teleoperation.ports.budget import GuidanceBudget
from trustlab.teleoperation.ports.ledger import READ_OUTS, accounts
from trustlab.teleoperation.ports.passivity import METHODS
from trustlab.teleoperation.records import filled, log_of, signal
from trustlab.trust.driving import TrustInLoop
from trustlab.trust.interface import TrustDynamics

NOTE = "simulated stand-in for the UAV testbeds of Figs. 3.12 and 3.15"
# How far ahead a loop that is stepped draws what comes from outside [s]; twice as far each time
# that it runs out.
BLOCK = 60.0
# How far away a live hand is taken to be at the most [m], far beyond any device.
FARTHEST_HAND = 10.0


def tracking_vehicle(bandwidth: float = 4.0) -> tuple[TransferFunction, ...]:
    """
    Return the UAV of (A.1) under a low-level velocity controller, as Section 3.6 assumes one.

    State feedback u = (ω² r − (ω² − d_0) v − (2ω − d_1) dv/dt)/gain puts both poles at −ω, and at
    −ω for order one. The printed PD controller of Appendix A does not stabilise (A.1) by itself on
    x and y.

    Parameters
    ----------
    bandwidth : float
        ω [1/s], positive.

    Raises
    ------
    ValueError
        If `bandwidth` is not positive, or above 1000.
    """
    omega = between("bandwidth", positive("bandwidth", bandwidth), 0.0, 1e3)
    return tuple(
        TransferFunction(omega, (omega,))
        if model.order == 1
        else TransferFunction(omega**2, (2.0 * omega, omega**2))
        for model in PRINTED_UAV.values()
    )


@dataclass(frozen=True)
class TrackingTask:
    """
    What the target does and what goes wrong on the way.

    Parameters
    ----------
    size_x, size_y : float
        Half lengths of the closed path [m].
    speed : float
        Mean speed of the target [m/s].
    failure_every, failure_length : float
        Mean time between losses of the target by the autonomous controller, and how long one lasts
        [s]; exponential.
    camera_delay : float
        How late pictures arrive at the operator and the controller [s].
    proportional, integral, derivative : float
        Gains of the hovering PID controller.
    reach : float
        Its largest command [m/s].
    view : float
        Half the width of the camera's picture [m], which shows operator and controller the target
        from above; without bound when not given (10⁶ m). A target that leaves it is lost until it
        is back: the operator looks where it was last seen, the controller hovers.

    Raises
    ------
    ValueError
        If a number is not finite or out of range.

    Examples
    --------
    >>> import trustlab as tl
    >>> calm = tl.TrackingTask(speed=0.1, failure_every=60.0)
    >>> run = tl.simulate_teleoperation("MI", task=calm, duration=5.0, seed=0)
    >>> run.duration
    4.99
    """

    size_x: float = 1.5
    size_y: float = 1.0
    speed: float = 0.2
    failure_every: float = 15.0
    failure_length: float = 4.0
    camera_delay: float = 0.1
    proportional: float = 1.0
    integral: float = 0.1
    derivative: float = 0.1
    reach: float = 1.5
    view: float = 1e6

    def __post_init__(self):
        may_be_zero = ("speed", "camera_delay", "proportional", "integral", "derivative")
        for name in self.__dataclass_fields__:
            check = not_negative if name in may_be_zero else positive
            object.__setattr__(self, name, check(name, getattr(self, name)))
        between("view", self.view, 0.0, 1e6)

    def controller(self, sample_time: float) -> np.void:
        """
        Return the autonomous controller as the compiled loop takes it.

        Parameters
        ----------
        sample_time : float
            T [s].
        """
        late = max(round(self.camera_delay / sample_time), 1)
        gains = {
            name: getattr(self, name)
            for name in ("proportional", "integral", "derivative", "reach")
        }
        return filled(AUTONOMY, **gains, picture=self.view, delay=late)

    def path(self, t: np.ndarray, height: float, phase: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return where the UAV should be and how fast that moves: a figure of eight at a height above
        the floor.

        Parameters
        ----------
        t : numpy.ndarray, shape (N,)
            Times [s].
        height : float
            z_d [m].
        phase : float
            Where on the path the target begins [rad].

        Returns
        -------
        position, velocity : numpy.ndarray, shape (N, 3)
            In m and m/s.
        """
        # for a root mean square speed of `speed`
        rate = self.speed / np.sqrt(0.5 * self.size_x**2 + 2.0 * self.size_y**2)
        turn = rate * t + phase
        x, y = self.size_x * np.sin(turn), self.size_y * np.sin(2 * turn)
        v_x = self.size_x * rate * np.cos(turn)
        v_y = 2 * self.size_y * rate * np.cos(2 * turn)
        position = np.column_stack([x, y, np.full(t.size, height)])
        return position, np.column_stack([v_x, v_y, np.zeros(t.size)])


TASKS = {
    "preliminary": TrackingTask(size_x=6.0, size_y=4.0, speed=0.8, camera_delay=0.2, reach=2.5),
    "main": TrackingTask(),
}
DELAYS = {"preliminary": (0.1, 0.8), "main": (0.03, 0.2)}


@dataclass(eq=False)
class TeleoperationLoop:
    """
    One operator, one robot and what is between them (Fig. 3.1), stepped or run.

    Parameters
    ----------
    scheme : {"M", "MI", "MMI", "TMIG", "TMIS", "OMI"} or Scheme
        Who sets the scales.
    operator : Teleoperator or callable, optional
        Who holds the device; an average one when not given. A function is the law of an average
        one: see `Teleoperator.law`.
    study : {"preliminary", "main"} or LoopSettings
        Printed settings, or own ones. Task, delays and reach of the operator are those of the study
        that `LoopSettings.study` names, where they are not given.
    seed : int or numpy.random.SeedSequence
        Streams for the path's start, losses of the target, motor noise and delays are spawned from
        it.
    sample_time : float
        T [s]; 0.01 as printed.
    task : TrackingTask, optional
        The target; the study's own when not given.
    delay : float, callable or Delay, optional
        Delay both ways [s], in place of `delay_1` and `delay_2`.
    delay_1, delay_2 : float, callable or Delay, optional
        Delay to the robot and back [s]; random walks of the study when not given. Both zero: no
        channel in between. A pair (sent, received) of times is a trace of packets, see
        `packet_delay`.
    read_out : {"ledger", "interpolated", "hold"}
        How delayed waves are read, see `channel_run`.
    guidance : {"at_operator", "through_channel"}
        How the guiding force reaches the operator. "at_operator": β times the force is rendered at
        the haptic device, from the camera's picture; it spends energy that the operator's port has
        earned, and the robot does what the operator commands. "through_channel": as printed, the
        force is at the robot's port, (3.17)-(3.22).
    guard : {"repay", "cancel", "off"}
        The passivity controllers of the guidance: "repay" lets no port end a sample below zero;
        "cancel", as printed, undershoots by at most one sample's power at a time; "off" shows what
        they are for.
    budget : GuidanceBudget, optional
        What guidance at the operator may give out beyond what its port took, so that it is felt; in
        its place, when not given, is all that the port has earned since the start.
    trust : callable, optional
        f(state) → (T_hr, T_rh) a sample later; (3.2) and (3.3) when not given. Like every function
        here, it may take 16 numbers of its own as a second argument, and is compiled where numba
        can, else called in Python. Or a model of `trustlab.trust` in place of (3.2), one trial a
        second; `trust.TrustInLoop` sets how long a trial is.
    feedback : callable, optional
        f(state) → guiding force [N], shape (3,); −k_ffa e when not given, e being `state.stretch`.
    autonomy : callable, optional
        f(state) → u_a [m/s], shape (3,); the task's PID controller on `state.picture` when not
        given.
    vehicle : three TransferFunction, callable or (A, B, C), optional
        Command to velocity per axis; `tracking_vehicle()` when not given. Or f(state) → position
        [m] and velocity [m/s] a sample later, shape (3,) each, under `state.command`. Or the
        matrices of a discrete state space, x' = A x + B u and (position, velocity) = C x', with x =
        0 where it starts.
    alpha : array_like, shape (N,), optional
        α given from outside; NaN where the scheme sets it. Scheme OMI sets it by `OptimalBlending`
        for the vehicle in use and the PD part of its controller.
    push : array_like, shape (N, 3), optional
        Force [N] added to the hand's.
    lost : array_like of bool, shape (2, N), optional
        Waves that never arrive, to the robot and back.

    Attributes
    ----------
    state
        The state after the last sample, by name, read and changed in place by the loop.
    ways : dict of str to str
        How each part runs: "built-in", "compiled", or "Python: " and why.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.

    Notes
    -----
    H. Saeidi, Chapter 3.

    Examples
    --------
    >>> import trustlab as tl
    >>> loop = tl.TeleoperationLoop("TMIG", study="main", seed=0)
    >>> loop.step().t
    0.0
    >>> run = loop.run(2.0)
    >>> run == tl.simulate_teleoperation("TMIG", study="main", seed=0, duration=2.0)
    True
    """

    scheme: str | Scheme = "TMIG"
    operator: Teleoperator | Callable | None = None
    study: str | LoopSettings = "main"
    seed: int | np.random.SeedSequence = 0
    sample_time: float = 0.01
    task: TrackingTask | None = None
    delay_1: float | Callable | Delay | None = None
    delay_2: float | Callable | Delay | None = None
    read_out: str = "ledger"
    guard: str = "repay"
    alpha: np.ndarray | None = None
    push: np.ndarray | None = None
    vehicle: tuple | Callable | None = None
    lost: np.ndarray | None = None
    guidance: str = "at_operator"
    trust: Callable | TrustDynamics | TrustInLoop | None = None
    feedback: Callable | None = None
    autonomy: Callable | None = None
    delay: float | Callable | Delay | None = None
    budget: GuidanceBudget | None = None

    def __post_init__(self):
        self._scheme, self._settings = scheme_named(self.scheme), study_named(self.study)
        settings, study = self._settings, self._settings.study
        person = Teleoperator(reach=REACH[study]) if self.operator is None else self.operator
        if callable(person):
            person = Teleoperator(reach=REACH[study], law=person)
        self._person = of_class("operator", person, Teleoperator)
        self._task = of_class(
            "task", TASKS[study] if self.task is None else self.task, TrackingTask
        )
        one_of("read_out", self.read_out, READ_OUTS)
        one_of("guard", self.guard, METHODS)
        one_of("guidance", self.guidance, kernel.GUIDANCE)
        if self.budget is not None:
            of_class("budget", self.budget, GuidanceBudget)
            if self.guidance != "at_operator":
                raise ValueError(
                    f"budget is for guidance='at_operator', got guidance={self.guidance!r}"
                )
        T = self.sample_time = between("sample_time", self.sample_time, 1e-5, 0.1)
        if self.delay is not None and (self.delay_1 is not None or self.delay_2 is not None):
            raise ValueError("delay is the delay both ways: give it, or delay_1 and delay_2")
        self._seeds = spawned(self.seed, 5)
        self._failure: PartError | DivergenceError | None = None
        self._states = state_of(settings, T)
        self._accounts = accounts()
        self.state = View(self._states)
        self._row = self._states.view(np.uint8)[: LOG.itemsize].view(float)
        hand = self._person.numbers(T, self._task.camera_delay)
        self._setups = setup_of(settings, hand, self._task.controller(T), T)
        self._fill_setup()
        self._done = 0
        self._table, self._log = log_of(LOG, 0)
        self._history, self._sent = np.zeros(0, HISTORY), np.zeros((2, 0, 3))

    def _fill_setup(self) -> None:
        """Put guard, vehicle and parts into the constants."""
        setup = self._setups[0]
        axes, vehicle = vehicle_of(tracking_vehicle() if self.vehicle is None else self.vehicle)
        if axes:
            setup["vehicle"] = vehicle_matrices(axes, self.sample_time)[0]
        if self._scheme.shares is optimal:
            if not axes:
                raise ValueError(
                    "scheme OMI predicts with three TransferFunction: give the vehicle as these"
                )
            ends, task = self._settings.scattering, self._task
            gains = (task.proportional, task.derivative)
            setup["blend"] = blending_cost(axes, gains, ends.alpha_min, ends.alpha_max)
        if self._scheme.shares is by_hand:
            setup["hand"]["compensation"] *= 1.0 - self._person.allocation_cost
        setup["guard"] = METHODS[self.guard]
        setup["read_out"] = READ_OUTS[self.read_out]
        setup["budget_energy"] = np.inf
        if self.budget is not None:
            setup["budget_energy"] = self.budget.energy
            setup["budget_power"] = self.budget.power
            self._states["ledger"]["account"] = self.budget.energy
        law = self._person.law
        parts = kernel.DEFAULTS | {
            "scheme": self._scheme.shares,
            "vehicle": vehicle,
            "operator": law if callable(law) else kernel.LAWS[law],
        }
        for port in kernel.DEFAULTS:
            if getattr(self, port) is not None:
                parts[port] = getattr(self, port)
        driver = TrustInLoop.of(self.trust)
        if isinstance(driver, TrustInLoop):
            settings = self._settings
            parts["trust"] = driver.part(
                settings.human_to_robot, settings.robot_to_human, self.sample_time
            )
        self._parts = {port: part_of(port, parts[port], self.state) for port in PORTS}
        self.ways = {port: part.way for port, part in self._parts.items()}
        guidance = kernel.GUIDANCE[self.guidance] if self._scheme.bilateral else kernel.no_feedback
        self._parts["guidance"] = guidance
        for port, part in self._parts.items():
            setup["parts"][port] = part.address

    @property
    def t(self) -> float:
        """Time that has been simulated [s]."""
        return self._done * self.sample_time

    def step(self, hand: np.ndarray | None = None, alpha: float | None = None):
        """
        Advance one sample and return the state.

        Parameters
        ----------
        hand : array_like, shape (3,), optional
            Where a recorded or live hand wants the device to be [m], at most 10 m away on each
            axis; the operator's law decides when not given.
        alpha : float, optional
            α of this sample within its bounds (3.1), allocated by hand; the scheme's when not
            given.

        Returns
        -------
        View
            `state`, the same object in every step: everything that a run logs, by name, and what
            its parts keep. `state.copy()` stays as it is.

        Raises
        ------
        PartError
            If a part raises an error or returns what cannot be.
        DivergenceError
            If the run grows without bound.
        """
        if self._done == len(self._log):
            self._reserve(max(2 * self._done, round(BLOCK / self.sample_time)), True)
        if hand is not None:
            place = np.clip(finite_array("hand", hand, length=3), -FARTHEST_HAND, FARTHEST_HAND)
            self._inputs["hand"][self._done] = place
        if alpha is not None:
            ends = self._settings.scattering
            self._inputs["alpha"][self._done] = between(
                "alpha", alpha, ends.alpha_min, ends.alpha_max
            )
        self._advance(self._done + 1)
        return self.state

    def run(self, duration: float) -> Session:
        """
        Advance until a time and return the whole run.

        Parameters
        ----------
        duration : float
            The time [s], counted from the start of the run.

        Returns
        -------
        Session
            As of `simulate_teleoperation(duration=duration)`, bit for bit.

        Raises
        ------
        ValueError
            If the loop is already beyond that time.
        PartError
            If a part raises an error or returns what cannot be.
        DivergenceError
            If the run grows without bound.
        """
        count = samples(duration, self.sample_time)
        if count < self._done:
            raise ValueError(
                f"the loop is at t = {self.t:g} s already, beyond {duration:g} s; make a new one"
            )
        if count > len(self._log):
            self._reserve(count)
        self._advance(count)
        return self.session

    def arrays(self, duration: float) -> dict[str, np.ndarray]:
        """
        Return the arrays that `kernel.advance` is given for a run of this length, by name, as they
        stand now: a program in another language steps them.

        Parameters
        ----------
        duration : float
            Length of the run [s].
        """
        count = samples(duration, self.sample_time)
        if count > len(self._log):
            self._reserve(count)
        return {
            "setups": self._setups,
            "states": self._states,
            "inputs": self._inputs[:count],
            "delays": np.ascontiguousarray(self._delays[:, :count]),
            "arrives": np.ascontiguousarray(self._arrives[:, :count]),
            "accounts": self._accounts,
            "history": self._history[:count],
            "sent": np.ascontiguousarray(self._sent[:, :count]),
            "table": self._table[:count],
        }

    @property
    def built_in(self) -> dict[str, str] | None:
        """Name of the built-in part of each port; None if a part is a user's."""
        if set(self.ways.values()) != {"built-in"}:
            return None
        return {port: part.function.__name__ for port, part in self._parts.items()}

    @property
    def session(self) -> Session:
        """The run so far: every signal and every port's energy, labelled synthetic."""
        done = self._done  # once: another thread may step meanwhile, as in a notebook
        t = np.round(self.sample_time * np.arange(done), 9)
        log, table = self._table[:done], np.empty((done, len(COLUMNS)), order="F")
        # rows become columns a stretch at a time, which the cache holds
        for first in range(0, done, 512):
            table[first : first + 512] = log[first : first + 512]
        data = pd.DataFrame(table, index=pd.Index(t, name="t"), columns=COLUMNS, copy=False)
        replaced = [
            f"{port} {way.split(':')[0]}" for port, way in self.ways.items() if way != "built-in"
        ]
        facts = {
            "study": self._settings.title,
            "scheme": self._scheme.title,
            "seed": str(self.seed),
            "read_out": self.read_out,
            "guard": self.guard,
            "guidance": self.guidance,
            "budget": str(self.budget) if self.budget else "none",
            "parts": ", ".join(replaced) or "built-in",
            "note": NOTE,
        }
        return keep_table(
            data, Metadata(self._person.participant, self._scheme.name, __name__, True, facts)
        )

    def _advance(self, stop: int) -> None:
        """Do the samples before `stop`."""
        if self._failure is None:
            self._done, end = kernel.advance(
                self._done,
                stop,
                self._setups,
                self._states,
                self._row,
                self._inputs,
                self._delays,
                self._arrives,
                self._accounts,
                self._history,
                self._sent,
                self._log,
                self._table,
            )
            if end == kernel.DONE:
                return
            self._failure = self._failed(end)
            if self._done > 1:
                self._failure.session = self.session
        raise self._failure from self._failure.__cause__

    def _failed(self, end: int) -> PartError | DivergenceError:
        """Return the error of a run that ended before its time."""
        block = kernel.BLOCKS[end]
        t = self.state.t
        state = self.state
        if block not in self._parts:
            energies = {"haptic device": "device", "channel": "channel", "robot": "robot"}
            return DivergenceError(
                f"scheme {self._scheme.name} diverged at t = {t:g} s in the {block} (its energy: "
                f"{state[f'energy_{energies[block]}']:.3g} J); lower k_ffa, the hand's gains or "
                "the sample time, or see which guard is off"
            )
        cause = self._parts[block].raised() if state.raised else None
        if cause is not None and not isinstance(cause, Exception):
            raise cause  # an interrupt
        fault = f"raised {type(cause).__name__}: {cause}" if cause else "raised an error"
        if not state.raised:
            values = " and ".join(f"{name} = {np.round(state[name], 6)}" for name in PORTS[block])
            fault = f"returned {values}; finite numbers are wanted"
        if block == "scheme":
            bounds = (
                f"{n} in [{state[f'{n}_min']:g}, {state[f'{n}_max']:g}]" for n in PORTS[block]
            )
            fault += f"; {' and '.join(bounds)}, for which the channel's ends are set (3.1)"
        told = f"the {block} of this loop {fault}, at t = {t:g} s"
        if self._done > 1:
            told += "; the run so far is in .session of this error"
        error = PartError(told)
        error.__cause__ = cause
        return error

    def _reserve(self, count: int, stepped: bool = False) -> None:
        """
        Draw what comes from outside for `count` samples, and make room for the log; a stepped loop
        takes fewer where it must.
        """
        if stepped:
            arrays = any(array is not None for array in (self.alpha, self.push, self.lost))
            # arrays are as long as the run that they are meant for
            count = self._most() if arrays else min(count, self._most())
            if count <= self._done:
                raise ValueError(
                    f"alpha, push, lost or a recorded delay ends at t = {self.t:g} s: the loop "
                    "cannot go beyond"
                )
        inputs = _inputs(
            self._settings, self._task, self._person, count, self.sample_time, self._seeds
        )
        inputs["alpha"] = shares = _shares(self.alpha, count)
        ends = self._settings.scattering
        ends.check_scales(shares[np.isfinite(shares)], np.array(ends.beta_max))
        inputs["pushed"] = signal(
            "push", np.zeros((count, 3)) if self.push is None else self.push, count, 3
        )
        pair = (self.delay_1, self.delay_2) if self.delay is None else (self.delay, self.delay)
        delays = _delays(
            self._settings, pair, self.read_out, count, self.sample_time, self._seeds[3:]
        )
        self._arrives = lost_waves(self.lost, count)
        self._inputs, self._delays = inputs, delays
        table, log = log_of(LOG, count)
        table[: self._done] = self._table[: self._done]
        history, sent = np.zeros(count, HISTORY), np.zeros((2, count, 3))
        history[: self._done] = self._history[: self._done]
        sent[:, : self._done] = self._sent[:, : self._done]
        self._table = table
        self._log = log
        self._history = history
        self._sent = sent
        carried = kernel.WAVES if self._scheme.bilateral else kernel.SIGNALS
        self._setups["channel"] = carried if self._delays.any() else kernel.DIRECT

    def _most(self) -> int:
        """Return how many samples the arguments that are arrays or traces allow."""
        lengths = [*np.shape(self.alpha)[:1], *np.shape(self.push)[:1], *np.shape(self.lost)[1:2]]
        for delay in (self.delay, self.delay_1, self.delay_2):
            if isinstance(delay, Delay) and np.isfinite(delay.end):
                lengths.append(int(delay.end / self.sample_time) + 1)
        return min([*lengths, sys.maxsize])


def simulate_teleoperation(
    scheme: str | Scheme = "TMIG",
    operator: Teleoperator | Callable | None = None,
    study: str | LoopSettings = "main",
    seed: int | np.random.SeedSequence = 0,
    duration: float = 120.0,
    **options: Any,
) -> Session:
    """
    Simulate one run of a scheme of Section 3.8 or 3.9, or of one's own.

    Parameters
    ----------
    scheme, operator, study, seed : as of `TeleoperationLoop`
        Scheme, operator, settings, and the seed of what is drawn.
    duration : float
        Length [s].
    **options : as of `TeleoperationLoop`
        sample_time, task, delay, delay_1, delay_2, read_out, guidance, guard and budget;
        alpha, push and lost, signals that are given; vehicle, trust, feedback and autonomy, parts
        of the loop that replace its own.

    Returns
    -------
    Session
        Every signal and every port's energy; column `alpha` is α, `trust_hr` and `trust_rh` are in
        units of their trust models, `guide` is the guiding force at the haptic device where it is
        rendered there. Labelled synthetic.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.
    PartError
        If a part of one's own raises an error or returns what cannot be: part and time are named,
        and `.session` of the error is the run so far.
    DivergenceError
        If the run grows without bound: the time, the block and its energy are named; likewise.

    Notes
    -----
    Printed is guidance="through_channel" with guard="cancel". There the guiding force −k_ffa e
    stands at the robot's port, whose velocity yields to any force by 1/b: the force drives the
    robot to its target, with nobody at the device as well (guard="off"). Its energy comes from the
    moving target (`energy_target`), a port that the passivity controller does not observe; what the
    controller books as given away by the robot's port, and stops, is mostly this hidden autopilot.
    So with the guard off a comparison of M and TMIG compares autopilots, and with it the operator
    feels almost nothing.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.simulate_teleoperation("TMIG", study="main", seed=0, duration=10.0)
    >>> run.duration, run.metadata.synthetic
    (9.99, True)
    """
    return TeleoperationLoop(scheme, operator, study, seed, **options).run(duration)


def samples(duration: float, sample_time: float) -> int:
    """Return the number of samples of a run, checked."""
    duration = finite_number("duration", duration)
    if not 10.0 * sample_time <= duration <= min(1e5, 5e6 * sample_time):
        raise ValueError(
            f"duration must be ten to five million samples of {sample_time:g} s and at most 1e5 "
            f"s, got {duration}"
        )
    return round(duration / sample_time)


def _inputs(settings, task, operator, count, sample_time, seeds) -> np.ndarray:
    """
    Return what is drawn from the seeds, records of INPUT; a longer draw begins with the shorter
    one.
    """
    start, losses, noise = (np.random.default_rng(child) for child in seeds[:3])
    t, inputs = sample_time * np.arange(count), np.empty(count, INPUT)
    phase = start.uniform(0.0, 2.0 * np.pi)
    position, velocity = task.path(t, settings.height, phase)
    inputs["reference"], inputs["reference_velocity"] = position, velocity
    ahead = (
        task.path(t + operator.preview, settings.height, phase)[0] if operator.preview else position
    )
    inputs["ahead"] = ahead - position
    inputs["detected"] = _losses(task, count, sample_time, losses)
    inputs["motor"] = _coloured(count, operator.noise_time, sample_time, noise)
    inputs["hand"] = np.nan
    return inputs


def _losses(task: TrackingTask, count: int, sample_time: float, rng) -> np.ndarray:
    """Return whether the autonomous controller sees its target, per sample."""
    detected = np.ones(count, bool)
    k = 0
    sees = True
    while k < count:
        length = rng.exponential(task.failure_every if sees else task.failure_length)
        until = k + max(round(length / sample_time), 1)
        detected[k:until] = sees
        k, sees = until, not sees
    return detected


def _coloured(count: int, time: float, sample_time: float, rng) -> np.ndarray:
    """Return noise of unit variance with this correlation time, shape (count, 3)."""
    keep = np.exp(-sample_time / time)
    white = rng.normal(size=(count, 3))
    white[0] /= np.sqrt(1.0 - keep**2)
    return first_order(white, np.sqrt(1.0 - keep**2), keep)


def _delays(settings: LoopSettings, pair, read_out, count, sample_time, seeds) -> np.ndarray:
    """Return the delays both ways in samples; random walks of the study where none is given."""
    rate, (low, high) = settings.scattering.max_delay_rate, DELAYS[settings.study]
    chosen = {}
    for name, delay, child in zip(("delay_1", "delay_2"), pair, seeds, strict=True):
        if delay is None:
            seed = np.random.SeedSequence(int(np.random.default_rng(child).integers(1 << 62)))
            delay = random_walk_delay(max(low, sample_time), high, rate, seed)
        chosen[name] = delay
    return delays_in_samples(chosen, rate, read_out, count, sample_time, zero=True)


def _shares(alpha, count: int) -> np.ndarray:
    """Return α where it is given from outside, NaN where the scheme sets it."""
    if alpha is None:
        return np.full(count, np.nan)
    try:
        array = np.asarray(alpha, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"alpha must be an array of numbers, got {type(alpha).__name__}") from None
    if array.shape != (count,):
        raise ValueError(
            f"alpha must have shape ({count},), one number per sample, got {array.shape}"
        )
    return array
