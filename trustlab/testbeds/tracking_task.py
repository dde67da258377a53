"""
The task of the UAV testbeds: a target on a closed path, an autonomous controller that loses it, and
the vehicle flown.
"""

from dataclasses import dataclass

import numpy as np

from trustlab.models.checks import between, not_negative, positive
from trustlab.models.uav import PRINTED_UAV, TransferFunction
from trustlab.teleoperation.loop.state import AUTONOMY
from trustlab.teleoperation.records import filled


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
        rate = self.speed / np.sqrt(
            0.5 * self.size_x**2 + 2.0 * self.size_y**2
        )  # root mean square speed
        turn = rate * t + phase
        position = np.column_stack(
            [self.size_x * np.sin(turn), self.size_y * np.sin(2 * turn), np.full(t.size, height)]
        )
        velocity = np.column_stack(
            [
                self.size_x * rate * np.cos(turn),
                2 * self.size_y * rate * np.cos(2 * turn),
                np.zeros(t.size),
            ]
        )
        return position, velocity


TASKS = {
    "preliminary": TrackingTask(size_x=6.0, size_y=4.0, speed=0.8, camera_delay=0.2, reach=2.5),
    "main": TrackingTask(),
}
DELAYS = {"preliminary": (0.1, 0.8), "main": (0.03, 0.2)}
