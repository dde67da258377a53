"""
A UAV that follows a ground robot through a teleoperation loop: a simulated stand-in for Figs. 3.12
and 3.15.

The task (a target on a closed path, a controller that loses it, the vehicle flown), the loop that
is stepped or run, and what is drawn at random. One sample is `teleoperate` in
`teleoperation/loop/kernel.py`; how functions of one's own are asked is in `hooks.py` beside it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    Seed,
    array_between,
    between,
    changes,
    finite_array,
    finite_number,
    finite_numbers,
    function,
    named,
    of_class,
    one_of,
    refuse_changed,
    shown,
    spawned,
)
from trustlab.models.records import coloured
from trustlab.models.simulation import Loop, Simulation, View, compiled_for, filled
from trustlab.models.uav import TransferFunction, three_axes
from trustlab.operators.teleoperator import REACH, Teleoperator
from trustlab.sessions.session import Metadata, Session, keep_table
from trustlab.teleoperation.delays import (
    both_ways,
    delays_in_samples,
    random_walk_delay,
)
from trustlab.teleoperation.loop.hooks import asking, is_state_space, state_space
from trustlab.teleoperation.loop.kernel import (
    AUTONOMY,
    BLOCKS,
    COLUMNS,
    DECIDED,
    GUIDANCE,
    INPUT,
    LAWS,
    NOWHERE,
    NUMBERS,
    SAMPLE,
    TRUST,
    LoopSetup,
    LoopState,
    teleoperate,
)
from trustlab.teleoperation.loop.settings import (
    RULES,
    Guidance,
    LoopSettings,
    Scheme,
    blending_cost,
    bounds_of,
    described,
    optimal_share,
    scheme_named,
    state_of,
    study_named,
    vehicle_matrices,
)
from trustlab.teleoperation.ports import METHODS, accounts, held_device
from trustlab.trust.driving import TrustInLoop
from trustlab.trust.interface import TrustDynamics

NOTE = "simulated stand-in for the UAV testbeds of Figs. 3.12 and 3.15"


def tracking_vehicle() -> tuple[TransferFunction, ...]:
    """
    Return the UAV of (A.1) under a low-level velocity controller, as Section 3.6 assumes one.

    State feedback u = (ω² r − (ω² − d_0) v − (2ω − d_1) dv/dt)/gain puts both poles at −ω = −4/s,
    and at −ω for order one. The printed PD controller of Appendix A does not stabilise (A.1) by
    itself on x and y.
    """
    planar = TransferFunction(16.0, (8.0, 16.0))
    return planar, planar, TransferFunction(4.0, (4.0,))


@dataclass(frozen=True)
class TrackingTask(Checked):
    """
    What the target does and what goes wrong on the way.

    Parameters
    ----------
    size_x, size_y : float
        Half lengths of the closed path [m].
    speed : float
        Speed of the target, root mean square [m/s].
    failure_every, failure_length : float
        Mean time between losses of the target by the autonomous controller, and how long one lasts
        [s]; exponential.
    camera_delay : float
        How late pictures arrive at the operator and the controller [s]; at least one sample.
    proportional, integral, derivative : float
        Gains of the hovering PID controller; scheme OMI predicts with the first and the last,
        whoever flies.
    reach : float
        Its largest command on each axis [m/s].
    view : float
        Half the width of the camera's picture [m], which shows operator and controller the target
        from above; without bound when not given (10⁶ m). A target that leaves it is lost until it
        is back: the operator looks where it was last seen, the controller hovers.
    autonomy : callable, optional
        f(state) → u_a [m/s], shape (3,), in place of the PID controller on `state.picture`; like
        that it hovers, and is not asked, while `state.finds` is False.
    vehicle : three TransferFunction, callable or (A, B, C), optional
        Command to velocity per axis; `tracking_vehicle()` when not given. Or f(state) → position
        [m] and velocity [m/s] a sample later, shape (3,) each, under `state.command`. Or the
        matrices of a discrete state space, x' = A x + B u and (position, velocity) = C x', with x =
        0 where it starts. Scheme OMI predicts with three TransferFunction.

    Raises
    ------
    ValueError
        If a number is not finite or out of range, or does nothing beside `autonomy`.

    Examples
    --------
    >>> import trustlab as tl
    >>> calm = tl.TrackingTask(speed=0.1, failure_every=60.0)
    >>> run = tl.simulate_teleoperation("MI", task=calm, duration=5.0, seed=0)
    >>> run.duration
    4.99
    """

    size_x: Positive = 1.5
    size_y: Positive = 1.0
    speed: NotNegative = 0.2
    failure_every: Positive = 15.0
    failure_length: Positive = 4.0
    camera_delay: NotNegative = 0.1
    proportional: NotNegative = 1.0
    integral: NotNegative = 0.1
    derivative: NotNegative = 0.1
    reach: Positive = 1.5
    view: Annotated[float, (1e-6, 1e6)] = 1e6
    autonomy: Callable | None = None
    vehicle: Any = None

    def __post_init__(self):
        super().__post_init__()
        refuse_changed(self, self.autonomy, "a controller", "integral", "reach")
        if is_state_space(self.vehicle):
            state_space(*self.vehicle)
        elif not (self.vehicle is None or callable(self.vehicle)):
            three_axes(self.vehicle)

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
        t, phase = finite_array("t", t), finite_number("phase", phase)
        height = finite_number("height", height)
        x, y = self.size_x, self.size_y
        rate = self.speed / np.sqrt(0.5 * x**2 + 2.0 * y**2)  # root mean square speed: `speed`
        turn = rate * t + phase
        position = np.column_stack(
            [x * np.sin(turn), y * np.sin(2 * turn), np.full(t.size, height)]
        )
        v_x, v_y = x * rate * np.cos(turn), 2 * y * rate * np.cos(2 * turn)
        return position, np.column_stack([v_x, v_y, np.zeros(t.size)])


TASKS = {
    "preliminary": TrackingTask(size_x=6.0, size_y=4.0, speed=0.8, camera_delay=0.2, reach=2.5),
    "main": TrackingTask(),
}
DELAYS = {"preliminary": (0.1, 0.8), "main": (0.03, 0.2)}


class TeleoperationLoop(Loop):
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
    duration : float
        How long the loop can run [s]; what comes from outside is drawn until then.
    task : TrackingTask, optional
        The target, the controller that follows it and the vehicle; the study's own when not given.
    delay : float, callable, Delay, or a pair of these, optional
        Delay both ways [s], or (to the robot, back), at least one sample; random walks of the study
        where None. `packet_delay(sent, received)` is that of a recorded network.
    guidance : {"at_operator", "through_channel"} or Guidance
        How the guiding force reaches the operator, and what keeps it passive.
    trust : callable, TrustDynamics or TrustInLoop, optional
        f(state) → (T_hr, T_rh) a sample later; (3.2) and (3.3) when not given. Or a model of
        `trustlab.trust` in place of (3.2), one trial a second; `trust.TrustInLoop` sets how long a
        trial is.
    signals : mapping of str to array_like, optional
        What comes from outside, a row for each sample, NaN where the loop decides: `alpha`, `beta`,
        `trust_hr`, `trust_rh`, shape (N,); `u_a`, `wanted`, `guiding`, `robot`, `velocity` and
        `hand`, where a hand wants the device to be [m], shape (N, 3); units as of the functions
        that they replace. Without NaN: `push`, a force [N] added to the hand's, shape (N, 3), and
        `arrives`, bool of shape (N, 2), whether the waves sent to the robot and back in a sample
        arrive. `decisions` of another loop repeats its run without its functions, with the same
        seed, task, delays, settings, guidance and operator, whose hand moves and shakes as it did.

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
    >>> loop = tl.TeleoperationLoop("TMIG", study="main", seed=0, duration=2.0)
    >>> loop.step().t
    0.01
    >>> loop.run() == tl.simulate_teleoperation("TMIG", study="main", seed=0, duration=2.0)
    True
    """

    def __init__(
        self,
        scheme: str | Scheme = "TMIG",
        operator: Teleoperator | Callable | None = None,
        study: str | LoopSettings = "main",
        seed: Seed = 0,
        duration: float = 120.0,
        task: TrackingTask | None = None,
        delay: Any = None,
        guidance: str | Guidance = "at_operator",
        trust: Callable | TrustDynamics | TrustInLoop | None = None,
        signals: Mapping[str, Any] | None = None,
    ):
        self.scheme, self.settings = scheme_named(scheme), study_named(study)
        places = {where: Guidance(where) for where in GUIDANCE}
        self.seed, self.guidance = seed, named("guidance", guidance, Guidance, places)
        self.remedy = "lower k_ffa, the hand's gains or the sample time; check guard and vehicle"
        study = self.settings.study
        if operator is None:
            operator = Teleoperator(reach=REACH[study])
        elif callable(operator):
            operator = Teleoperator(law=operator)
        self.operator = of_class("operator", operator, Teleoperator)
        self.task = of_class("task", TASKS[study] if task is None else task, TrackingTask)
        trust = TrustInLoop.of(trust)
        start = trust.start if isinstance(trust, TrustInLoop) else 0.5
        hooks, T = self._functions(trust), self.settings.sample_time
        duration = between("duration", duration, 10.0 * T, min(1e5, 5e6 * T))
        self.count = count = round(duration / T)
        self._bounds = bounds_of(self.settings)
        given = checked_signals(signals, count, self._bounds)
        if not self.scheme.bilateral:
            idle = [name for name in ("force", "budget") if getattr(self.guidance, name)]
            for name in [*idle, *given.keys() & {"guiding", "arrives"}]:
                raise ValueError(
                    f"{name} would do nothing in scheme {self.scheme.name}: no force comes back"
                )
        self._asked = ", ".join([*hooks, *(f"{name} as given" for name in given)])
        seeds = spawned(seed, 5)
        delays = delays_of(self.settings, delay, count, seeds[3:])
        numbers = self._constants(hooks)
        whole = state_of(self.settings, self.guidance, start)
        self.state = View(whole)
        if self.scheme.shares == "optimal":
            share = compiled_for(optimal_share, numbers, whole)
            hooks["scheme"] = lambda view: (share(numbers, whole), view.beta_max)
        inputs = drawn(self.settings, self.task, self.operator, count + 1, seeds)
        arrives = given.pop("arrives", np.ones((count, 2)))
        for name, signal in given.items():
            inputs[name][:-1] = signal
        # Inputs and delays have a row more than the log: padding, for a pause that nobody uses.
        follows_error = self.guidance.where == "through_channel"
        names = {"alpha", *given}
        decide = asking(hooks, self.state, whole, names, self._bounds, follows_error)
        delays = np.pad(delays, ((0, 0), (0, 1)), "edge")
        setup = LoopSetup(numbers, delays, np.ascontiguousarray(arrives.T, bool))
        self.simulation = Simulation(
            teleoperate,
            setup,
            LoopState(whole, np.zeros((2, count, 3)), accounts()),
            inputs,
            np.zeros(count, SAMPLE),
            decide if hooks else None,
            blocks=BLOCKS,
            sample_time=T,
        )

    def _functions(self, trust: Any) -> dict[str, Callable]:
        """Return the functions of a user's in this loop."""
        settings, vehicle = self.settings, self.task.vehicle
        if is_state_space(vehicle):
            vehicle = state_space(*vehicle)
        if isinstance(trust, TrustInLoop):
            models = settings.human_to_robot, settings.robot_to_human
            trust = trust.part(*models, settings.sample_time)
        if trust is not None:
            function("trust", trust)
        hooks = {
            "vehicle": vehicle,
            "trust": trust,
            "autonomy": self.task.autonomy,
            "scheme": self.scheme.shares,
            "operator": self.operator.law,
            "guiding force": self.guidance.force,
        }
        return {part: hook for part, hook in hooks.items() if callable(hook)}

    def _constants(self, hooks: Mapping[str, Callable]) -> np.ndarray:
        """Return the constants, a record of NUMBERS."""
        task, settings = self.task, self.settings
        guidance, person = self.guidance, self.operator
        ends, shares = settings.scattering, self.scheme.shares
        T = settings.sample_time
        hand = person.numbers(T, task.camera_delay)
        if shares == "by hand":
            hand["compensation"] *= 1.0 - person.allocation_cost
        late = max(round(task.camera_delay / T), 1)
        # what a function sets stays until it is asked again
        flies: dict[str, Any] = {"flight": np.eye(3, 4)}
        vehicle = tracking_vehicle() if task.vehicle is None else task.vehicle
        axes = None if "vehicle" in hooks else three_axes(vehicle)
        if axes:
            flies["flight"] = vehicle_matrices(axes, T)
        if shares == "optimal":
            if not axes:
                raise ValueError(
                    "scheme OMI predicts with three TransferFunction: give the vehicle as these"
                )
            gains = (task.proportional, task.derivative)
            flies["blend"] = blending_cost(axes, gains, ends.alpha_min, ends.alpha_max)
        for name, model in (
            ("trust_hr", settings.human_to_robot),
            ("trust_rh", settings.robot_to_human),
        ):
            rates = (1.0, 0.0) if "trust" in hooks else (model.decay(T), model.b / model.a)
            flies[name] = filled(TRUST, model, decay=rates[0], gain=rates[1])
        device = held_device(settings, T, person)
        where, budget = GUIDANCE.index(guidance.where), guidance.budget
        numbers = filled(
            NUMBERS,
            settings,
            guidance=-settings.k_ffa if settings.printed_sign else settings.k_ffa,
            window=max(round(settings.window / T), 1),
            rule=RULES["manual" if callable(shares) else shares],
            law=0 if callable(person.law) else LAWS.index(person.law),
            guard=METHODS[guidance.guard],
            guided_at=where if self.scheme.bilateral else NOWHERE,
            budget_energy=budget.energy if budget else np.inf,
            budget_power=budget.power if budget else 0.0,
            near=ends.at_operator,
            far=ends.at_robot,
            hand=hand,
            auto=filled(AUTONOMY, task, picture=task.view, delay=late),
            device=device,
            admittance=settings.force_scaling * device["lever"] / device["inertia"],
            **flies,
        )
        return np.atleast_1d(numbers)

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
            is then, and the signals of the sample. A vehicle of a user's is asked where it went at
            the next step. `state.copy()` stays as it is.

        Raises
        ------
        ValueError
            If the loop is at its end.
        PartError
            If a function raises an error or returns what cannot be.
        DivergenceError
            If the run grows without bound.
        """
        given = {}
        if alpha is not None:
            given["alpha"] = between("alpha", alpha, *self._bounds["alpha"])
        self._advance(self._held(1, hand, **given))
        return self.state

    @property
    def decisions(self) -> dict[str, np.ndarray]:
        """
        What was decided or came from outside so far, by name, a row for each sample: as `signals`
        of another loop it repeats the run without its functions and hands.
        """
        run = self.simulation
        inputs = run.inputs[: run.done]
        signals = {
            name: inputs[name].copy()
            for name in (*DECIDED.names, "push")
            if not np.isnan(inputs[name]).all()
        }
        for name in {"trust_hr", "trust_rh"} & {*signals}:  # nobody is asked for it at the start
            signals[name][:1] = run.log[name][: min(run.done, 1)]
        if self.scheme.bilateral:
            signals["arrives"] = run.setup.arrives[:, : run.done].T.copy()
        return signals

    def so_far(self) -> Session:
        """The run so far: every signal and every port's energy, labelled synthetic."""
        done = self._done  # once: another thread may step meanwhile, as in a notebook
        rows = self.simulation.log[:done].view(float).reshape(done, -1)
        t = pd.Index(np.round(self.settings.sample_time * np.arange(done), 9), name="t")
        data = pd.DataFrame(rows[:, : len(COLUMNS)].copy(), t, COLUMNS)
        study, delays = self.settings.study, self.simulation.setup.delays[:, :done]
        facts = {
            **described(self.settings),
            "scheme": self.scheme.title,
            "seed": str(self.seed),
            "guidance": changes(self.guidance, Guidance()),
            "task": changes(self.task, TASKS[study]),
            "operator": changes(self.operator, Teleoperator(reach=REACH[study])),
            "samples of delay": f"{delays.min():.3g} to {delays.max():.3g}",
            "parts": self._asked or "built-in",
            "note": NOTE,
        }
        return keep_table(
            data, Metadata(self.operator.participant, self.scheme.name, __name__, True, facts)
        )

    session = property(so_far)


def simulate_teleoperation(
    scheme: str | Scheme = "TMIG",
    operator: Teleoperator | Callable | None = None,
    study: str | LoopSettings = "main",
    seed: Seed = 0,
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
        task, delay, guidance, trust and signals.

    Returns
    -------
    Session
        Every signal and every port's energy; column `alpha` is α, `trust_hr` and `trust_rh` are in
        units of their trust models, `guide` is the force at the haptic device less the channel's
        own damping, f_m − β b r_m. Labelled synthetic.

    Raises
    ------
    ValueError
        If an argument is not understood, before anything runs.
    PartError
        If a function raises an error or returns what cannot be: part and time are named, and
        `.session` of the error is the run so far.
    DivergenceError
        If the run grows without bound: the time and the block are named; likewise.

    Notes
    -----
    Section 3.6 is ``guidance=Guidance("through_channel", guard="cancel")``, but for the sign that
    Section 3.8.1 prints (``printed_sign=True`` of the settings). There the force −k_ffa e stands at
    the robot's port, whose velocity yields to any force by 1/b. Without the controller
    (guard="off") it would drive the robot to its target with nobody at the device, on energy of the
    moving target (`energy_target`), a port that the controller does not observe; with the
    controller the operator feels almost nothing. So neither tells which scheme is better.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.simulate_teleoperation("TMIG", study="main", seed=0, duration=10.0)
    >>> run.duration, run.metadata.synthetic
    (9.99, True)
    """
    return TeleoperationLoop(scheme, operator, study, seed, duration, **options).run()


def checked_signals(signals: Any, count: int, bounds: Mapping) -> dict[str, np.ndarray]:
    """Return what comes from outside as arrays by name, checked."""
    if not isinstance(signals, Mapping | None):
        raise ValueError(f"signals must map names to arrays, got {shown(signals)}")
    shapes = {name: INPUT[name].shape for name in ("push", *DECIDED.names)} | {"arrives": (2,)}
    checked = {}
    for name, values in (signals or {}).items():
        shape = (count, *shapes[one_of("a name in signals", name, shapes)])
        array = np.asarray(values)
        if array.dtype.kind not in "biuf" or array.shape != shape:
            raise ValueError(f"{name} must be numbers of shape {shape}, got {shown(values)}")
        array = checked[name] = array.astype(float)
        # where nothing is decided all of a row is NaN
        decided = ~np.isnan(array.reshape(count, -1)).all(axis=1) | (name not in DECIDED.names)
        finite_numbers(name, np.where(decided, array.T, 0.0).T)
        if name in bounds and decided.any():
            low, high = bounds[name]
            array_between(name, array[decided], low, high, "the loop's settings")
    return checked


def drawn(settings, task, operator, count, seeds) -> np.ndarray:
    """
    Return what is drawn from the seeds, records of INPUT; a longer draw begins with the shorter
    one.
    """
    start, losses, noise = (np.random.default_rng(child) for child in seeds[:3])
    T = settings.sample_time
    t, inputs = T * np.arange(count), np.zeros(count, INPUT)
    phase = start.uniform(0.0, 2.0 * np.pi)
    reference = task.path(t, settings.height, phase)
    inputs["reference"], inputs["reference_velocity"] = reference
    inputs["detected"] = _losses(task, count, T, losses)
    inputs["motor"] = coloured(count, 3, operator.noise_time, T, noise)
    for name in DECIDED.names:
        inputs[name] = np.nan
    return inputs


def _losses(task: TrackingTask, count: int, sample_time: float, rng) -> np.ndarray:
    """Return whether the autonomous controller sees its target, per sample, in turns."""
    means = np.resize([task.failure_every, task.failure_length], count)
    lengths = np.maximum(np.round(rng.exponential(means) / sample_time), 1.0)
    turn = np.searchsorted(np.cumsum(lengths), np.arange(count), side="right")
    return turn % 2 == 0


def delays_of(settings: LoopSettings, delay: Any, count: int, seeds) -> np.ndarray:
    """Return the delays both ways in samples; random walks of the study where none is given."""
    rate, (low, high) = settings.scattering.max_delay_rate, DELAYS[settings.study]
    ways, T = both_ways(delay), settings.sample_time
    for name, child in zip(ways, seeds, strict=True):
        if ways[name] is None:
            seed = int(np.random.default_rng(child).integers(1 << 62))
            ways[name] = random_walk_delay(max(low, T), high, rate, seed)
    return delays_in_samples(ways, rate, count, T)
