"""
One period of a flight by a person's hand, compiled to WebAssembly for browsers.

A browser's memory holds the arrays of a `TeleoperationLoop`. Scheme OMI, which decides outside the
kernel there, decides here as well.
"""

import numpy as np
from numba import carray

from trustlab.live.tasks.browser import entry, pointer
from trustlab.teleoperation.loop.kernel import teleoperate
from trustlab.teleoperation.loop.records import (
    INPUT,
    NUMBERS,
    SAMPLE,
    STATE,
    LoopSetup,
    LoopState,
)
from trustlab.teleoperation.loop.settings import optimal_share
from trustlab.teleoperation.ports.waves import ACCOUNT
from trustlab.teleoperation.records import record

HAND = record(numbers="reach_x reach_y alpha_min alpha_max", counts="samples", flags="optimal")
"""
Where the edge of the hand's square holds the device [m], the bounds of a share by hand, how many
samples a flight has, and whether the scheme is OMI.
"""

ADDRESSES = record(counts="hand numbers delays arrives whole sent accounts inputs log")
"""Where the arrays of a loop are."""

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
    setup = LoopSetup(
        carray(pointer(at.numbers), 1, NUMBERS),
        carray(pointer(at.delays), (2, samples + 1), np.float64),
        carray(pointer(at.arrives), (2, samples), np.bool_),
    )
    state = LoopState(
        carray(pointer(at.whole), 1, STATE),
        carray(pointer(at.sent), (2, samples, 3), np.float64),
        carray(pointer(at.accounts), BOOKS, ACCOUNT),
    )
    inputs = carray(pointer(at.inputs), samples + 1, INPUT)
    log = carray(pointer(at.log), samples, SAMPLE)
    for k in range(first, stop):
        inputs[k].hand[0] = x * by_hand.reach_x
        inputs[k].hand[1] = y * by_hand.reach_y
        inputs[k].hand[2] = 0.0
        if by_hand.optimal:
            inputs[k].alpha = optimal_share(setup.numbers, state.whole)
        if choice >= 0.0:
            inputs[k].alpha = by_hand.alpha_min + choice * (by_hand.alpha_max - by_hand.alpha_min)
        _, block = teleoperate(k, k + 1, setup, state, inputs, log)
        if block != -1:
            return block
    return -1


ENTRIES = {"fly": entry(fly_there, ADDRESSES)}
"""The function that the WebAssembly module exports, and numba's signature."""
