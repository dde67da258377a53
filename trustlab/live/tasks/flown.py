"""
One period of a flight by a person's hand, compiled to WebAssembly for browsers.

A browser's memory holds the arrays that `TeleoperationLoop` keeps, and the parts of the loop stand
in a table of functions, by whose numbers `SETUP` names them there.
"""

import numpy as np
from numba import carray

from trustlab.live.tasks.browser import entry, pointer
from trustlab.teleoperation.loop import kernel
from trustlab.teleoperation.loop.parts import HISTORY, INPUT, LOG, SETUP, SIGNATURE, STATE, Part
from trustlab.teleoperation.loop.schemes import SCHEMES
from trustlab.teleoperation.ports.ledger import ACCOUNT
from trustlab.teleoperation.records import columns_of, record

HAND = record(numbers="reach_x reach_y alpha_min alpha_max", counts="samples")
"""
Where the edge of the hand's square holds the device [m], the bounds of a share by hand, and how
many samples a flight has.
"""

ADDRESSES = record(counts="hand setups states inputs delays arrives accounts history sent table")
"""Where the arrays of a loop are."""

WIDTH = len(columns_of(LOG))

BOOKS = 2
"""Accounts of waves, to the robot and back."""


def fly_there(first, stop, x, y, choice, addresses):
    """
    Fly the samples from `first` to before `stop` under a hand in its square and the share that it
    chose, below 0 for none; return how the run ended, -1 for well.
    """
    at = carray(addresses, 1)[0]
    by_hand = carray(pointer(at.hand), 1, HAND)[0]
    samples = by_hand.samples
    inputs = carray(pointer(at.inputs), samples, INPUT)
    for k in range(first, stop):
        inputs[k].hand[0] = x * by_hand.reach_x
        inputs[k].hand[1] = y * by_hand.reach_y
        inputs[k].hand[2] = 0.0
        if choice >= 0.0:
            inputs[k].alpha = by_hand.alpha_min + choice * (by_hand.alpha_max - by_hand.alpha_min)
    return kernel.advance(
        first,
        stop,
        carray(pointer(at.setups), 1, SETUP),
        carray(pointer(at.states), 1, STATE),
        carray(pointer(at.states), WIDTH, np.float64),  # the row of the log begins the state
        inputs,
        carray(pointer(at.delays), (2, samples), np.float64),
        carray(pointer(at.arrives), (2, samples), np.bool_),
        carray(pointer(at.accounts), BOOKS, ACCOUNT),
        carray(pointer(at.history), samples, HISTORY),
        carray(pointer(at.sent), (2, samples, 3), np.float64),
        carray(pointer(at.table), samples, LOG),
        carray(pointer(at.table), (samples, WIDTH), np.float64),
    )[1]


ENTRIES = {"fly": entry(fly_there, ADDRESSES)}
"""The function that the WebAssembly module exports, and numba's signature."""

PARTS = {
    part.function.__name__: (part.function, SIGNATURE)
    for part in (
        *kernel.DEFAULTS.values(),
        *kernel.LAWS.values(),
        *kernel.GUIDANCE.values(),
        kernel.no_feedback,
        kernel.linear_vehicle,
        *(scheme.shares for scheme in SCHEMES.values()),
    )
    if isinstance(part, Part)
}
"""The built-in parts of a loop, which it calls by their places in the table of functions."""
