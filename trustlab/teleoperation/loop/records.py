"""The records of the teleoperation loop: what is constant, carried on, given and logged."""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.blending import DEGREE
from trustlab.models.records import columns_of, record
from trustlab.teleoperation.ports.device import DEVICE
from trustlab.teleoperation.ports.waves import END

# A row of the log: the state before the sample and the signals of the sample.
LOGGED = record(
    vectors="reference robot velocity device device_velocity r_m f_h f_m r_s f_s u_h u_a u_i guide",
    numbers="alpha beta p_r p_h trust_hr trust_rh path_error port_share energy_operator "
    "energy_device energy_dissipated energy_channel energy_robot energy_port energy_target "
    "energy_guidance",
)
COLUMNS = columns_of(LOGGED)

# Beside it, what later samples look up.
SAMPLE = np.dtype([*LOGGED.descr, *record(vectors="error", numbers="good_r good_h").descr])

# Room that scheme OMI computes in: what lies ahead, the cost as a series in α.
BLENDING = record(ahead=(float, (3, 5)), series=(float, DEGREE + 1))

# The state: what the loop carries on, what has arrived, what the steps of a sample tell each other,
# and the sample. `account`: what the operator's port may spend [J].
STATE = record(
    vectors="reference_velocity acceleration wish integral picture picture_before seen seen_before "
    "v_l v_r arrived wanted force free_output stretch guiding pull middle command",
    numbers="t sample_time alpha_min alpha_max beta_min beta_max account effort square_m square_s "
    "sum_r sum_h",
    counts="waited",
    flags="sees finds found_before",
    now=SAMPLE,
    blending=BLENDING,
)

# What is decided in a sample; NaN leaves it to what is built in.
DECIDED = record(
    vectors="robot velocity u_a wanted guiding hand", numbers="alpha beta trust_hr trust_rh"
)
# What comes from outside in a sample: where the robot should be and how fast it should move, noise
# of the hand, a force added to the hand's, whether the controller's camera finds its target; and
# what is decided.
EXTERNAL = record(vectors="reference reference_velocity motor push", flags="detected")
INPUT = np.dtype([*EXTERNAL.descr, *DECIDED.descr])

# A `TrustModel` for one sample time; `gain` is b/a.
TRUST = record(numbers="decay gain p_min p_max t_min t_max")

# The simulated hand and eye: gains on the error seen, delay in samples, lag, impedance, and
# handling of α; `learned` is the share of what is new, per sample, in what an operator knows of the
# channel.
HAND = record(
    numbers="proportional derivative compensation crossover learned decay reach mass stiffness "
    "damping noise shift fatigue",
    counts="delay patience",
)

# The autonomous controller (PID on what the camera saw `delay` samples ago), and half its picture's
# width.
AUTONOMY = record(numbers="proportional integral derivative reach picture", counts="delay")

NUMBERS = record(
    numbers="sample_time force_scaling gain guidance steepness command_range error_range "
    "budget_energy budget_power admittance",
    counts="window rule law guard guided_at",
    trust_hr=TRUST,
    trust_rh=TRUST,
    hand=HAND,
    auto=AUTONOMY,
    device=DEVICE,
    near=END,
    far=END,
    # exact one-sample matrices of (position, velocity, acceleration) per axis
    phi=(float, (3, 3, 3)),
    gamma=(float, (3, 3)),
    blend=(float, (DEGREE + 1, 3, 5, 5)),  # the cost of Appendix A
)


class LoopSetup(NamedTuple):
    """
    What stays the same in a run of K samples.

    numbers, shape (1,): a record of NUMBERS. delays, shape (2, K + 1): delay in samples, to the
    robot and back. arrives, shape (2, K): whether what is sent in a sample arrives at all.
    """

    numbers: np.ndarray
    delays: np.ndarray
    arrives: np.ndarray


class LoopState(NamedTuple):
    """
    What samples hand on; changed in place.

    whole, shape (1,): a record of STATE. sent, shape (2, K, 3): waves by the sample that they were
    sent in, to the robot and back. accounts: `waves.accounts()`.
    """

    whole: np.ndarray
    sent: np.ndarray
    accounts: np.ndarray
