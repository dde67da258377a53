"""Winsorizing: values by hand, SciPy's for the classical rule, and a list of every change."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from trustlab.studies.winsorize import OUTLIER_RULES, winsorize

PLAIN = np.array([1.0, 2, 3, 4, 5, 6, 7, 8, 9, 100])


def of_values(x, **rule):
    """Winsorize one condition's scores, beside another that is left alone."""
    x = np.asarray(x)
    cells = {"pid": np.arange(x.size), "error": x}
    frame = pd.concat([pd.DataFrame(cells).assign(scheme=name) for name in ("A", "B")])
    return winsorize(frame, "error", "scheme", "pid", conditions=["A"], **rule)


def scores_of(winsorized):
    return winsorized.data.loc[winsorized.data["scheme"] == "A", "error"].to_numpy()


@pytest.fixture
def frame():
    rng = np.random.default_rng(8)
    scores = rng.normal(0.5, 0.06, (30, 2))
    scores[4, 1] = 0.95
    scores[20, 1] = 0.88
    scores[3, 0] = 1.2
    return pd.DataFrame(
        {
            "pid": np.repeat(np.arange(1, 31), 2),
            "scheme": ["M", "TMIG"] * 30,
            "error": scores.ravel(),
            "note": "kept",
        }
    )


@pytest.mark.parametrize(
    "relabel",
    [
        lambda f: [("control", scheme) for scheme in f["scheme"]],
        lambda f: pd.to_datetime(f["scheme"].map({"M": "2020-01-01", "TMIG": "2020-01-02"})),
        lambda f: pd.Categorical(f["scheme"], categories=["TMIG", "unused", "M"]),
        lambda f: f["scheme"].astype("string"),
    ],
    ids=["tuples", "dates", "categories", "strings"],
)
def test_labels_of_any_kind_give_the_same_changes(frame, relabel):
    rule = {
        "dv": "error",
        "within": "scheme",
        "subject": "pid",
        "outside": "iqr",
        "k": 1.5,
        "to": "next",
    }
    plain, other = winsorize(frame, **rule), winsorize(frame.assign(scheme=relabel(frame)), **rule)
    order = ["subject", "old"]
    pd.testing.assert_frame_equal(
        plain.changes.drop(columns="condition").sort_values(order, ignore_index=True),
        other.changes.drop(columns="condition").sort_values(order, ignore_index=True),
    )
    np.testing.assert_array_equal(plain.data["error"], other.data["error"])


def test_two_outliers_of_one_condition(frame):
    found = winsorize(
        frame, "error", "scheme", "pid", outside="iqr", k=1.5, to="next", conditions=["TMIG"]
    )
    own = frame.loc[frame["scheme"] == "TMIG", "error"]
    next_most = own[own < 0.8].max()
    assert found.changes["subject"].tolist() == [5, 21]
    assert found.changes["condition"].tolist() == ["TMIG", "TMIG"]
    assert found.changes["old"].tolist() == [0.95, 0.88]
    assert found.changes["new"].tolist() == [next_most, next_most]
    same = ~((frame["pid"].isin([5, 21])) & (frame["scheme"] == "TMIG"))
    pd.testing.assert_frame_equal(found.data[same], frame[same])
    assert list(found.data.columns) == list(frame.columns)
    assert found.limits["condition"].tolist() == ["TMIG"]
    assert "2 of 30 values were winsorized (TMIG, subject 5, 21)" in found.apa()
    assert "set to the next most extreme value" in found._repr_html_()
    assert frame["error"].max() == 1.2
    every = winsorize(frame, "error", "scheme", "pid", outside="iqr", k=1.5, to="next")
    assert every.changes["subject"].tolist() == [4, 5, 21]
    assert found.table() is found.changes


def test_rules_by_hand():
    q1, q3 = 3.25, 7.75  # linear interpolation, R's type 7
    fence = of_values(PLAIN, outside="iqr", k=1.5, to="limit")
    assert scores_of(fence)[-1] == pytest.approx(q3 + 1.5 * (q3 - q1), rel=1e-14)
    assert fence.limits.loc[0, ["low", "high", "changed"]].tolist() == pytest.approx(
        [-3.5, 14.5, 1]
    )
    mad = of_values(PLAIN, outside="mad", k=3, to="limit")
    assert scores_of(mad)[-1] == pytest.approx(5.5 + 3 * 1.4826022185 * 2.5, rel=1e-9)
    sd = of_values(PLAIN, outside="sd", k=2, to="limit")
    assert scores_of(sd)[-1] == pytest.approx(PLAIN.mean() + 2 * PLAIN.std(ddof=1), rel=1e-14)
    assert scores_of(of_values(PLAIN, outside="sd", k=2, to="next"))[-1] == 9.0
    quantile = of_values(PLAIN, outside="quantile", k=0.1, to="limit")
    assert scores_of(quantile)[[0, -1]] == pytest.approx([1.9, 18.1])
    assert quantile.changes["subject"].tolist() == [0, 9]
    assert "None of 3 values" in of_values([1, 2, 3], outside="iqr", k=1.5, to="next").apa()
    assert "1 of 10 values was winsorized (A, subject 9)" in sd.apa()


@given(st.lists(st.integers(-1000, 1000), min_size=5, max_size=40), st.integers(1, 2))
@settings(max_examples=60)
def test_the_classical_rule_is_scipys(values, k):
    x = np.array(values, dtype=float)
    found = scores_of(of_values(x, outside="extremes", k=k, to="next"))
    wanted = stats.mstats.winsorize(x, limits=(k / x.size + 1e-9, k / x.size + 1e-9))
    assert found.tolist() == np.asarray(wanted).tolist()


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=5, max_size=40, unique=True),
    st.sampled_from(["sd", "mad", "iqr", "quantile", "extremes"]),
    st.sampled_from(["limit", "next"]),
)
@settings(max_examples=150)
def test_order_is_kept_inner_values_are_not_touched(values, outside, to):
    x = np.array(values)
    k = {"sd": 1.5, "mad": 2.0, "iqr": 1.0, "quantile": 0.2, "extremes": 1}[outside]
    if outside == "extremes":
        to = "next"
    try:
        found = of_values(x, outside=outside, k=k, to=to)
    except ValueError as error:
        assert "is 0" in str(error)  # noqa: PT017  the spread of nearly equal numbers rounds to 0
        return
    low, high = found.limits.loc[0, ["low", "high"]]
    order, new = np.argsort(x), scores_of(found)
    assert (np.diff(new[order]) >= 0).all()
    inside = (x >= low) & (x <= high)
    assert (new[inside] == x[inside]).all()
    assert ((new >= low) & (new <= high)).all()
    assert found.changes["subject"].tolist() == np.flatnonzero(~inside).tolist()
    assert found.changes["old"].tolist() == x[~inside].tolist()
    assert found.changes["new"].tolist() == new[~inside].tolist()
    mirrored = of_values(-x, outside=outside, k=k, to=to)
    assert scores_of(mirrored) == pytest.approx(-new, rel=1e-9, abs=1e-6)


def test_a_constant_is_left_alone():
    found = of_values([0.1] * 12, outside="sd", k=2, to="limit")
    assert found.changes.empty
    assert scores_of(found).tolist() == [0.1] * 12


def test_missing_cells_stay_missing(frame):
    frame.loc[7, "error"] = np.nan
    found = winsorize(frame, "error", "scheme", "pid", outside="iqr", k=1.5, to="limit")
    assert np.isnan(found.data.loc[7, "error"])
    assert found.limits["n"].tolist() == [30, 29]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"outside": "sigma"}, f"outside must be one of {', '.join(map(repr, OUTLIER_RULES))}"),
        ({"to": "mean"}, "to must be"),
        ({"k": 0}, "k must be positive"),
        ({"k": -1.5}, "k must be positive"),
        ({"k": np.nan}, "k must be finite"),
        ({"k": "1.5"}, "k must be a number"),
        ({"k": True}, "k must be a number"),
        ({"outside": "quantile", "k": 0.5}, "below 0.5"),
        ({"outside": "extremes", "k": 1.5, "to": "next"}, "k = 1.5, .* a whole k"),
        ({"outside": "extremes", "k": 1, "to": "limit"}, 'and to="next"'),
        ({"outside": "extremes", "k": 15, "to": "next"}, "30 values are too few"),
        ({"conditions": ["TMIGG"]}, r"conditions: 'TMIGG' is none of \['M', 'TMIG'\]"),
        ({"conditions": "TMIG"}, "conditions must be a list"),
        ({"conditions": ["M", "M"]}, "occurs twice"),
        ({"outside": ["sd"]}, "outside must be one of"),
        ({"to": ["limit"]}, "to must be"),
        ({"conditions": []}, "conditions must have at least 1"),
        ({"dv": "eror"}, "did you mean 'error'"),
        ({"within": None}, "within"),
    ],
)
def test_bad_rules_are_refused(frame, arguments, words):
    given_ = {
        "dv": "error",
        "within": "scheme",
        "subject": "pid",
        "outside": "iqr",
        "k": 1.5,
        "to": "limit",
    }
    with pytest.raises(ValueError, match=words):
        winsorize(frame, **(given_ | arguments))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([1, 2, np.nan], "2 values are too few"),
        ([1, 2, np.inf, 3], "finite"),
        ([1, 1, 1, 1, 9], "so many values are equal that their spread is 0"),
        ([1e308, -1e308, 1e308, -1e308, 0], "no value lies inside|the unit does not fit"),
    ],
)
def test_bad_values_are_refused(values, words):
    with pytest.raises(ValueError, match=words):
        of_values(values, outside="iqr", k=1.5, to="limit")


@pytest.mark.parametrize(
    ("values", "outside", "k"),
    [
        ([1, 1, 1, 1, 9], "mad", 3),
        ([0.0, 1e-200, 2e-200, 5e-200], "sd", 1.0),
        ([0, 0, 0, 10, 10, 10], "sd", 0.5),
    ],
)
def test_a_rule_without_a_value_inside_its_limits_is_refused(values, outside, k):
    with pytest.raises(ValueError, match="dv, condition 'A': by this rule no value lies inside"):
        of_values(values, outside=outside, k=k, to="limit")


def test_text_and_twofold_cells_are_refused(frame):
    rule = {"outside": "iqr", "k": 1.5, "to": "limit"}
    with pytest.raises(ValueError, match="scores must be numbers"):
        winsorize(frame.assign(error="high"), "error", "scheme", "pid", **rule)
    with pytest.raises(ValueError, match="more than one row"):
        winsorize(pd.concat([frame, frame.iloc[:1]]), "error", "scheme", "pid", **rule)
