"""
What the compiled loop reads and leaves: the records of its state, its log, its inputs, its history
and its constants.
"""

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

# What comes from outside in one sample: where the robot should be and how fast it should move, how
# far the target moves on within the operator's preview, noise of the hand, a force added to the
# hand's, where the hand wants to be and α where they are given (NaN elsewhere), and whether the
# controller's camera finds its target.
INPUT = record(
    vectors="reference reference_velocity ahead motor pushed hand",
    numbers="alpha",
    flags="detected",
)

# What is looked up later: errors as they were seen, energies as they were sent, performance that
# leaves its window.
HISTORY = record(vectors="error", numbers="good_r good_h in_near in_far")

# The state proper: lagging wish of the hand, integral of the controller, acceleration; and what
# came with this sample.
KEPT = "acceleration wish integral drift reference_velocity pushed motor hand error"
# What has arrived by now: the picture of camera and operator (and the one before), waves, and what
# a packet brought.
ARRIVED = "picture picture_before seen seen_before v_l v_r arrived packet_force"
# What the parts of a step tell each other.
SIGNALS = (
    "wanted force free_output stretch guiding pull free_velocity compliance u_l u_r middle command"
)
BOUNDS = "sample_time alpha_min alpha_max beta_min beta_max"
# The whole state of the loop, which every part reads and changes; it begins with the row of the
# log.
STATE = np.dtype(
    LOG.descr
    + record(
        vectors=f"{KEPT} {ARRIVED} {SIGNALS}",
        numbers=(
            f"t {BOUNDS} sum_r sum_h good_r good_h leaving_r leaving_h in_near out_near in_far "
            "out_far known_near known_far"
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

# A `TrustModel` for one sample time; `gain` is b/a.
TRUST = record(numbers="decay gain p_min p_max t_min t_max")

# Channel, guidance, trust, scales and measures of performance; see `LoopSettings`.
NUMBERS = record(
    numbers="force_scaling gain guidance steepness command_range error_range", counts="window"
)
LOOP = np.dtype([*NUMBERS.descr, ("trust_hr", TRUST), ("trust_rh", TRUST)])

# The simulated hand and eye: gains on the error seen, delay in samples, lag, impedance, and
# handling of α; `learned` is the share of what is new, per sample, in what an operator knows of the
# channel.
HAND = record(
    numbers="proportional derivative compensation crossover learned decay reach stiffness "
    "damping noise shift",
    counts="delay patience",
)

# The autonomous controller (PID on what the camera saw `delay` samples ago), and half its picture's
# width.
AUTONOMY = record(numbers="proportional integral derivative reach picture", counts="delay")

# One end of the channel: what multiplies velocity or force and waves, see `OperatorEnd` and
# `RobotEnd`.
END = record(numbers=" ".join(waves.OperatorEnd._fields))

# What stays the same during a run; `parts` holds the addresses of the compiled parts.
SETUP = np.dtype(
    [
        ("loop", LOOP),
        ("hand", HAND),
        ("auto", AUTONOMY),
        ("device", DEVICE),
        ("admittance", float, 3),
        ("near", END),
        ("far", END),
        ("vehicle", VEHICLE),
        ("blend", float, (3, DEGREE + 1, 5, 5)),
        ("tank", float),
        ("guard", int),
        ("read_out", int),
        ("channel", int),
        ("parts", record(counts=f"guidance {' '.join(PORTS)}")),
    ]
)
