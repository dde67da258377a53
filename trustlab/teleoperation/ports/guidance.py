"""The guiding force at the robot's port: a spring to the target, and how the passivity controller limits what it does."""

import numpy as np

from trustlab.models.compiled import njit
from trustlab.teleoperation.ports.passivity import activation, demanded


@njit(error_model="numpy", forceinline=True)
def guiding_force(stiffness, error):
    """Return the force −k_ffa e that the robot's port feels: the tracking error pulls the robot to its target."""
    return -stiffness * error


@njit(error_model="numpy", forceinline=True)
def velocity_share(guard, energy, velocity, force, compliance, sample_time):
    """
    Return the share of the port's velocity that the passivity controller of Theorem 4 lets pass, 1 where it rests.

    velocity, force, shape (3,): what the port would do without the controller. The port yields to the force, so that
    damping z divides its velocity by 1 + compliance z.
    """
    power = square = 0.0
    for i in range(3):
        power += velocity[i] * force[i]
        square += velocity[i] ** 2
    demand = demanded(guard, energy, power, sample_time)
    if np.isnan(demand) or square == 0.0:
        return 1.0
    return 1.0 / (1.0 + activation(power, square, compliance, demand)[0])
