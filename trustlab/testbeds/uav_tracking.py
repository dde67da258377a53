"""
A UAV that follows a ground robot through a teleoperation loop: a simulated stand-in for Figs. 3.12
and 3.15.

The task (a target on a closed path, a controller that loses it, the vehicle flown), the loop that
is stepped or run, and what is drawn at random. One sample is `teleoperate` in
`teleoperation/loop/kernel.py`; how functions of one's own are asked is in `hooks.py` beside it.
"""

import sys
from collections.abc import Callable, Mapping
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
    shown,
    spawned,
)
from trustlab.models.simulation import DivergenceError, PartError, Simulation, View, compiled_for
from trustlab.models.uav import PRINTED_UAV, TransferFunction, three_axes
from trustlab.operators.teleoperator import REACH, Teleoperator
from trustlab.sessions.session import Metadata, Session, keep_table
from trustlab.teleoperation.delays import Delay, delays_in_samples, random_walk_delay
from trustlab.teleoperation.filters import first_order
from trustlab.teleoperation.loop.hooks import asking, is_state_space, state_space
from trustlab.teleoperation.loop.kernel import BLOCKS, DIRECT, LAWS, SIGNALS, WAVES, teleoperate
from trustlab.teleoperation.loop.records import (
    AUTONOMY,
    COLUMNS,
    DECIDED,
    INPUT,
    SAMPLE,
    LoopSetup,
    LoopState,
)
from trustlab.teleoperation.loop.schemes import RULES, Scheme, optimal_share, scheme_named
from trustlab.teleoperation.loop.settings import (
    Guidance,
    LoopSettings,
    blending_cost,
    guidance_named,
    hold_device,
    numbers_of,
    state_of,
    study_named,
    vehicle_matrices,
)
from trustlab.teleoperation.ports.ledger import accounts
from trustlab.teleoperation.ports.waves import Scattering
from trustlab.teleoperation.records import filled
from trustlab.trust.driving import TrustInLoop
from trustlab.trust.interface import TrustDynamics

NOTE = "simulated stand-in for the UAV testbeds of Figs. 3.12 and 3.15"
# How far ahead a loop that is stepped draws what comes from outside [s]; twice as far each time
# that it runs out.
BLOCK = 60.0
# How far away a live hand is taken to be at the most [m], far beyond any device.
FARTHEST_HAND = 10.0

WIDTH = len(COLUMNS)


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
    autonomy : callable, optional
        f(state) → u_a [m/s], shape (3,), in place of the PID controller on `state.picture`.

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
    autonomy: Callable | None = None

    def __post_init__(self):
        may_be_zero = ("speed", "camera_delay", "proportional", "integral", "derivative")
        for name in set(self.__dataclass_fields__) - {"autonomy"}:
            check = not_negative if name in may_be_zero else positive
            object.__setattr__(self, name, check(name, getattr(self, name)))
        between("view", self.view, 0.0, 1e6)
        if self.autonomy is not None and not callable(self.autonomy):
            raise ValueError(f"autonomy must be a function of the state, got {self.autonomy!r:.80}")

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
    task : TrackingTask, optional
        The target, and the controller that follows it; the study's own when not given.
    delay : float, callable, Delay, or a pair of these, optional
        Delay both ways [s], or (to the robot, back); random walks of the study where None. Zero: no
        channel in between. `packet_delay(sent, received)` is that of a recorded network.
    guidance : {"at_operator", "through_channel"} or Guidance
        How the guiding force reaches the operator, and what keeps it passive.
    vehicle : three TransferFunction, callable or (A, B, C), optional
        Command to velocity per axis; `tracking_vehicle()` when not given. Or f(state) → position
        [m] and velocity [m/s] a sample later, shape (3,) each, under `state.command`. Or the
        matrices of a discrete state space, x' = A x + B u and (position, velocity) = C x', with x =
        0 where it starts. Scheme OMI predicts with three TransferFunction.
    trust : callable, TrustDynamics or TrustInLoop, optional
        f(state) → (T_hr, T_rh) a sample later; (3.2) and (3.3) when not given. Or a model of
        `trustlab.trust` in place of (3.2), one trial a second; `trust.TrustInLoop` sets how long a
        trial is.
    given : mapping of str to array_like, optional
        Signals that come from outside, a row for each sample, NaN where the loop decides: `alpha`,
        `beta`, `trust_hr`, `trust_rh`, shape (N,); `u_a`, `wanted`, `guiding`, `robot`, `velocity`
        and `hand`, where a hand wants the device to be [m], shape (N, 3). Without NaN: `push`, a
        force [N] added to the hand's, shape (N, 3), and `arrives`, bool of shape (N, 2), whether
        the waves sent to the robot and back in a sample arrive. `loop.inputs` of another loop
        repeats its run without its functions.

    Attributes
    ----------
    state : View
        Everything that a run logs, by name, and what the loop keeps, before the next sample.

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
    0.01
    >>> run = loop.run(2.0)
    >>> run == tl.simulate_teleoperation("TMIG", study="main", seed=0, duration=2.0)
    True
    """

    def __init__(
        self,
        scheme: str | Scheme = "TMIG",
        operator: Teleoperator | Callable | None = None,
        study: str | LoopSettings = "main",
        seed: int | np.random.SeedSequence = 0,
        task: TrackingTask | None = None,
        delay: Any = None,
        guidance: str | Guidance = "at_operator",
        vehicle: tuple | Callable | None = None,
        trust: Callable | TrustDynamics | TrustInLoop | None = None,
        given: Mapping[str, Any] | None = None,
    ):
        self.scheme, self.settings = scheme_named(scheme), study_named(study)
        self.seed, self.guidance = seed, guidance_named(guidance)
        study = self.settings.study
        person = Teleoperator(reach=REACH[study]) if operator is None else operator
        if callable(person):
            person = Teleoperator(reach=REACH[study], law=person)
        self.operator = of_class("operator", person, Teleoperator)
        self.task = of_class("task", TASKS[study] if task is None else task, TrackingTask)
        self._delays = two_ways(delay)
        self._seeds = spawned(seed, 5)
        self._given = signals_given(given, self.settings.scattering)
        self._failure: PartError | DivergenceError | None = None
        self._whole = state_of(self.settings, self.guidance)
        self.state = View(self._whole)
        self._hooks = self._functions(vehicle, trust)
        self._own = ", ".join(self._hooks) or "built-in"
        self._numbers = self._constants(vehicle)
        self.simulation: Simulation | None = None

    def _functions(self, vehicle: Any, trust: Any) -> dict[str, Callable]:
        """Return the functions of one's own in this loop."""
        settings = self.settings
        driver = TrustInLoop.of(trust)
        if isinstance(driver, TrustInLoop):
            ranges = settings.human_to_robot, settings.robot_to_human
            driver = driver.part(*ranges, settings.sample_time)
        elif driver is not None and not callable(driver):
            raise ValueError(f"trust must be a function of the state, got {shown(trust)}")
        if is_state_space(vehicle):
            vehicle = state_space(*vehicle)
        hooks = {
            "vehicle": vehicle,
            "trust": driver,
            "autonomy": self.task.autonomy,
            "scheme": self.scheme.shares,
            "operator": self.operator.law,
            "feedback": self.guidance.force,
        }
        return {port: hook for port, hook in hooks.items() if callable(hook)}

    def _constants(self, vehicle: Any) -> np.ndarray:
        """Return the constants, a record of NUMBERS."""
        settings, task = self.settings, self.task
        scheme = self.scheme
        T, ends = settings.sample_time, settings.scattering
        numbers = numbers_of(settings, self.guidance, scheme.bilateral)
        (n,) = numbers
        n["rule"] = RULES["manual" if callable(scheme.shares) else scheme.shares]
        law = self.operator.law
        n["law"] = 0 if callable(law) else LAWS.index(law)
        hold_device(n, settings, self.operator.numbers(T, task.camera_delay))
        if scheme.shares == "by hand":
            n["hand"]["compensation"] *= 1.0 - self.operator.allocation_cost
        n["auto"] = task.controller(T)
        n["own_trust"], n["own_vehicle"] = "trust" in self._hooks, "vehicle" in self._hooks
        if not n["own_vehicle"]:
            axes = three_axes(tracking_vehicle() if vehicle is None else vehicle)
            n["phi"], n["gamma"] = vehicle_matrices(axes, T)
        if scheme.shares == "optimal":
            if n["own_vehicle"]:
                raise ValueError(
                    "scheme OMI predicts with three TransferFunction: give the vehicle as these"
                )
            gains = (task.proportional, task.derivative)
            n["blend"] = blending_cost(axes, gains, ends.alpha_min, ends.alpha_max)
            self._hooks["scheme"] = optimal(numbers, self._whole)
        return numbers

    @property
    def t(self) -> float:
        """Time that has been simulated [s]."""
        return 0.0 if self.simulation is None else self.simulation.done * self.settings.sample_time

    def step(self, hand: np.ndarray | None = None, alpha: float | None = None) -> View:
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
            `state`, the same object in every step: the time that has been reached, where everything
            is then, and the signals of the sample. `state.copy()` stays as it is.

        Raises
        ------
        PartError
            If a function of one's own raises an error or returns what cannot be.
        DivergenceError
            If the run grows without bound.
        """
        done = 0 if self.simulation is None else self.simulation.done
        if self.simulation is None or done == self.simulation.log.size:
            self._reserve_more(done)
        inputs = self.simulation.inputs
        if hand is not None:
            place = finite_array("hand", hand, length=3)
            inputs["hand"][done] = np.clip(place, -FARTHEST_HAND, FARTHEST_HAND)
        if alpha is not None:
            ends = self.settings.scattering
            inputs["alpha"][done] = between("alpha", alpha, ends.alpha_min, ends.alpha_max)
        self._advance(done + 1)
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
            If a function of one's own raises an error or returns what cannot be.
        DivergenceError
            If the run grows without bound.
        """
        count = self.reserve(duration)
        if count < self.simulation.done:
            raise ValueError(
                f"the loop is at t = {self.t:g} s already, beyond {duration:g} s; make a new one"
            )
        self._advance(count)
        return self.session

    def reserve(self, duration: float) -> int:
        """
        Draw what comes from outside until a time, so that `simulation` is there; return the number
        of samples.

        Parameters
        ----------
        duration : float
            The time [s], counted from the start of the run.
        """
        count = samples(duration, self.settings.sample_time)
        if self.simulation is None or count > self.simulation.log.size:
            self._reserve(count)
        return count

    @property
    def decisions(self) -> dict[str, np.ndarray]:
        """
        What was decided or came from outside so far, by name, a row for each sample: given to
        another loop as `given`, it repeats the run without its functions and hands.
        """
        if self.simulation is None:
            return {}
        run = self.simulation
        inputs = run.inputs[: run.done]
        made = {name: inputs[name].copy() for name in (*DECIDED.names, "push")}
        arrives = run.setup.arrives[:, : run.done].T.copy()
        return {name: each for name, each in made.items() if not np.isnan(each).all()} | {
            "arrives": arrives
        }

    @property
    def session(self) -> Session:
        """The run so far: every signal and every port's energy, labelled synthetic."""
        log = np.zeros(0, SAMPLE) if self.simulation is None else self.simulation.log
        done = 0 if self.simulation is None else self.simulation.done
        # once: another thread may step meanwhile, as in a notebook
        rows, table = log[:done].view(float).reshape(done, -1), np.empty((done, WIDTH), order="F")
        # rows become columns a stretch at a time, which the cache holds
        for first in range(0, done, 512):
            table[first : first + 512] = rows[first : first + 512, :WIDTH]
        t = np.round(self.settings.sample_time * np.arange(done), 9)
        data = pd.DataFrame(table, index=pd.Index(t, name="t"), columns=COLUMNS, copy=False)
        guidance = self.guidance
        facts = {
            "study": self.settings.title,
            "scheme": self.scheme.title,
            "seed": str(self.seed),
            "guard": guidance.guard,
            "guidance": guidance.where,
            "budget": str(guidance.budget) if guidance.budget else "none",
            "parts": self._own,
            "note": NOTE,
        }
        return keep_table(
            data, Metadata(self.operator.participant, self.scheme.name, __name__, True, facts)
        )

    def _advance(self, stop: int) -> None:
        """Do the samples before `stop`; a run that failed fails again."""
        if self._failure is None:
            try:
                return self.simulation.advance(stop)
            except PartError as error:
                self._failure = error
            except DivergenceError as error:
                self._failure = DivergenceError(
                    f"scheme {self.scheme.name}: {error}; lower k_ffa, the hand's gains or the "
                    "sample time, or see which guard is off"
                )
            if self.simulation.done > 1:
                self._failure.session = self.session
        raise self._failure from self._failure.__cause__

    def _reserve_more(self, done: int) -> None:
        """Make room for a loop that is stepped: twice as much each time, if there is so much."""
        count = max(2 * done, round(BLOCK / self.settings.sample_time))
        if self._given:  # signals are as long as the run that they are meant for
            count = len(next(iter(self._given.values())))
        count = min(count, self._known())
        if count <= done:
            raise ValueError(
                f"a signal given or a recorded delay ends at t = {self.t:g} s: the loop cannot go "
                "beyond"
            )
        self._reserve(count)

    def _known(self) -> int:
        """Return for how many samples the delays are known."""
        ends = [delay.end for delay in self._delays.values() if isinstance(delay, Delay)]
        seconds = min(ends, default=np.inf)
        return int(seconds / self.settings.sample_time) + 1 if np.isfinite(seconds) else sys.maxsize

    def _reserve(self, count: int) -> None:
        """
        Draw what comes from outside for `count` samples and the pause after them, and make room for
        the log; keep what is done.
        """
        settings, seeds = self.settings, self._seeds
        before = self.simulation
        inputs = drawn(settings, self.task, self.operator, count + 1, seeds)
        arrives = np.ones((2, count + 1), bool)
        for name, signal in self._given.items():
            if len(signal) != count:
                raise ValueError(
                    f"{name} must have one row for each of {count} samples, got {len(signal)}"
                )
            if name == "arrives":
                arrives[:, :count] = signal.T
            else:
                inputs[name][:count] = signal
        asked = count + 1 if count < self._known() else count
        delays = delays_of(settings, self._delays, asked, seeds[3:])
        delays = np.pad(delays, ((0, 0), (0, count + 1 - asked)), mode="edge")
        carried = WAVES if self.scheme.bilateral else SIGNALS
        self._numbers["carried"] = carried if delays.any() else DIRECT
        setup = LoopSetup(self._numbers, delays, arrives)
        log, sent = np.zeros(count, SAMPLE), np.zeros((2, count, 3))
        if before is None:
            state = LoopState(self._whole, sent, accounts())
            decide = self._hooks and asking(
                self._hooks, self.state, self._whole, settings.scattering
            )
            self.simulation = Simulation(
                teleoperate,
                setup,
                state,
                inputs,
                log,
                decide or None,
                blocks=BLOCKS,
                sample_time=settings.sample_time,
            )
            return
        done = before.done
        log[:done], sent[:, :done] = before.log[:done], before.state.sent[:, :done]
        for name in DECIDED.names:
            inputs[name][:done] = before.inputs[name][:done]
        before.setup, before.inputs = setup, inputs
        before.log = log
        before.state = before.state._replace(sent=sent)


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
        task, delay, guidance, vehicle, trust and given.

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
    Printed is ``guidance=Guidance("through_channel", guard="cancel")``. There the force −k_ffa e
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


def two_ways(delay: Any) -> dict[str, Any]:
    """Return the delays to the robot and back by name, from one for both or a pair."""
    pair = delay if isinstance(delay, tuple) else (delay, delay)
    if len(pair) != 2:
        raise ValueError(f"delay must be one for both ways, or (to the robot, back), got {pair}")
    return dict(zip(("delay to the robot", "delay back"), pair, strict=True))


def signals_given(given: Any, ends: Scattering) -> dict[str, np.ndarray]:
    """Return signals that come from outside as arrays by name, checked but for their length."""
    if not isinstance(given, Mapping | None):
        raise ValueError(f"given must map names of signals to arrays, got {shown(given)}")
    kinds = {name: INPUT[name].shape for name in ("push", *(DECIDED.names or ()))}
    checked = {}
    for name, values in (given or {}).items():
        one_of("a signal that is given", name, [*kinds, "arrives"])
        wanted = (2,) if name == "arrives" else kinds[name]
        try:
            array = np.asarray(values, bool if name == "arrives" else float)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"{name} must be an array of numbers, got {shown(values)}") from None
        if array.ndim == 0 or array.shape[1:] != wanted:
            shape = f"(N, {wanted[0]})" if wanted else "(N,)"
            raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
        if np.isinf(array).any() or (name == "push" and np.isnan(array).any()):
            k = int(np.argwhere(~np.isfinite(array))[0][0])
            raise ValueError(f"{name} must be finite, but sample {k} is {array[k]}")
        checked[name] = array
    scales = [checked.get(name, np.full(1, np.nan)) for name in ("alpha", "beta")]
    tops = ends.alpha_max, ends.beta_max
    ends.check_scales(*(np.where(np.isnan(x), top, x) for x, top in zip(scales, tops, strict=True)))
    return checked


def optimal(numbers: np.ndarray, whole: np.ndarray) -> Callable:
    """Return scheme OMI as a function of the state."""
    share = compiled_for(optimal_share, numbers, whole)

    def shares(view: View) -> tuple[float, float]:
        return share(numbers, whole), view.beta_max

    return shares


def drawn(settings, task, operator, count, seeds) -> np.ndarray:
    """
    Return what is drawn from the seeds, records of INPUT; a longer draw begins with the shorter
    one.
    """
    start, losses, noise = (np.random.default_rng(child) for child in seeds[:3])
    T = settings.sample_time
    t, inputs = T * np.arange(count), np.zeros(count, INPUT)
    phase = start.uniform(0.0, 2.0 * np.pi)
    position, velocity = task.path(t, settings.height, phase)
    inputs["reference"], inputs["reference_velocity"] = position, velocity
    ahead = (
        task.path(t + operator.preview, settings.height, phase)[0] if operator.preview else position
    )
    inputs["ahead"] = ahead - position
    inputs["detected"] = _losses(task, count, T, losses)
    inputs["motor"] = _coloured(count, operator.noise_time, T, noise)
    for name in DECIDED.names:
        inputs[name] = np.nan
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


def delays_of(settings: LoopSettings, pair: dict[str, Any], count: int, seeds) -> np.ndarray:
    """Return the delays both ways in samples; random walks of the study where none is given."""
    rate, (low, high) = settings.scattering.max_delay_rate, DELAYS[settings.study]
    chosen, T = dict(pair), settings.sample_time
    for (name, delay), child in zip(pair.items(), seeds, strict=True):
        if delay is None:
            seed = np.random.SeedSequence(int(np.random.default_rng(child).integers(1 << 62)))
            chosen[name] = random_walk_delay(max(low, T), high, rate, seed)
    return delays_in_samples(chosen, rate, "ledger", count, T, zero=True)
