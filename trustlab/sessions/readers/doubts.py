"""Warnings about values that can be read but are hardly meant: units of time and performance."""

from collections.abc import Mapping

import numpy as np

from trustlab.models.checks import warn

# Samples further apart [s] than this: nobody logs control that slowly.
SLOWEST = 10.0

# Steps of a log at 1 to 1,000 Hz, from the coarsest unit that they fit.
UNITS_OF_STEPS = (
    ("ns", "nanoseconds", 1e6),
    ("us", "microseconds", 1e3),
    ("ms", "milliseconds", 0),
)

# Performance above which a measure, in m/s or a share of 1, is no longer plausible.
MOST_PERFORMANCE = 10.0


def warn_of_doubts(source: str | None, t: np.ndarray, columns: Mapping[str, np.ndarray]) -> None:
    """Warn where times or performance are hardly meant as they are read."""
    if t[-1] - t[0] >= SLOWEST * (t.size - 1):
        step = float(t[1] - t[0])
        unit, name, _ = next(each for each in UNITS_OF_STEPS if step >= each[2])
        remedy = f'if these are {name}, a recipe says so: [time] unit = "{unit}"'
        warn(f"{source}: samples are {step:g} s apart; {remedy}")
    for name in ("p_r", "p_h"):
        if name in columns and columns[name].size:
            fault = _implausible(float(columns[name].min()), float(columns[name].max()))
            if fault:
                warn(f"{source}: column {name} {fault}")


def _implausible(least: float, most: float) -> str:
    """Say what is wrong with a range of performance; nothing where it is plausible."""
    if least < 0.0:
        return (
            f"goes down to {least:g}, but performance is never negative; map the measure to one "
            "that is 0 at its worst (offset in a recipe's column)"
        )
    if MOST_PERFORMANCE < most <= 100.0:
        return (
            f'goes up to {most:g}; if it is in per cent, a recipe says so: unit = "%" in the column'
        )
    if most > 100.0:
        return (
            f"goes up to {most:g}, beyond any performance in m/s or as a share; correct its scale"
        )
    return ""
