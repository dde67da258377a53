"""
Functions of one's own in the loop: what they read of the state, and how they are asked.

At the pause of a sample each is asked in turn, and what it decides is put into the inputs of the
kernel. So a run is repeated from its inputs without the functions.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from trustlab.models.checks import finite_numbers, shown
from trustlab.models.simulation import (
    DivergenceError as DivergenceError,
    PartError as PartError,
    View,
    asked,
)

# What a user's function decides, in the order in which they are asked. Where the vehicle went and
# how trust changed follow from the sample before: these two are not asked at the start.
HOOKS = {
    "vehicle": ("robot", "velocity"),
    "trust": ("trust_hr", "trust_rh"),
    "autonomy": ("u_a",),
    "scheme": ("alpha", "beta"),
    "operator": ("wanted",),
    "guiding force": ("guiding",),
}
FOLLOWING = ("vehicle", "trust")

VECTORS = ("robot", "velocity", "u_a", "wanted", "guiding")


def asking(
    hooks: Mapping[str, Callable],
    view: View,
    records: np.ndarray,
    given: set[str],
    bounds: Mapping[str, tuple[float, float]],
    follows_error: bool,
) -> Callable:
    """
    Return the `decide` of a `Simulation` that asks these functions in turn.

    records: those that `view` reads; later functions see there what earlier ones decided. given:
    what may come from outside, where it prevails, and is seen, too. bounds: of scales and trust.
    follows_error: whether the guiding force follows the error of the moment, not the picture.
    A controller that has lost its target is not asked: it hovers.
    """
    row = records["now"]
    fields = {
        name: (row if name in row.dtype.names else records)[name]
        for names in HOOKS.values()
        for name in names
    }

    parts = {part: names for part, names in HOOKS.items() if part in hooks or given & {*names}}

    def decide(_: Any, inputs: np.ndarray) -> None:
        for part, names in parts.items():
            rests = part in FOLLOWING and view.t == 0.0
            # what is given, or was decided before an interruption, is not asked for
            needed = [name for name in names if math.isnan(inputs[name].item(0))]
            asks = needed and part in hooks
            if asks and not (rests or (part == "autonomy" and not view.finds)):
                part, function = f"the {part} of this loop", hooks[part]
                decided = asked(part, view.t, checked, names, function, view, bounds)
                for name in needed:
                    inputs[name] = decided[name]
            known = [name for name in names if not math.isnan(inputs[name].item(0))]
            for name in known:
                fields[name][:] = inputs[name]
            if "robot" in known:
                row["error"] = row["reference"] - row["robot"]
                row["path_error"] = np.sqrt((row["error"] ** 2).sum())
                if follows_error:
                    records["stretch"] = row["error"]

    return decide


def checked(
    names: tuple[str, ...], function: Callable, view: View, bounds: Mapping[str, tuple]
) -> dict[str, Any]:
    """
    Return what a function decides, by name: three finite numbers for a vector, others within their
    bounds.
    """
    returned = function(view)
    try:
        decided = dict(zip(names, returned if len(names) > 1 else [returned], strict=True))
    except (TypeError, ValueError):
        wanted = f"{' and '.join(names)} are wanted"
        raise ValueError(f"returned {shown(returned)}; {wanted}") from None
    for name, value in decided.items():
        try:
            if name in VECTORS:
                wanted = "three finite numbers are wanted, for x, y and z"
                decided[name] = vector = np.asarray(value, float)
                valid = vector.shape == (3,) and np.isfinite(vector).all()
            else:
                low, high = bounds[name]
                wanted = f"it must lie in [{low:g}, {high:g}], as the loop's settings have it"
                valid = low <= value <= high
        except (TypeError, ValueError):
            valid = False
        if not valid:
            raise ValueError(f"returned {name} = {shown(value)}; {wanted}")
    return decided


def is_state_space(vehicle: Any) -> bool:
    """Return whether a vehicle is given by three matrices."""
    return isinstance(vehicle, tuple | list) and [np.ndim(m) for m in vehicle] == [2, 2, 2]


def state_space(*matrices: np.ndarray) -> Callable:
    """
    Return a vehicle that steps x' = A x + B u, x = 0 at the start, and moves from there by C x'.
    """
    a, b, c = (finite_numbers("vehicle", matrix) for matrix in matrices)
    n = len(a)
    if (a.shape, b.shape, c.shape) != ((n, n), (n, 3), (6, n)):
        raise ValueError(
            "vehicle must be matrices A (n, n), B (n, 3) for commands on x, y and z, and C (6, n) "
            f"for position and velocity, got shapes {a.shape}, {b.shape} and {c.shape}"
        )

    def step(state: View) -> tuple[np.ndarray, np.ndarray]:
        # under a key that no other function has
        x, start = state.memory.get(step, (np.zeros(n), state.robot.copy()))
        x = a @ x + b @ state.command
        state.memory[step] = x, start
        moved = c @ x
        return start + moved[:3], moved[3:]

    return step
