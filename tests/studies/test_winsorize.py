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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"outside": "sigma"}, f"outside must be one of {', '.join(map(repr, OUTLIER_RULES))}"),
        ({"k": True}, "k must be a number"),
        ({"conditions": "TMIG"}, "conditions must be a list"),
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
