"""
Whatever is put into an argument of testbeds and operators, a ValueError comes out or a sound
answer.
"""

from dataclasses import fields

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

import trustlab as tl
from tests.arguments import faults
from trustlab.operators import Operator, operator
from trustlab.reproduction import published_table, recompute, smallest_change
from trustlab.reproduction.printed_number import half_unit
from trustlab.testbeds import (
    Course,
    Pioneer,
    drive_modes,
    identification_session,
    published_operator,
    published_thresholds,
    run_condition,
)
from trustlab.testbeds.ground_robot.conditions import plot_path

matplotlib.use("Agg")

NEVER = (np.nan, np.inf, "x", b"x", True, [], object(), 1j, np.array(["a"]), tl)
PERHAPS = (
    None,
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
    "",
    1e9,
)

MODEL = tl.published_models()["2"]
WHO = published_operator(2)
RUN = run_condition("C3", 2, laps=1)
CORNERS = ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0), (0.0, 9.0))
DRIVER = {"seed": 1, "robot": Pioneer(), "course": Course()}


def double(values):
    return {"twice": 2.0 * values["one"]}


CALLS = {
    "run_condition, printed": (
        run_condition,
        {
            "condition": "C3",
            "participant": 2,
            "model": MODEL,
            "thresholds": (0.0, 0.35),
            "laps": 1,
            "r0": 0.5,
            "seed": 1,
            "testbed": "ground_robot",
        },
    ),
    "run_condition, operator": (
        run_condition,
        {"condition": "C1", "operator": WHO, "model": MODEL, "laps": 1},
    ),
    "drive_modes": (
        drive_modes,
        {"mode": [1, 0, 1], "operator": WHO, "r0": 0.5, "condition": "test"} | DRIVER,
    ),
    "identification_session": (
        identification_session,
        {"operator": WHO, "manual": 2.0, "autonomous": 2.0, "mixed": 1, "phase": (1.0, 2.0)}
        | DRIVER,
    ),
    "published_operator": (published_operator, {"participant": 1}),
    "published_thresholds": (published_thresholds, {"participant": "1"}),
    "published_table": (published_table, {"number": "2.1"}),
    "Course": (
        Course,
        {
            "corners": CORNERS,
            "radius": 1.0,
            "post_spacing": 2.0,
            "half_width": 1.0,
            "resolution": 0.1,
        },
    ),
    "Course.distance": (Course().distance, {"x": 0.0, "y": 1.0}),
    "Pioneer": (Pioneer, {item.name: getattr(Pioneer(), item.name) for item in fields(Pioneer)}),
    "Operator": (Operator, {item.name: getattr(WHO, item.name) for item in fields(Operator)}),
    "operator": (
        operator,
        {
            "participant": 1,
            "model": MODEL,
            "lower": (0.0, 0.1),
            "upper": (0.4, 0.1),
            "follow": (0.5, 0.5),
            "delay": 0.2,
        },
    ),
    "GroundRobotRun.plot": (RUN.plot, {"bounds": {"r": (0.1, 0.9)}}),
    "plot_path": (
        plot_path,
        {"session": RUN.session, "course": RUN.course, "start": 0.0, "stop": 5.0},
    ),
    "half_unit": (half_unit, {"printed": "0.320"}),
    "recompute": (
        recompute,
        {
            "compute": double,
            "inputs": {"one": "1.0"},
            "outputs": {"twice": "2.0"},
            "draws": 3,
            "seed": 0,
        },
    ),
    "smallest_change": (
        smallest_change,
        {
            "compute": double,
            "inputs": {"one": "1.0"},
            "output": "twice",
            "printed": "2.2",
            "units": 5,
        },
    ),
}
FREE = {
    "drive_modes": [("condition", str)],
    "Operator": [("participant", str)],
    "operator": [("participant", str)],
    "plot_run": [("bounds", list)],
    "GroundRobotRun.plot": [("bounds", list)],
}
"""Arguments that any name is good for, or nothing to draw."""


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.mark.parametrize("name", CALLS)
def test_the_good_call_is_good(name):
    call, good = CALLS[name]
    call(**good)


@pytest.mark.parametrize("name", CALLS)
def test_what_is_never_good_is_refused(name):
    assert not faults(*CALLS[name], NEVER, never=True, free=FREE.get(name, ()))


@pytest.mark.parametrize("name", CALLS)
def test_nothing_but_an_answer_or_a_clear_error(name):
    assert not faults(*CALLS[name], PERHAPS)


def test_delays_beyond_any_person_are_refused():
    with pytest.raises(ValueError, match=r"delay must lie in \[0, 5\], got 1e\+300"):
        operator(1, MODEL, delay=1e300)


def test_a_bad_sample_of_mode_is_named():
    with pytest.raises(ValueError, match="sample 1 is nan"):
        drive_modes([1, np.nan], WHO)
    with pytest.raises(ValueError, match=r"zeros and ones, but sample 2 is 0\.5"):
        drive_modes([1, 0, 0.5], WHO)


def test_courses_too_fine_to_walk_are_refused():
    with pytest.raises(
        ValueError, match=r"too fine for a course of about 36 m; it must be at least 0\.000361 m"
    ):
        Course(corners=CORNERS, resolution=1e-12)
