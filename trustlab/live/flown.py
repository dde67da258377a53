"""
One period of a flight by a person's hand, compiled to WebAssembly for browsers.

A browser's memory holds the arrays that `TeleoperationLoop` keeps, and the parts of the loop stand
in a table of functions, by whose numbers `SETUP` names them there.
"""

from numba import carray, from_dtype, types

from trustlab.teleoperation.loop import kernel
from trustlab.teleoperation.loop.parts import HISTORY, INPUT, LOG, SETUP, SIGNATURE, STATE, Part
from trustlab.teleoperation.loop.schemes import SCHEMES
from trustlab.teleoperation.ports.ledger import ACCOUNT
from trustlab.teleoperation.records import columns_of, record

HAND = record(numbers="reach_x reach_y alpha_min alpha_max")
"""Where the edge of the hand's square holds the device [m], and the bounds of a share by hand."""

WIDTH = len(columns_of(LOG))

BOOKS = 4
"""Accounts of waves and of packets, to the robot and back."""


def fly_there(
    first,
    stop,
    x,
    y,
    choice,
    samples,
    hand,
    setups,
    states,
    row,
    inputs,
    delays,
    arrives,
    books,
    history,
    sent,
    log,
    table,
):
    """
    Fly the samples from `first` to before `stop` under a hand in its square and the share that it
    chose, below 0 for none; return how the run ended, -1 for well.
    """
    by_hand, outside = carray(hand, 1)[0], carray(inputs, samples)
    for k in range(first, stop):
        outside[k].hand[0] = x * by_hand.reach_x
        outside[k].hand[1] = y * by_hand.reach_y
        outside[k].hand[2] = 0.0
        if choice >= 0.0:
            outside[k].alpha = by_hand.alpha_min + choice * (by_hand.alpha_max - by_hand.alpha_min)
    return kernel.advance(
        first,
        stop,
        carray(setups, 1),
        carray(states, 1),
        carray(row, WIDTH),
        outside,
        carray(delays, (2, samples)),
        carray(arrives, (2, samples)),
        carray(books, BOOKS),
        carray(history, samples),
        carray(sent, (2, samples, 3)),
        carray(log, samples),
        carray(table, (samples, WIDTH)),
    )[1]


def _pointers(*kinds):
    return tuple(types.CPointer(kind) for kind in kinds)


_records = [from_dtype(kind) for kind in (HAND, SETUP, STATE)]
_outside = types.float64, from_dtype(INPUT), types.float64, types.boolean, from_dtype(ACCOUNT)
_kept = from_dtype(HISTORY), types.float64, from_dtype(LOG), types.float64
ENTRIES = {
    "fly": (
        fly_there,
        types.int32(
            types.int64,
            types.int64,
            types.float64,
            types.float64,
            types.float64,
            types.int64,
            *_pointers(*_records, *_outside, *_kept),
        ),
    )
}
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
