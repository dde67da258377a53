"""A UAV that a person's hand flies: the teleoperation loop, and what its pages draw."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from trustlab.operators.teleoperator import REACH
from trustlab.teleoperation.loop.records import SAMPLE
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
        TeleoperationLoop(**{**arguments, "duration": 1.0}).step()
        self.settings, self.task = self.loop.settings, self.loop.task
        self.sample_time = self.settings.sample_time
        weight = np.broadcast_to(self.settings.weight, 3)[:2]
        self.reach = DEFLECTION * REACH[self.settings.study] / weight
        self.late = max(round(self.task.camera_delay / self.sample_time), 1)

    def held(self, x: float, y: float) -> tuple[float, float, float]:
        """Return where a place in the square holds the device [m]."""
        return float(x * self.reach[0]), float(y * self.reach[1]), 0.0

    def sample(self, hand: tuple[float, float, float], alpha: float | None = None) -> np.void:
        """Fly one sample under a hand that holds the device somewhere; return its row."""
        self.loop.step(hand=np.array(hand), alpha=alpha)
        return self.row()

    def row(self, before: int = 0) -> np.void:
        """Return what was logged of the last sample, or of one before; zeros before the first."""
        run = self.loop.simulation
        k = run.done - 1 - before
        return np.zeros(1, SAMPLE)[0] if k < 0 else run.log[k]

    def shown(self) -> dict[str, Any]:
        """
        Return what the page draws: the camera's picture as late as it arrives, the device, forces,
        energies and shares.
        """
        now, picture = self.row(), self.row(self.late)
        error = picture["error"]
        seen = bool((np.abs(error[:2]) <= self.task.view).all())
        energies = ("operator", "device", "dissipated", "port")
        return {
            "t": self.loop.t,
            "target": error[:2].tolist() if seen else None,
            "robot": picture["robot"][:2].tolist(),
            "device": (now["device"][:2] / self.reach).tolist(),
            "force": (-self.settings.force_scaling * now["f_m"][:2]).tolist(),
            "guide": (-self.settings.force_scaling * now["guide"][:2]).tolist(),
            "energies": {name: float(now[f"energy_{name}"]) for name in energies},
            "alpha": float(now["alpha"]),
            "beta": float(now["beta"]),
        }
