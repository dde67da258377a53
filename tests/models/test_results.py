"""Checks of arguments, and how results show themselves."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.cases import model, refused
from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    Share,
    between,
    finite_array,
    finite_number,
    finite_numbers,
    in_order,
    not_negative,
    of_class,
    open_unit,
    positive,
    spawned,
    whole_number,
    whole_seed,
)
from trustlab.models.display import Result, as_html, axes_or_new
from trustlab.models.trust import TrustModel

parametrize = pytest.mark.parametrize

# --- checks ---------------------------------------------------------------------------------------


@parametrize("value", [3, 3.0, np.int8(3), np.float32(3), np.array(3), Fraction(3), Decimal(3)])
def test_numbers_of_every_kind_become_pythons_own(value):
    assert repr(finite_number("x", value)) == "3.0"
    assert isinstance(value, Decimal) or repr(whole_number("count", value, 3, 3)) == "3"


@parametrize("value", ["3", b"3", True, np.True_, np.array("3"), np.array([3.0])])
def test_what_python_would_convert_is_no_number(value):
    with refused(r"^width must be a number, got "):
        finite_number("width", value)
    with refused(r"^count must be a whole number, 1 or more, got "):
        whole_number("count", value)


def test_ends_of_ranges():
    assert [between("x", end, 0.0, 1.0) for end in (0, 1)] == [0.0, 1.0]
    assert not_negative("x", 0) == 0.0
    assert whole_number("seed", 10**400, 0) == 10**400
    with refused(r"0 or more, got 1e\+300"):
        whole_number("seed", 1e300, 0)
    for check, value in ((positive, 0.0), (open_unit, 0.0), (open_unit, 1.0)):
        with refused(r"^x must "):
            check("x", value)
    with refused(r"low must be below high, got low = 1.0 and high = 1.0"):
        in_order("low", 1, "high", 1)


def test_arrays_are_floats_in_one_piece():
    array = finite_array("x", np.arange(10)[::2])
    assert array.dtype == float
    assert array.flags.c_contiguous
    assert finite_array("x", [Fraction(1, 2), 2]).tolist() == [0.5, 2.0]
    with refused("x must be finite, but sample 7 is nan"):
        finite_numbers("x", np.where(np.arange(20).reshape(10, 2) == 15, np.nan, 1.0))


@parametrize(
    ("values", "words"),
    [
        (["1", "2"], "be an array of numbers, got list"),
        ([None, "1"], "be an array of numbers, got list"),
        ([1, None], "be finite, but sample 1 is nan"),
        (np.ma.array([1, 9], mask=[0, 1]), "be finite, but sample 1 is nan"),
        ([[1.0]], "be one-dimensional with at least one sample, got shape"),
        (np.arange(5), "have 4 samples, got 5"),
    ],
)
def test_what_is_no_array_of_four_numbers(values, words):
    with refused(f"^x must {words}"):
        finite_array("x", values, length=4)


def test_the_class_and_a_remedy_are_named():
    tsc, session = model(), tl.Session(pd.DataFrame({"mode": [1.0, 0.0]}, index=[0.0, 0.1]))
    assert of_class("model", tsc, tl.TscModel) is tsc
    for value, kind, words in (
        (tsc.robot, tl.TscModel, r"TscModel, got RobotModel; fit one with trustlab\.fit_t"),
        ("x", tl.HumanModel, "x must be of class HumanModel, got str; take .h$"),
        (SimpleNamespace(session=session), tl.Session, r"got SimpleNamespace; pass its \.session$"),
    ):
        with refused(words):
            of_class("x", value, kind, "take .h" if value == "x" else "")


@parametrize("seed", [7, np.random.SeedSequence(7, spawn_key=(2, 3))])
def test_children_of_a_seed_are_numpys_and_the_same_at_every_call(seed):
    fresh = np.random.SeedSequence(7, spawn_key=getattr(seed, "spawn_key", ())).spawn(3)
    for _ in range(2):
        for child, expected in zip(spawned(seed, 3), fresh, strict=True):
            assert (child.generate_state(4) == expected.generate_state(4)).all()


def test_without_a_seed_one_is_proposed():
    """None was taken, and gave other numbers at every call."""
    with refused(r"got None; pass seed=0$"):
        whole_seed(None)


def test_warnings_point_at_the_users_line():
    """However deep inside the package the reason was found: oracle, the file of this test."""
    data = tl.read_session("data/sessions/pilot.csv").data
    with pytest.warns(UserWarning, match="moving window") as caught:
        tl.fit_human(tl.Session(data, tl.Metadata(participant=1)))
    assert caught[0].filename == __file__


@dataclass(frozen=True)
class Settings(Checked):
    size: Positive
    shift: float = 0.0
    share: Share = 0.5
    span: Annotated[float, (1.0, 2.0)] = 1.5
    exact: bool = True
    law: Callable | None = None
    least: NotNegative | None = None
    model: TrustModel | None = None
    title: str = "anything"


@parametrize(
    ("name", "value", "words"),
    [
        ("size", 0.0, "be positive"),
        ("shift", np.inf, "be finite"),
        ("share", 1.1, r"lie in \[0, 1\]"),
        ("span", 0.9, r"lie in \[1, 2\]"),
        ("exact", 1, "be True or False"),
        ("law", "none", "be a function"),
        ("least", -1.0, "not be negative"),
        ("model", 0.2, "be of class TrustModel"),
    ],
)
def test_settings_are_checked_by_their_annotations(name, value, words):
    good = Settings(2, law=abs, least=0, model=TrustModel(0.1, 0.1))
    assert (type(good.size), good.least, good.title) == (float, 0.0, "anything")
    assert replace(good, law=None, least=None, model=None).law is None
    with refused(f"{name} must {words}"):
        replace(good, **{name: value})


# --- display --------------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Found(Result):
    message: str
    numbers: tuple = (1.23456789, None)

    title = "A <b>"

    def table(self):
        return pd.DataFrame({"x": self.numbers}, index=pd.Index(["$y$", "<i>"], name="name"))


def test_a_result_is_one_line_and_in_a_notebook_its_table_too():
    result, long = Found("1 < 2 & more"), repr(Found("long " * 100))
    assert repr(result) == "<A <b>: 1 < 2 & more>"
    assert len(long) < 200
    assert long.endswith("long …>")
    shown = result._repr_html_()
    begin = '<div class="tex2jax_ignore"><p><b>A &lt;b&gt;</b>: 1 &lt; 2 &amp; more'
    assert shown.startswith(begin)
    for part in ("<td>1.23457</td>", "<td>–</td>", "&lt;i&gt;"):
        assert part in shown


def test_a_table_is_shown_as_far_as_a_page_takes_it():
    """Up to sixty rows, without a plain index; a single row that is too wide stands upright."""
    row = pd.DataFrame([{f"column {i}": i / 3 for i in range(12)} | {"words": "of it"}])
    shown = as_html("", pd.DataFrame({"x": range(1000)}), row.iloc[:, :12])
    assert shown.count("<tr") < 70
    assert shown.count("<table") == 2
    assert "<th>0</th>" not in shown
    upright = as_html("", row)
    assert upright.count("<tr") >= 13
    for part in ("<th>column 11</th>", "<td>0.333333</td>", "<td>of it</td>"):
        assert part in upright


def test_axes_that_are_given_are_returned_and_one_by_itself():
    one = SimpleNamespace(plot=print)
    assert axes_or_new([one]) is one
    pair = [one, one]
    assert axes_or_new(pair, columns=2) is pair
