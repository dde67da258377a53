"""Virtual studies of the UAV that follows a leader, and of assumptions about people.

Oracles: runs one by one; the counts of a Latin square; textbook sums of squares; the formula of the
answers.
"""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.testbeds import OperatorPopulation

CONDITIONS = ["C1", "C2", "C3", "C4", "C5"]
ASSUMED = {"attention_cost": 0.1, "load_utilization": 0.5, "load_switching": 0.1}


@pytest.fixture(scope="module")
def study():
    return tl.virtual_study(
        n=10, conditions=CONDITIONS, testbed="uav_following", seed=0, assumptions=ASSUMED
    )


def test_measures_are_those_of_the_runs_one_by_one(study):
    assert len(study.measures) == 50
    values = OperatorPopulation.uav_following().draw(10, seed=0).to_dict("records")[3]
    operator, model, thresholds = OperatorPopulation.person(values)
    people = tl.Operator(**{**vars(operator), **ASSUMED})
    seeds = np.random.SeedSequence(0).spawn(10)[3].spawn(5)
    for place, condition in enumerate(CONDITIONS):
        given = thresholds if condition in ("C2", "C3") else None
        run = tl.run_condition(
            condition, people, model, given, testbed="uav_following", seed=seeds[place]
        )
        row = study.measures.query("participant == 4 and condition == @condition").iloc[0]
        assert {name: row[name] for name in run.measures} == pytest.approx(
            run.measures, rel=0, abs=0, nan_ok=True
        )


def test_all_anovas_and_the_t_test_of_the_printed_study(study):
    wide = study.measures.pivot_table("p_r", "participant", "condition", observed=True).to_numpy(
        float
    )
    n, k = wide.shape
    grand = wide.mean()
    between = n * ((wide.mean(axis=0) - grand) ** 2).sum() / (k - 1)
    rest = wide - wide.mean(axis=0) - wide.mean(axis=1, keepdims=True) + grand
    assert (
        pytest.approx(between / ((rest**2).sum() / ((n - 1) * (k - 1)))) == study.analysis("p_r").F
    )
    for dv in ("p_r", "r", "p_h", "tlx", "satisfaction", "trust"):
        assert study.analysis(dv).n == 10
    followed = study.measures.pivot_table(
        "followed_percent", "participant", "condition", observed=True
    )[["C2", "C4"]]
    assert followed.notna().any().all()


def test_half_a_square_is_said_to_be_unbalanced():
    with pytest.warns(
        UserWarning,
        match="5 participants fill half of the last square.*10 participants would balance both",
    ):
        half = tl.virtual_study(n=5, conditions=CONDITIONS, testbed="uav_following", seed=1)
    balance = half.design.balance()
    assert balance.balanced_positions
    assert not balance.balanced_carry_over
    assert half.design.participants == (1, 2, 3, 4, 5)
    with pytest.warns(UserWarning, match="participants: 7 do not fill whole squares.*10 would do"):
        tl.virtual_study(n=7, conditions=CONDITIONS, testbed="uav_following")


def test_same_seed_same_table_serial_or_parallel(study):
    again = tl.virtual_study(
        n=10, conditions=CONDITIONS, testbed="uav_following", seed=0, assumptions=ASSUMED, n_jobs=2
    )
    pd.testing.assert_frame_equal(study.measures, again.measures, check_exact=True)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            {"assumptions": {"atention_cost": 0.1}},
            "an assumption must be one of .*did you mean 'attention_cost'",
        ),
        (
            {"conditions": ["M", "MI"], "assumptions": {"r0": 0.5}, "testbed": None},
            "an assumption must be one of 'adapting'",
        ),
    ],
)
def test_bad_input(arguments, says):
    with pytest.raises(ValueError, match=says):
        tl.virtual_study(
            **({"n": 10, "conditions": CONDITIONS, "testbed": "uav_following"} | arguments)
        )
