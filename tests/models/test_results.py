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
)
from trustlab.models.display import Result, as_html
from trustlab.models.trust import TrustModel

# --- checks ---------------------------------------------------------------------------------------

THREE = [3, 3.0, np.int8(3), np.float32(3), np.array(3), Fraction(3), Decimal(3)]
# What Python or NumPy would convert, and a user did not mean as a number.
CONVERTIBLE = ["3", b"3", True, np.True_, np.array("3"), np.array([3.0])]


@pytest.mark.parametrize("value", THREE)
def test_numbers_of_every_kind_become_floats(value):
    assert finite_number("x", value) == 3.0
    assert type(finite_number("x", value)) is float


@pytest.mark.parametrize("value", THREE[:-1])
def test_whole_numbers_of_every_kind_become_ints(value):
    assert whole_number("count", value, 3, 3) == 3
    assert type(whole_number("count", value)) is int


@pytest.mark.parametrize("value", CONVERTIBLE)
def test_what_python_would_convert_is_no_number(value):
    with pytest.raises(ValueError, match=r"^width must be a number, got "):
        finite_number("width", value)
    with pytest.raises(ValueError, match=r"^count must be a whole number, 1 or more, got "):
        whole_number("count", value)


def test_ends_of_ranges():
    assert between("x", 0, 0.0, 1.0) == 0.0
    assert between("x", 1, 0.0, 1.0) == 1.0
    assert not_negative("x", 0) == 0.0
    assert whole_number("seed", 10**400, 0) == 10**400
    with pytest.raises(ValueError, match=r"0 or more, got 1e\+300"):
        whole_number("seed", 1e300, 0)
    for check, value in ((positive, 0.0), (open_unit, 0.0), (open_unit, 1.0)):
        with pytest.raises(ValueError, match=r"^x must "):
            check("x", value)
    with pytest.raises(ValueError, match=r"low must be below high, got low = 1.0 and high = 1.0"):
        in_order("low", 1, "high", 1)


def test_arrays_are_floats_in_one_piece():
    array = finite_array("x", np.arange(10)[::2])
    assert array.dtype == float
    assert array.flags.c_contiguous
    assert finite_array("x", [Fraction(1, 2), 2]).tolist() == [0.5, 2.0]
    with pytest.raises(ValueError, match="x must be finite, but sample 7 is nan"):
        finite_numbers("x", np.where(np.arange(20).reshape(10, 2) == 15, np.nan, 1.0))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (["1", "2"], "be an array of numbers, got list"),
        ([None, "1"], "be an array of numbers, got list"),
        ([1, None], "be finite, but sample 1 is nan"),
        (np.ma.array([1.0, 1e20], mask=[0, 1]), "be finite, but sample 1 is nan"),
        (np.ma.array([1, 9], mask=[0, 1]), "be finite, but sample 1 is nan"),
        ([[1.0]], "be one-dimensional with at least one sample, got shape"),
        (np.arange(5), "have 4 samples, got 5"),
    ],
)
def test_what_is_no_array_of_four_numbers(values, words):
    with pytest.raises(ValueError, match=f"^x must {words}"):
        finite_array("x", values, length=4)


def test_the_class_and_a_remedy_are_named():
    model = tl.published_models()["1"]
    assert of_class("model", model, tl.TscModel) is model
    with pytest.raises(ValueError, match=r"TscModel, got RobotModel; fit one with trustlab\.fit_t"):
        of_class("model", model.robot, tl.TscModel)
    with pytest.raises(ValueError, match=r"human must be of class HumanModel, got str; take .h$"):
        of_class("human", "x", tl.HumanModel, "take .h")
    session = tl.Session(pd.DataFrame({"mode": [1.0, 0.0]}, index=[0.0, 0.1]))
    with pytest.raises(ValueError, match=r"got SimpleNamespace; pass its \.session$"):
        of_class("session", SimpleNamespace(session=session), tl.Session, "read one")
    with pytest.raises(ValueError, match=r"got SimpleNamespace; pass its \.model$"):
        of_class("tsc", SimpleNamespace(model=model), tl.TscModel)


@pytest.mark.parametrize("seed", [7, np.random.SeedSequence(7, spawn_key=(2, 3))])
def test_children_of_a_seed_are_numpys_and_the_same_at_every_call(seed):
    key = getattr(seed, "spawn_key", ())
    fresh = np.random.SeedSequence(7, spawn_key=key).spawn(3)
    for children in (spawned(seed, 3), spawned(seed, 3)):
        states = [child.generate_state(4).tolist() for child in children]
        assert states == [child.generate_state(4).tolist() for child in fresh]


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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"size": 0.0}, "size must be positive"),
        ({"shift": np.inf}, "shift must be finite"),
        ({"share": 1.1}, r"share must lie in \[0, 1\]"),
        ({"span": 0.9}, r"span must lie in \[1, 2\]"),
        ({"exact": 1}, "exact must be True or False"),
        ({"law": "none"}, "law must be a function"),
        ({"least": -1.0}, "least must not be negative"),
        ({"model": 0.2}, "model must be of class TrustModel"),
    ],
)
def test_settings_are_checked_by_their_annotations(change, words):
    good = Settings(2, law=abs, least=0, model=TrustModel(0.1, 0.1))
    assert (type(good.size), good.least, good.title) == (float, 0.0, "anything")
    assert replace(good, law=None, least=None, model=None).law is None
    with pytest.raises(ValueError, match=words):
        replace(good, **change)


# --- display --------------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Found(Result):
    message: str
    numbers: tuple

    title = "A <b>"

    def table(self):
        return pd.DataFrame({"x": self.numbers}, index=pd.Index(["$y$", "<i>"], name="name"))


def test_a_result_is_one_line_and_in_a_notebook_its_table_too():
    result = Found("1 < 2 & more", (1.23456789, None))
    assert repr(result) == "<A <b>: 1 < 2 & more>"
    assert len(repr(Found("long " * 100, (1, 2)))) < 200
    assert repr(Found("long " * 100, (1, 2))).endswith("long …>")
    shown = result._repr_html_()
    assert shown.startswith(
        '<div class="tex2jax_ignore"><p><b>A &lt;b&gt;</b>: 1 &lt; 2 &amp; more'
    )
    assert "<td>1.23457</td>" in shown
    assert "<td>–</td>" in shown
    assert "&lt;i&gt;" in shown


def test_a_plain_index_is_not_shown_nor_more_than_sixty_rows():
    shown = as_html("", pd.DataFrame({"x": range(1000)}), pd.DataFrame({"y": [1]}))
    assert shown.count("<tr>") < 70
    assert shown.count("<table") == 2
    assert "<th>0</th>" not in shown


def test_a_single_row_that_is_wider_than_a_page_stands_upright():
    row = pd.DataFrame([{f"column {i}": i / 3 for i in range(13)} | {"words": "of it"}])
    shown = as_html("", row)
    assert shown.count("<tr") >= 14
    assert "<th>column 12</th>" in shown
    assert "<td>0.333333</td>" in shown
    assert "<td>of it</td>" in shown
    assert as_html("", row.iloc[:, :12]).count("<tr") == 2
