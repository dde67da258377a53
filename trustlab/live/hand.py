"""
Scripted hands at the keys of a live drive, one with a person's limits: what they reach tells how
hard the task is.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from trustlab.live.runs import Drive, drive_config, session_of
from trustlab.models.checks import whole_number
from trustlab.reproduction.published import published_models, published_table
from trustlab.sessions.session import Session
from trustlab.testbeds.ground_robot.course import path_point

REACTION = 0.2
"""The time from seeing to pressing a key [s], besides that of the video link."""

NEAREST = 0.8
DEAD_BAND = 0.12
SLOW_DOWN = 0.7
"""
Gates nearer than this are passed without looking [m]; smaller bearings are let be [rad]; beyond
this one the forward key is released [rad].
"""

MISJUDGED, MISJUDGED_TIME = 0.15, 1.0
"""Standard deviation of a judged bearing [rad] and how long a misjudgement lasts [s]."""


class Keys:
    """Levers that keys move: forward and left, in [−1, 1], with the ramp of a drive."""

    def __init__(self, config: Mapping[str, Any]):
        self.levers = np.zeros(2)
        self.step = {name: rate * config["sample_time"] for name, rate in config["ramp"].items()}

    def press(self, forward: int, left: int) -> np.ndarray:
        """Hold keys for one sample (−1, 0 or 1 each); return where the levers are then."""
        for i, target in enumerate((forward, left)):
            now = self.levers[i]
            most = self.step["rise"] if abs(target) > abs(now) else self.step["fall"]
            self.levers[i] = now + min(max(target - now, -most), most)
        return self.levers


class HumanHand:
    """
    A hand with a person's limits: sees the gates that the robot's camera shows, late, misjudges
    directions, and has keys.

    It turns towards the middle of the nearest gate ahead that is in view, and turns on where none
    is.
    """

    def __init__(self, config: Mapping[str, Any], seed: int | np.random.SeedSequence = 0):
        self.view = config["view"]
        self.keys = Keys(config)
        self.robot = config["robot"]
        late = round((self.view["delay"] + REACTION) / config["sample_time"])
        self.seen: deque = deque(maxlen=late + 1)
        self.gates = np.array(config["posts"]).reshape(-1, 2, 2)
        self.rng = np.random.default_rng(seed)
        self.keep = np.exp(-config["sample_time"] / MISJUDGED_TIME)
        self.misjudged, self.bearing = 0.0, 0.0

    def look(self, x: float, y: float, yaw: float) -> float | None:
        """
        Return the bearing of the middle of the nearest gate in view [rad], positive to the left.
        """
        away = self.gates - (x, y)
        cos, sin = np.cos(yaw), np.sin(yaw)
        ahead, left = away @ (cos, sin), away @ (-sin, cos)
        in_view = (np.hypot(ahead, left) < self.view["range"]) & (
            np.abs(np.arctan2(left, ahead)) < 0.5 * self.view["field"]
        )
        middle_x, middle_y = 0.5 * (ahead[:, 0] + ahead[:, 1]), 0.5 * (left[:, 0] + left[:, 1])
        facing = (
            left[:, 0] > left[:, 1]
        )  # the left row of posts has a colour of its own: gates are not taken backwards
        distance = np.where(
            (in_view[:, 0] | in_view[:, 1]) & facing & (middle_x > NEAREST),
            np.hypot(middle_x, middle_y),
            np.inf,
        )
        i = int(np.argmin(distance))
        return float(np.arctan2(middle_y[i], middle_x[i])) if np.isfinite(distance[i]) else None

    def step(self, state: Any) -> tuple[float, float]:
        """Return the command v, w that follows a state of the robot."""
        self.seen.append((float(state["x"]), float(state["y"]), float(state["yaw"])))
        self.misjudged = (
            self.keep * self.misjudged + np.sqrt(1.0 - self.keep**2) * self.rng.standard_normal()
        )
        bearing = self.look(*self.seen[0])
        if bearing is None:
            self.bearing = np.sign(self.bearing) * (
                SLOW_DOWN + 0.1
            )  # look for the next gate where the last one was
        else:
            self.bearing = bearing + MISJUDGED * self.misjudged
        forward = 1 if abs(self.bearing) < SLOW_DOWN else 0
        left = 0 if abs(self.bearing) < DEAD_BAND else int(np.sign(self.bearing))
        lever = self.keys.press(forward, left)
        return self.robot["max_speed"] * lever[0], self.robot["max_turn_rate"] * lever[1]


class IdealHand:
    """
    A hand without limits: sees the path and steers to a point ahead on it, at once and as finely as
    it likes.
    """

    def __init__(self, config: Mapping[str, Any]):
        self.path, self.robot = np.array(config["path"]), config["robot"]

    def step(self, state: Any) -> tuple[float, float]:
        """Return the command v, w that follows a state of the robot."""
        x, y, _, _ = path_point(float(state["arc"]) + 0.6, self.path)
        bearing = np.arctan2(y - state["y"], x - state["x"]) - state["yaw"]
        bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
        return self.robot["max_speed"], 2.5 * bearing


def live_difficulty(seeds: int = 3, laps: int = 2) -> pd.DataFrame:
    """
    Return how hard the live task is: P_r and P_h of scripted hands, driving alone, beside the
    printed people's.

    Parameters
    ----------
    seeds : int
        How many drives of each hand.
    laps : int
        How many laps each; means are over what follows the first 100 s, in which the window of
        (2.4) and (2.7) fills.

    Returns
    -------
    pandas.DataFrame
        Columns who, source ("simulated" or "printed"), p_r, p_h [m/s] and path_error [m]. The
        printed rows are the means of Table 2.5, C1 to C5, in which the robot drives a part of the
        time, and the participants' P_r,max and P_h,max of Table 2.1.

    Raises
    ------
    ValueError
        If a number is not whole and positive.
    """
    seeds, laps = whole_number("seeds", seeds), whole_number("laps", laps, least=2)
    rows = []
    for kind in (IdealHand, HumanHand):
        for seed in range(seeds):
            config = drive_config("training", laps=laps, seed=seed)
            hand = kind(config, seed) if kind is HumanHand else kind(config)
            data = scripted_drive(config, hand)[1].data
            rows.append(
                (kind.__name__, "simulated", *data.loc[100.0:, ["p_r", "p_h", "path_error"]].mean())
            )
    columns = ["who", "source", "p_r", "p_h", "path_error"]
    hands = (
        pd.DataFrame(rows, columns=columns)
        .groupby(["who", "source"], sort=False, as_index=False)
        .mean()
    )
    table, models = published_table("2.5"), published_models()
    means = table[["P_r_mean", "P_h_mean"]].astype(float)
    printed = [(f"people, {c}", "printed", p_r, p_h, np.nan) for c, p_r, p_h in means.itertuples()]
    best = [
        (f"participant {n}", "printed", models[n].robot.p_max, models[n].human.p_max, np.nan)
        for n in "12345"
    ]
    return pd.concat([hands, pd.DataFrame(printed + best, columns=columns)], ignore_index=True)


def scripted_drive(config: Mapping[str, Any], hand: Any) -> tuple[np.ndarray, Session]:
    """
    Return rows and session of a whole drive by a hand that follows suggestions, or the drive's
    schedule of modes.
    """
    drive, phases = Drive(config), config["schedule"] or [[config["task"]["first_mode"], np.inf]]
    ends = np.cumsum([length for _, length in phases]) / config["sample_time"]
    suggested = -1.0
    while not drive.done:
        v, w = hand.step(drive.state)
        scheduled = phases[min(int(np.searchsorted(ends, drive.k, side="right")), len(phases) - 1)][
            0
        ]
        suggested = drive.step(v, w, scheduled if suggested < 0.0 else suggested)["suggested_mode"]
    rows = drive.rows[: drive.k].copy()
    return rows, session_of(config, rows, participant=type(hand).__name__, synthetic=True)
