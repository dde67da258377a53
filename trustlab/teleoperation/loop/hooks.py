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
    what may come from outside, which is seen, too, and not asked for. bounds: of scales and trust.
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
            # given, or decided before an interruption
            known = [name for name in names if not math.isnan(inputs[name].item(0))]
            rests = part in FOLLOWING and view.t == 0.0
            rests = rests or (part == "autonomy" and not view.finds)
            if part in hooks and len(known) < len(names) and not rests:
                try:
                    decided = checked(names, hooks[part](view), bounds)
                except Exception as error:
                    raise PartError(
                        f"the {part} of this loop, at t = {view.t:g} s: "
                        f"{type(error).__name__}: {error}"
                    ) from error
                for name in {*names}.difference(known):
                    inputs[name] = decided[name]
                known = [*names]
            for name in known:
                fields[name][:] = inputs[name]
            if "robot" in known:
                row["error"] = row["reference"] - row["robot"]
                row["path_error"] = np.sqrt((row["error"] ** 2).sum())
                if follows_error:
                    records["stretch"] = row["error"]

    return decide


def checked(
    names: tuple[str, ...], returned: Any, bounds: Mapping[str, tuple[float, float]]
) -> dict[str, Any]:
    """
    Return what a function decided, by name: within its bounds, or three finite numbers.
    """
    try:
        decided = dict(zip(names, returned if len(names) > 1 else (returned,), strict=True))
    except (TypeError, ValueError):
        wanted = f"{' and '.join(names)} are wanted"
        raise ValueError(f"returned {shown(returned)}; {wanted}") from None
    for name, value in decided.items():
        try:
            if name in bounds:
                low, high = bounds[name]
                valid = low <= value <= high
            else:
                decided[name] = vector = np.asarray(value, float)
                valid = vector.shape == (3,) and np.isfinite(vector).all()
        except (TypeError, ValueError):
            valid = False
        if not valid:
            wanted = "three finite numbers are wanted, for x, y and z"
            if name in bounds:
                wanted = f"it must lie in [{low:g}, {high:g}], as the loop's settings have it"
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
