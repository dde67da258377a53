"""A simulated operator at the haptic device: a stand-in for people in Chapter 3."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    Share,
    check_participant,
    one_of,
    refuse_changed,
)
from trustlab.models.simulation import filled
from trustlab.teleoperation.loop.kernel import HAND, LAWS

# Largest command [m/s] that operators of each study ask for, above the speed of its target.
REACH = {"preliminary": 2.5, "main": 1.0}

# Least and most skilled value of what skill changes: about a `Teleoperator`'s defaults, which are
# their middles.
RANGES = {
    "proportional": (0.6, 1.4),
    "derivative": (0.2, 0.6),
    "reaction": (0.35, 0.15),
    "lag": (0.22, 0.08),
    "noise": (0.25, 0.05),
}

# What may be assumed of teleoperators: least, most, and the value at which an assumption is off.
# `gain` and `crossover` are factors on the gains of the two laws, `lag` is added to the hand's [s],
# `adapting` is the share of operators whose law is "crossover".
TELEOPERATOR_ASSUMPTIONS = {
    "adapting": (0.0, 1.0, 0.0),
    "gain": (0.1, 3.0, 1.0),
    "crossover": (0.1, 2.0, 1.0),
    "lag": (0.0, 1.0, 0.0),
    "compensation": (0.5, 4.0, 1.0),
    "allocation_cost": (0.0, 0.9, 0.0),
    "fatigue_of_hand": (0.0, 5.0, 0.0),
}


@dataclass(frozen=True)
class Teleoperator(Checked):
    """
    Who holds the haptic device: sees the tracking error late, wants a command in proportion to it,
    and moves the hand there.

    The hand is a spring and a damper about the position it wants to be at, so that it yields to
    force feedback; for a fixed wish it is passive. What it wants is the only source of energy. It
    compensates the device's own spring.

    Parameters
    ----------
    participant : str or int
        Who.
    proportional : float
        Command wanted per metre of error seen [1/s].
    derivative : float
        Command wanted per metre a second of its change [1].
    reaction : float
        Time from what happens to what the hand wants [s], in whole samples of the loop; the
        camera's delay comes on top.
    lag : float
        Neuromuscular lag: time constant of the hand's wish [s].
    reach : float
        Largest command wanted [m/s] on each axis, before `compensation`.
    mass, stiffness, damping : float
        Of the arm that holds the device [kg], [N/m], [N s/m]; massless when not given.
    noise : float
        Standard deviation of motor noise [N] at rest; it grows with the command.
    noise_time : float
        Correlation time of motor noise [s].
    shift : float
        By how much α is moved by hand at a time (scheme MMI).
    patience : float
        How long between two such moves [s].
    compensation : float
        By how much the hand moves more than it should, to make up for the scales of the channel: 1
        not at all. The main study's channel passes 2√β̲ = 0.447 of a command at first, which 2.24
        makes up for, and 0.392 of one that lasts, which needs 2.55.
    law : {"proportional", "crossover"} or callable
        "proportional": `proportional` and `derivative` on the error seen, the same on any channel.
        "crossover": people keep the open loop near its crossover an integrator with a delay, ω_c
        e^(−τs)/s, whatever they control; the robot is an integrator already, so that the gain on
        the error is ω_c over the scale of the channel, which they learn as the ratio of the root
        mean squares of r_s and r_m. Or f(state) → command wanted [m/s] on each axis, shape (3,), in
        place of the proportional law: `state.seen` is the error seen, late by `reaction` and the
        camera's delay, `state.seen_before` that of the sample before, and `state.sees` is False
        before the first picture; `state.memory` is a dictionary, empty at the start. The hand (lag,
        stiffness, noise) stays as it is.
    crossover : float
        ω_c [rad/s] of the law of that name; the loop is stable below π/2 over the whole delay of
        eye, hand and channel.
    adaptation : float
        Time constant of what that law learns of the channel [s].
    allocation_cost : float
        Share of the command that is lost while α must be moved by hand (scheme MMI), below 1.
    fatigue : float
        By how much the hand tires: after a mean force F [N] for t minutes the command is 1/(1 +
        fatigue · F t) of what it would be [1/(N min)].

    Raises
    ------
    ValueError
        If a number is not finite or out of range.

    Notes
    -----
    The defaults are plausible, not measured, and were not chosen for any outcome. Crossover model:
    D. T. McRuer and H. R. Jex, A review of quasi-linear pilot models, IEEE Trans. Human Factors in
    Electronics 8(3), 1967.

    Examples
    --------
    >>> import trustlab as tl
    >>> quick = tl.Teleoperator("quick", reaction=0.15)
    >>> run = tl.simulate_teleoperation("M", quick, duration=5.0, seed=0)
    >>> run.metadata.participant
    'quick'
    """

    participant: str | int = "simulated"
    proportional: NotNegative = 1.0
    derivative: NotNegative = 0.4
    reaction: Annotated[float, (0.0, 2.0)] = 0.25
    lag: Positive = 0.15
    reach: Positive = 1.5
    stiffness: NotNegative = 60.0
    damping: NotNegative = 2.0
    noise: NotNegative = 0.15
    noise_time: Positive = 0.2
    shift: Share = 0.1
    patience: Positive = 3.0
    compensation: Positive = 1.0
    law: Any = "proportional"
    crossover: Positive = 1.2
    adaptation: Positive = 10.0
    allocation_cost: Annotated[float, (0.0, 0.99)] = 0.0
    fatigue: NotNegative = 0.0
    mass: NotNegative = 0.0

    def __post_init__(self):
        super().__post_init__()
        check_participant(self.participant)
        if not callable(self.law):
            one_of("law", self.law, LAWS, also="a function of the state")
        gains = "proportional", "derivative", "crossover", "adaptation"
        refuse_changed(self, self.law, "a law", *gains, "reach", "compensation", "allocation_cost")

    def numbers(self, sample_time: float, camera_delay: float) -> np.void:
        """
        Return the operator as compiled loops take it.

        Parameters
        ----------
        sample_time : float
            T [s].
        camera_delay : float
            How late pictures arrive [s].
        """
        return filled(
            HAND,
            self,
            learned=sample_time / max(self.adaptation, sample_time),
            delay=max(round((self.reaction + camera_delay) / sample_time), 1),
            decay=math.exp(-sample_time / self.lag),
            patience=max(round(self.patience / sample_time), 1),
            fatigue=self.fatigue / 60.0,
        )


# Of operators who adapt: ω_c over their whole delay [rad], of which the camera and the channel take
# some [s].
MARGIN, ON_THE_WAY = 0.6, 0.3


def assumed(row: Mapping[str, Any], assumptions: dict[str, float], place: float) -> dict:
    """
    Return a drawn operator's numbers under assumptions, of which those not named are off.

    row: participant, what skill changes, patience and reach. place: uniform in [0, 1], the
    operator's place among those who adapt.
    """
    usual = {name: off for name, (_, _, off) in TELEOPERATOR_ASSUMPTIONS.items()}
    assumptions = usual | assumptions
    crossover = MARGIN / (row["reaction"] + row["lag"] + ON_THE_WAY)
    changed = {
        "proportional": assumptions["gain"] * row["proportional"],
        "derivative": assumptions["gain"] * row["derivative"],
        "crossover": assumptions["crossover"] * crossover,
        "lag": row["lag"] + assumptions["lag"],
        "compensation": assumptions["compensation"],
        "allocation_cost": assumptions["allocation_cost"],
        "fatigue": assumptions["fatigue_of_hand"],
        "law": "crossover" if place < assumptions["adapting"] else "proportional",
    }
    return dict(row) | changed
