"""
What counts as a number, a whole number, an array and a model; everything else is refused with its
name.
"""

from decimal import Decimal
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.models.checks import finite_array, finite_number, of_class, open_unit, whole_number

NO_NUMBER = [None, "3", b"3", True, np.True_, [], [1.0], {}, 1j, object(), np.array([2.0]), 10**400]


@pytest.mark.parametrize(
    "value", [3, 3.0, np.int8(3), np.float32(3), np.array(3), Fraction(3), Decimal(3)]
)
def test_numbers_of_every_kind(value):
    assert finite_number("x", value) == 3.0
    assert type(finite_number("x", value)) is float


@pytest.mark.parametrize("value", NO_NUMBER)
def test_what_is_no_number(value):
    for check in (finite_number, open_unit, whole_number):
        if check is whole_number and isinstance(value, int) and value is not True:
            assert check("width", value) == value
            continue
        with pytest.raises(ValueError, match=r"width must be a (whole )?number"):
            check("width", value)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite(value):
    with pytest.raises(ValueError, match="width must be finite"):
        finite_number("width", value)
    with pytest.raises(ValueError, match="count must be a whole number, 1 or more, got"):
        whole_number("count", value)


@pytest.mark.parametrize(
    "value", [3, 3.0, np.int64(3), np.uint8(3), np.float64(3), np.array(3), Fraction(3)]
)
def test_whole_numbers_of_every_kind(value):
    assert whole_number("count", value) == 3
    assert type(whole_number("count", value)) is int


@pytest.mark.parametrize(
    ("value", "least", "most"),
    [(0, 1, None), (-1, 0, None), (2.5, 1, None), (7, 1, 6), (1e300, 1, None)],
)
def test_whole_numbers_out_of_range(value, least, most):
    with pytest.raises(ValueError, match="count must be a whole number"):
        whole_number("count", value, least, most)
    assert whole_number("count", 6, 6, 6) == 6


def test_the_class_wanted_and_a_remedy_are_named():
    model = tl.published_models()["1"]
    assert of_class("model", model, tl.TscModel) is model
    with pytest.raises(
        ValueError,
        match=r"model must be of class TscModel, got RobotModel; fit one with trustlab\.fit_tsc",
    ):
        of_class("model", model.robot, tl.TscModel)
    with pytest.raises(
        ValueError, match=r"human must be of class HumanModel, got str; take .human$"
    ):
        of_class("human", "x", tl.HumanModel, "take .human")
    with pytest.raises(ValueError, match=r"robot must be of class RobotModel, got int$"):
        of_class("robot", 3, tl.RobotModel)


def test_a_run_is_told_to_hand_over_its_session():
    session = tl.Session(pd.DataFrame({"mode": [1.0, 0.0]}, index=[0.0, 0.1]))
    with pytest.raises(
        ValueError, match=r"must be of class Session, got SimpleNamespace; pass its \.session$"
    ):
        of_class("session", SimpleNamespace(session=session), tl.Session, "read one")
    with pytest.raises(ValueError, match=r"got SimpleNamespace; read one$"):
        of_class("session", SimpleNamespace(session=3), tl.Session, "read one")


@pytest.mark.parametrize(
    "value", ["ab", ["1", "2"], [None, 1.0], [[1.0]], [], 3.0, [1.0, np.nan], [1j], [{}], None]
)
def test_what_is_no_array_of_numbers(value):
    with pytest.raises(ValueError, match=r"^width "):
        finite_array("width", value)


def test_arrays_are_floats_in_one_piece():
    array = finite_array("x", np.arange(10)[::2])
    assert array.dtype == float
    assert array.flags.c_contiguous
    with pytest.raises(ValueError, match="must have 4 samples, got 5"):
        finite_array("x", array, length=4)


def test_warnings_point_at_the_users_line():
    """However deep inside the package the reason was found: oracle, the file of this test."""
    data = tl.read_session("data/sessions/pilot.csv").data
    unsaid = tl.Session(data, tl.Metadata(participant=1))
    for fit in (tl.fit_tsc, tl.fit_robot, tl.fit_human):
        with pytest.warns(UserWarning, match="moving window") as caught:
            fit(unsaid)
        assert caught[0].filename == __file__
