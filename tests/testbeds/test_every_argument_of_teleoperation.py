"""
Whatever is put into an argument of a teleoperation run, a ValueError comes out or a sound answer.
"""

import inspect
from contextlib import suppress

import numpy as np
import pytest

import trustlab as tl
from trustlab.operators.answers import experience, simulated_answers
from trustlab.testbeds import tracking_vehicle

NEVER = (np.nan, np.inf, b"x", True, [], object(), 1j, np.array(["a"]), tl)
PERHAPS = (
    None,
    "x",
    "",
    {},
    -np.inf,
    -1,
    0,
    2.5,
    1e300,
    10**400,
    (1, 2),
    np.array([1.0, np.nan]),
    [[1.0]],
    1e-320,
    1e9,
)
RUN = tl.simulate_teleoperation(duration=1.0)
LOOP = inspect.signature(
    tl.TeleoperationLoop
).parameters  # which `simulate_teleoperation` takes as well
CALLS = (
    (tl.simulate_teleoperation, {"duration": 1.0}),
    (simulated_answers, {"session": RUN}),
    (experience, {"session": RUN}),
    (tl.TrackingTask, {}),
    (tl.Teleoperator, {}),
    (tl.OptimalBlending, {}),
    (tracking_vehicle, {}),
)


@pytest.mark.parametrize(
    ("call", "given", "name"),
    [
        *(
            (call, given, name)
            for call, given in CALLS
            for name in inspect.signature(call).parameters
            if name != "options"
        ),
        *((tl.simulate_teleoperation, {"duration": 1.0}, name) for name in LOOP),
    ],
    ids=lambda value: value if isinstance(value, str) else getattr(value, "__name__", ""),
)
def test_nothing_but_a_clear_error_comes_of_nonsense(call, given, name):
    for bad in NEVER:
        with pytest.raises(ValueError, match=r"\w+ \w+"):
            call(**(given | {name: bad}))
    for value in PERHAPS:
        with suppress(ValueError):
            call(**(given | {name: value}))
