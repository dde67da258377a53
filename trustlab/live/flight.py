"""A UAV that a person's hand flies: the teleoperation loop, and what its pages draw."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from trustlab.operators.teleoperator import REACH
from trustlab.teleoperation.loop.settings import study_named
from trustlab.testbeds.uav_tracking import TeleoperationLoop

DEFLECTION = 2.0
"""
At the edge of the hand's square the command is so many times the largest one of the study's
simulated operators.
"""

UNBOUNDED = 1e6
"""The `view` of a task whose camera always has its target in the picture [m]."""


class Flight:
    """A teleoperation loop under a hand in the square [−1, 1] × [−1, 1]."""

    def __init__(self, arguments: Mapping[str, Any]):
        self.arguments, self.loop = arguments, TeleoperationLoop(**arguments)
        # compiles, and refuses what only a step can refuse, before anybody drives
        TeleoperationLoop(**arguments).step()
        self.settings, self.task = study_named(arguments["study"]), arguments["task"]
        self.sample_time = self.loop.sample_time
        weight = np.broadcast_to(self.settings.weight, 3)[:2]
        self.reach = DEFLECTION * REACH[self.settings.study] / weight
        self.late = max(round(self.task.camera_delay / self.sample_time), 1)
        self.pictures: deque = deque([(np.zeros(3), np.zeros(3))], maxlen=self.late + 1)

    def held(self, x: float, y: float) -> tuple[float, float, float]:
        """Return where a place in the square holds the device [m]."""
        return float(x * self.reach[0]), float(y * self.reach[1]), 0.0

    def sample(self, hand: tuple[float, float, float], alpha: float | None = None) -> Any:
        """Fly one sample under a hand that holds the device somewhere; return the state."""
        state = self.loop.step(hand=np.array(hand), alpha=alpha)
        self.pictures.append((state.error.copy(), state.reference - state.error))
        return state

    def shown(self) -> dict[str, Any]:
        """
        Return what the page draws: the camera's picture as late as it arrives, the device, forces,
        energies and shares.
        """
        state, (error, robot) = self.loop.state, self.pictures[0]
        seen = bool((np.abs(error[:2]) <= self.task.view).all())
        energies = {
            name: state[f"energy_{name}"] for name in ("operator", "device", "dissipated", "port")
        }
        return {
            "t": self.loop.t,
            "target": error[:2].tolist() if seen else None,
            "robot": robot[:2].tolist(),
            "device": (state.device[:2] / self.reach).tolist(),
            "force": (-self.settings.force_scaling * state.f_m[:2]).tolist(),
            "guide": (-self.settings.force_scaling * state.guide[:2]).tolist(),
            "energies": {name: float(value) for name, value in energies.items()},
            "alpha": float(state.alpha),
            "beta": float(state.beta),
        }
