"""A UAV that follows a ground robot through a teleoperation loop: a simulated stand-in for Figs. 3.12 and 3.15."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd

from trustlab.allocation.blending import OptimalBlending
from trustlab.models.checks import between, finite_number, not_negative, of_class, one_of, positive, spawned
from trustlab.models.uav import PRINTED_UAV, TransferFunction, three_axes
from trustlab.operators.teleoperator import REACH, Teleoperator
from trustlab.sessions.session import Metadata, Session
from trustlab.teleoperation.channel import lost_waves
from trustlab.teleoperation.delays import Delay, delays_in_samples, random_walk_delay
from trustlab.teleoperation.loop import kernel
from trustlab.teleoperation.loop.schemes import OPTIMAL, Scheme, scheme_named
from trustlab.teleoperation.loop.settings import DivergenceError, LoopSettings, study_named, vehicle_matrices
from trustlab.teleoperation.ports.ledger import READ_OUTS, accounts
from trustlab.teleoperation.ports.passivity import METHODS
from trustlab.teleoperation.records import log_of, signal

NOTE = "simulated stand-in for the UAV testbeds of Figs. 3.12 and 3.15"


def tracking_vehicle(bandwidth: float = 4.0) -> tuple[TransferFunction, ...]:
    """
    Return the UAV of (A.1) under a low-level velocity controller, as Section 3.6 assumes one.

    State feedback u = (ω² r − (ω² − d_0) v − (2ω − d_1) dv/dt)/gain puts both poles at −ω, and at −ω for order one. The
    printed PD controller of Appendix A does not stabilise (A.1) by itself on x and y.

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
        TransferFunction(omega, (omega,)) if model.order == 1 else TransferFunction(omega**2, (2.0 * omega, omega**2))
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
        Mean time between losses of the target by the autonomous controller, and how long one lasts [s]; exponential.
    camera_delay : float
        How late pictures arrive at the operator and the controller [s].
    proportional, integral, derivative : float
        Gains of the hovering PID controller.
    reach : float
        Its largest command [m/s].

    Raises
    ------
    ValueError
        If a number is not finite or out of range.
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

    def __post_init__(self):
        may_be_zero = ("speed", "camera_delay", "proportional", "integral", "derivative")
        for name in self.__dataclass_fields__:
            check = not_negative if name in may_be_zero else positive
            object.__setattr__(self, name, check(name, getattr(self, name)))

    def controller(self, sample_time: float) -> kernel.AutonomyNumbers:
        """
        Return the autonomous controller as the compiled loop takes it.

        Parameters
        ----------
        sample_time : float
            T [s].
        """
        late = max(round(self.camera_delay / sample_time), 1)
        ideal = 1.0  # gain of the ideal controller u_i = reference velocity + error
        return kernel.AutonomyNumbers(self.proportional, self.integral, self.derivative, late, self.reach, ideal)

    def path(self, t: np.ndarray, height: float, phase: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return where the UAV should be and how fast that moves: a figure of eight at a height above the floor.

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
        rate = self.speed / np.sqrt(0.5 * self.size_x**2 + 2.0 * self.size_y**2)  # root mean square speed
        turn = rate * t + phase
        position = np.column_stack(
            [self.size_x * np.sin(turn), self.size_y * np.sin(2 * turn), np.full(t.size, height)]
        )
        velocity = np.column_stack(
            [self.size_x * rate * np.cos(turn), 2 * self.size_y * rate * np.cos(2 * turn), np.zeros(t.size)]
        )
        return position, velocity


TASKS = {
    "preliminary": TrackingTask(size_x=6.0, size_y=4.0, speed=0.8, camera_delay=0.2, reach=2.5),
    "main": TrackingTask(),
}
DELAYS = {"preliminary": (0.1, 0.8), "main": (0.03, 0.2)}


def simulate_teleoperation(
    scheme: str = "TMIG",
    operator: Teleoperator | None = None,
    study: str | LoopSettings = "main",
    seed: int | np.random.SeedSequence = 0,
    duration: float = 120.0,
    sample_time: float = 0.01,
    task: TrackingTask | None = None,
    delay_1: float | Delay | None = None,
    delay_2: float | Delay | None = None,
    read_out: str = "ledger",
    guard: str = "cancel",
    alpha: np.ndarray | None = None,
    push: np.ndarray | None = None,
    vehicle: tuple[TransferFunction, ...] | None = None,
    lost: np.ndarray | None = None,
) -> Session:
    """
    Simulate one run of a scheme of Section 3.8 or 3.9.

    Parameters
    ----------
    scheme : {"M", "MI", "MMI", "TMIG", "TMIS", "OMI"}
        The scheme.
    operator : Teleoperator, optional
        Who holds the device; an average one when not given.
    study : {"preliminary", "main"} or LoopSettings
        Printed settings, or own ones. Task, delays and reach of the operator are those of the study that
        `LoopSettings.study` names, where they are not given.
    seed : int or numpy.random.SeedSequence
        Streams for the path's start, losses of the target, motor noise and delays are spawned from it.
    duration : float
        Length [s].
    sample_time : float
        T [s]; 0.01 as printed.
    task : TrackingTask, optional
        The target; the study's own when not given.
    delay_1, delay_2 : float or Delay, optional
        Delay to the robot and back [s]; random walks of the study when not given. Both zero: no channel in between.
    read_out : {"ledger", "interpolated", "hold"}
        How delayed waves are read, see `channel_run`.
    guard : {"cancel", "repay", "off"}
        Passivity controller at the robot's port.
    alpha : array_like, shape (N,), optional
        α given from outside; NaN where the scheme sets it. Scheme OMI sets it by `OptimalBlending` for the vehicle in use
        and the PD part of its controller.
    push : array_like, shape (N, 3), optional
        Force [N] added to the hand's.
    vehicle : three TransferFunction, optional
        Command to velocity; `tracking_vehicle()` when not given.
    lost : array_like of bool, shape (2, N), optional
        Waves that never arrive, to the robot and back.

    Returns
    -------
    Session
        Every signal and every port's energy; column `alpha` is α, `trust_hr` and `trust_rh` are in units of their trust
        models. Labelled synthetic.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.
    DivergenceError
        If the run grows without bound: the time, the block and its energy are named.

    Notes
    -----
    With guard="cancel", the default, the passivity controller acts in nearly every sample while the target moves: the
    guiding force is a spring to the target, and a moving target feeds it, which the observer at the port books as energy
    given away. The controller then stops most of the port's velocity, which is what the operator commands. Comparisons of
    schemes can depend on it: simulated operators track better in TMIG than in M with the guard, and better in M than in
    TMIG with guard="off", where the port is not passive. Compare under both before concluding; `port_share`, a column of the
    session, and `guarded` and `port_share` of `teleoperation_measures` show how much the controller did.
    """
    chosen, settings = scheme_named(scheme), study_named(study)
    operator = Teleoperator(reach=REACH[settings.study]) if operator is None else operator
    task = TASKS[settings.study] if task is None else task
    of_class("operator", operator, Teleoperator)
    of_class("task", task, TrackingTask)
    one_of("read_out", read_out, READ_OUTS)
    one_of("guard", guard, METHODS)
    count, sample_time = _samples(duration, sample_time)
    vehicle = tracking_vehicle() if vehicle is None else three_axes(vehicle)
    seeds = spawned(seed, 5)
    delays = _delays(settings, (delay_1, delay_2), read_out, count, sample_time, seeds[3:])
    arrives = lost_waves(lost, count)
    inputs = _inputs(settings, task, operator, count, sample_time, seeds, alpha, push)
    setup = kernel.Setup(chosen.allocation, chosen.bilateral, not delays.any(), READ_OUTS[read_out], METHODS[guard])
    table, log = log_of(kernel.LOG, count)
    done, block = kernel.run_loop(
        setup,
        settings.numbers(sample_time),
        operator.numbers(sample_time, task.camera_delay),
        task.controller(sample_time),
        vehicle_matrices(vehicle, sample_time),
        _blending(chosen, vehicle, task, settings),
        inputs,
        delays,
        arrives,
        accounts(),
        np.zeros(1, kernel.STATE),
        log,
    )
    t = sample_time * np.arange(count)
    data = pd.DataFrame(table, index=pd.Index(np.round(t, 9), name="t"), columns=kernel.COLUMNS)
    if block >= 0:
        energy = data[["energy_device", "energy_channel", "energy_robot"]].iloc[done - 1, block]
        raise DivergenceError(
            f"scheme {scheme} diverged at t = {(done - 1) * sample_time:g} s in the {kernel.BLOCKS[block]} (its energy: "
            f"{energy:.3g} J); lower k_ffa, the hand's gains or the sample time, or see which guard is off"
        )
    facts = {"study": settings.title, "scheme": chosen.title, "seed": str(seed)}
    facts |= {"read_out": read_out, "guard": guard, "note": NOTE}
    about = Metadata(operator.participant, chosen.name, "trustlab.testbeds.uav_tracking", True, facts)
    return Session(data, about)


def _samples(duration: float, sample_time: float) -> tuple[int, float]:
    """Return the number of samples and the sample time of a run, checked."""
    sample_time = between("sample_time", sample_time, 1e-5, 0.1)
    duration = finite_number("duration", duration)
    if not 10.0 * sample_time <= duration <= min(1e5, 5e6 * sample_time):
        raise ValueError(
            f"duration must be ten to five million samples of {sample_time:g} s and at most 1e5 s, got {duration}"
        )
    return round(duration / sample_time), sample_time


def _inputs(settings, task, operator, count, sample_time, seeds, alpha, push) -> np.ndarray:
    """Return what comes from outside, records of INPUT: drawn from the seeds where random, checked where a user gave it."""
    start, losses, noise = (np.random.default_rng(child) for child in seeds[:3])
    t, inputs = sample_time * np.arange(count), np.empty(count, kernel.INPUT)
    position, velocity = task.path(t, settings.height, start.uniform(0.0, 2.0 * np.pi))
    inputs["reference"], inputs["reference_velocity"] = position, velocity
    inputs["detected"] = _losses(task, count, sample_time, losses)
    inputs["motor"] = _coloured(count, operator.noise_time, sample_time, noise)
    inputs["alpha"] = shares = _shares(alpha, count)
    settings.scattering.check_scales(shares[np.isfinite(shares)], settings.scattering.beta_max)
    inputs["pushed"] = signal("push", np.zeros((count, 3)) if push is None else push, count, 3)
    return inputs


def _blending(scheme: Scheme, vehicle, task: TrackingTask, settings: LoopSettings) -> np.ndarray:
    """Return the cost of Appendix A that sets α in scheme OMI; an empty one in every other scheme."""
    if scheme.allocation != OPTIMAL:
        return np.zeros((3, 1, 5, 5))
    ends = settings.scattering
    return _cost(vehicle, (task.proportional, task.derivative), ends.alpha_min, ends.alpha_max)


@lru_cache(maxsize=64)
def _cost(vehicle, gains, low: float, high: float) -> np.ndarray:
    """Return the cost of Appendix A for this vehicle and its controller, the same on three axes."""
    return OptimalBlending(vehicle, (gains,) * 3, low, high).weights


def _losses(task: TrackingTask, count: int, sample_time: float, rng) -> np.ndarray:
    """Return whether the autonomous controller sees its target, per sample."""
    detected, k, sees = np.ones(count, bool), 0, True
    while k < count:
        length = rng.exponential(task.failure_every if sees else task.failure_length)
        until = k + max(round(length / sample_time), 1)
        detected[k:until] = sees
        k, sees = until, not sees
    return detected


def _coloured(count: int, time: float, sample_time: float, rng) -> np.ndarray:
    """Return noise of unit variance with this correlation time, shape (count, 3)."""
    from scipy.signal import lfilter

    keep = np.exp(-sample_time / time)
    white = rng.normal(size=(count, 3))
    white[0] /= np.sqrt(1.0 - keep**2)
    return np.ascontiguousarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0))


def _delays(settings: LoopSettings, given, read_out, count, sample_time, seeds) -> np.ndarray:
    """Return the delays both ways in samples; random walks of the study where none is given."""
    rate, (low, high) = settings.scattering.max_delay_rate, DELAYS[settings.study]
    chosen = {}
    for name, delay, child in zip(("delay_1", "delay_2"), given, seeds, strict=True):
        if delay is None:
            own = np.random.SeedSequence(int(np.random.default_rng(child).integers(1 << 62)))
            delay = random_walk_delay(max(low, sample_time), high, rate, own)
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
        raise ValueError(f"alpha must have shape ({count},), one number per sample, got {array.shape}")
    return array
