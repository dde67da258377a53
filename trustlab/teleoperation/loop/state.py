"""What the compiled loop reads and leaves: the records of its state, its log, its inputs, its history and its constants."""

from typing import NamedTuple, get_type_hints

import numpy as np

from trustlab.allocation.blending import DEGREE
from trustlab.teleoperation.ports import device as haptic, waves
from trustlab.teleoperation.records import columns_of, record

# What a user may replace, and which fields of the state each part sets.
PORTS = {
    "scheme": ("alpha", "beta"),
    "trust": ("trust_hr", "trust_rh"),
    "feedback": ("guiding",),
    "autonomy": ("u_a",),
    "operator": ("wanted",),
    "vehicle": ("robot", "velocity"),
}

# Numbers that every part keeps from sample to sample, zero at the start.
MEMORY = 16

# A row of the log: the state before the sample and the signals of the sample.
LOG = np.dtype(
    record(
        vectors="reference robot velocity device device_velocity r_m f_h f_m r_s f_s u_h u_a u_i",
        numbers=(
            "alpha beta p_r p_h trust_hr trust_rh path_error port_share "
            "energy_operator energy_device energy_dissipated energy_channel energy_robot"
        ),
    ).descr
    + record(vectors="guide", numbers="energy_port energy_target").descr
)

COLUMNS = columns_of(LOG)

# What comes from outside in one sample: where the robot should be and how fast it should move, how far the target moves on
# within the operator's preview, noise of the hand, a force added to the hand's, where the hand wants to be and α where they are given (NaN elsewhere), and whether the controller's
# camera finds its target.
INPUT = record(vectors="reference reference_velocity ahead motor pushed hand", numbers="alpha", flags="detected")

# What is looked up later: errors as they were seen, energies as they were sent, performance that leaves its window.
HISTORY = record(vectors="error", numbers="good_r good_h in_near in_far")

# The state proper: lagging wish of the hand, integral of the controller, acceleration; and what came with this sample.
KEPT = "acceleration wish integral drift reference_velocity pushed motor hand error"
# What has arrived by now: the picture of camera and operator (and the one before), waves, and what a packet brought.
ARRIVED = "picture picture_before seen seen_before v_l v_r arrived packet_force"
# What the parts of a step tell each other.
SIGNALS = "wanted force free_output stretch guiding pull free_velocity compliance u_l u_r middle command"
BOUNDS = "sample_time alpha_min alpha_max beta_min beta_max"
# The whole state of the loop, which every part reads and changes; it begins with the row of the log.
STATE = np.dtype(
    LOG.descr
    + record(
        vectors=f"{KEPT} {ARRIVED} {SIGNALS}",
        numbers=(
            f"t {BOUNDS} sum_r sum_h good_r good_h leaving_r leaving_h in_near out_near in_far out_far known_near known_far"
        ),
        counts="waited samples",
    ).descr
    + [(f"{port}_memory", float, MEMORY) for port in PORTS]
    + record(flags="sees finds found_before raised").descr
)

# Exact one-sample matrices of (position, velocity, acceleration) per axis.
VEHICLE = np.dtype([("phi", float, (3, 3, 3)), ("gamma", float, (3, 3))])

# The haptic device in its hand, axis by axis.
DEVICE = record(vectors=" ".join(haptic.Device._fields))


class ScaleNumbers(NamedTuple):
    """A scale as a function of trust, (3.5) or (3.6), trust being a share of its range."""

    low: float
    high: float
    steepness: float
    midpoint: float


class TrustNumbers(NamedTuple):
    """A `TrustModel` for one sample time; `start` is a share of the range of trust, `gain` is b/a."""

    decay: float
    gain: float
    start: float
    p_min: float
    p_max: float
    t_min: float
    t_max: float


class LoopNumbers(NamedTuple):
    """Channel, guidance, trust and scales as plain numbers; see `LoopSettings`."""

    sample_time: float
    force_scaling: float
    b: float
    gain: float
    guidance: float
    alpha: ScaleNumbers
    beta: ScaleNumbers
    trust_hr: TrustNumbers
    trust_rh: TrustNumbers
    window: int
    command_range: float
    error_range: float


class HandNumbers(NamedTuple):
    """The simulated hand and eye: gains on the error seen, delay in samples, lag, impedance, and handling of α."""

    proportional: float
    derivative: float
    compensation: float
    crossover: float
    learned: float  # share of what is new in what an operator knows of the channel, per sample
    delay: int
    decay: float
    reach: float
    stiffness: float
    damping: float
    noise: float
    shift: float
    patience: int


class AutonomyNumbers(NamedTuple):
    """The autonomous controller (PID on what the camera saw `delay` samples ago), half its picture's width, and the ideal one."""

    proportional: float
    integral: float
    derivative: float
    delay: int
    reach: float
    picture: float
    ideal: float


def record_of(kind: type) -> np.dtype:
    """Return the record that holds a NamedTuple of numbers and of NamedTuples."""
    hints = get_type_hints(kind)
    return np.dtype([(name, record_of(one) if hasattr(one, "_fields") else one) for name, one in hints.items()])


# What stays the same during a run; `parts` holds the addresses of the compiled parts.
SETUP = np.dtype(
    [
        ("loop", record_of(LoopNumbers)),
        ("hand", record_of(HandNumbers)),
        ("auto", record_of(AutonomyNumbers)),
        ("device", DEVICE),
        ("admittance", float, 3),
        ("near", record_of(waves.OperatorEnd)),
        ("far", record_of(waves.RobotEnd)),
        ("vehicle", VEHICLE),
        ("blend", float, (3, DEGREE + 1, 5, 5)),
        ("tank", float),
        ("guard", int),
        ("read_out", int),
        ("channel", int),
        ("parts", record(counts=f"guidance {' '.join(PORTS)}")),
    ]
)
