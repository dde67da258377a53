"""
Scripted people: hands at the keys of a drive, one with a person's limits; a hand that points; a
person who leads a team. They rehearse studies.
"""

from collections import deque

import numpy as np

from trustlab.live.task import PERIOD

REACTION = 0.2
"""The time from seeing to pressing a key [s], besides that of the video link."""

NEAREST = 0.8
DEAD_BAND = 0.12
SLOW_DOWN = 0.7
"""
Gates nearer than this are passed without looking [m]; smaller bearings are let be [rad]; beyond
this one the forward key is released [rad].
"""

RAMP = ("rise", "fall")
"""How fast a lever moves towards full deflection and back."""

POINTING = 0.5
"""Deflection of a hand that points, for a distance to the target [1/m]."""

MISJUDGED, MISJUDGED_TIME = 0.15, 1.0
"""Standard deviation of a judged bearing [rad] and how long a misjudgement lasts [s]."""


class HumanHand:
    """
    A hand with a person's limits: sees the gates that the robot's camera shows, late, misjudges
    directions, and has keys.

    It turns towards the middle of the nearest gate ahead that is in view, and turns on where none
    is. It follows suggestions, and wants no other switch.
    """

    def __init__(self, config: dict, rng: int | np.random.Generator = 0):
        self.view, self.robot = config["view"], config["robot"]
        self.mode, dt = config["task"]["first_mode"], config["sample_time"]
        self.levers = np.zeros(2)  # forward and left, in [−1, 1]
        self.rise, self.fall = (config["ramp"][name] * dt for name in RAMP)
        self.seen = deque(maxlen=round(REACTION / dt) + 1)
        self.gates = np.array(config["posts"]).reshape(-1, 2, 2) @ (1.0, 1j)
        self.rng = np.random.default_rng(rng)
        self.keep = np.exp(-dt / MISJUDGED_TIME)
        self.misjudged = self.bearing = 0.0

    def __call__(self, picture: dict) -> list[float]:
        """Return the command that follows a picture, within the robot's limits."""
        self.seen.append((complex(picture["x"], picture["y"]), picture["yaw"]))
        self.misjudged *= self.keep
        self.misjudged += np.sqrt(1.0 - self.keep**2) * self.rng.standard_normal()
        bearing = self.look(*self.seen[0])
        if bearing is None:  # look for the next gate where the last one was
            self.bearing = np.sign(self.bearing) * (SLOW_DOWN + 0.1)
        else:
            self.bearing = bearing + MISJUDGED * self.misjudged
        size = abs(self.bearing)
        keys = np.array([size < SLOW_DOWN, np.sign(self.bearing) * (size >= DEAD_BAND)])
        most = np.where(np.abs(keys) > np.abs(self.levers), self.rise, self.fall)
        self.levers += np.clip(keys - self.levers, -most, most)
        v, w = self.levers.tolist()
        mode, suggested = (picture["row"] or (self.mode, -1))[:2]
        wanted = mode if suggested < 0 else suggested
        return [self.robot["max_speed"] * v, self.robot["max_turn_rate"] * w, wanted]

    def look(self, place: complex, yaw: float) -> float | None:
        """
        Return the bearing of the middle of the nearest gate in view [rad], positive to the left.
        """
        away = (self.gates - place) * np.exp(-1j * yaw)  # ahead, and to the left
        near = np.abs(away) < self.view["range"]
        in_view = near & (np.abs(np.angle(away)) < 0.5 * self.view["field"])
        # The left row of posts has a colour of its own: gates are not taken backwards.
        facing = away[:, 0].imag > away[:, 1].imag
        middle = away.mean(axis=1)
        middle = middle[in_view.any(axis=1) & facing & (middle.real > NEAREST)]
        return float(np.angle(middle[np.abs(middle).argmin()])) if middle.size else None


class TrackingHand:
    """A scripted hand that points where the camera shows the target, and the better half of α."""

    def __init__(self, config: dict, rng: np.random.Generator):
        self.choice = 0.5 if config["allocates"] else -1.0
        self.rng = rng
        self.gain = POINTING * rng.uniform(0.6, 1.4)

    def __call__(self, picture: dict) -> tuple[float, float, float]:
        """Return the command that follows a picture."""
        target = picture.get("target") or (0.0, 0.0)
        x, y = np.clip(self.gain * np.array(target) + 0.03 * self.rng.normal(size=2), -1.0, 1.0)
        return float(x), float(y), self.choice


class ScriptedLeader:
    """
    A scripted person: pulls towards the goal, and now and then lets a robot lead: the most trusted
    one, the one nearest to the goal, or any.
    """

    def __init__(self, config: dict, rng: np.random.Generator):
        self.rng = rng
        self.by_trust, self.by_distance = rng.dirichlet((2.0, 1.0, 0.5))[:2]
        self.rate = PERIOD / rng.uniform(6.0, 15.0)
        self.follows = rng.uniform(0.4, 1.0)
        self.choice = 0
        self.answered = 0
        self.advised = config["condition"] == "suggested"

    def __call__(self, picture: dict) -> tuple[float, float, int]:
        """Return the command that follows a picture."""
        robots, goal = np.array(picture["robots"]), np.array(picture["goal"])
        away = goal - robots
        pull = away[max(picture["leader"] - 1, 0)]
        x, y = np.clip(pull + 0.05 * self.rng.normal(size=2), -1.0, 1.0)
        suggested = picture["suggested"]
        if suggested and suggested != self.answered and self.rng.random() < self.follows:
            self.choice = suggested
        elif not self.advised and self.rng.random() < self.rate:
            self.choice = self._pick(away, picture["trust"])
        self.answered = suggested
        return float(x), float(y), self.choice

    def _pick(self, away: np.ndarray, trust: list[float]) -> int:
        draw = self.rng.random()
        if draw < self.by_trust:
            return int(np.argmax(trust)) + 1
        if draw < self.by_trust + self.by_distance:
            return int(np.argmin(np.hypot(*away.T))) + 1
        return int(self.rng.integers(len(away))) + 1
