"""Printed participants as operators, against Tables 2.1, 2.2, 2.3 and 2.6."""

import numpy as np
import pytest

import trustlab as tl
from trustlab.testbeds import (
    published_model,
    published_operator,
    published_thresholds,
    run_condition,
)
from trustlab.testbeds.ground_robot.conditions import drive_modes

PEOPLE = ("1", "2", "3", "4", "5")


@pytest.mark.parametrize("name", PEOPLE)
def test_operators_are_what_the_tables_print(operators, name):
    who = published_operator(name)
    own, shares, pair = (
        tl.published_table(number)[name].astype(float) for number in ("2.3", "2.6", "2.2")
    )
    assert who.participant == name
    assert who.human == operators[name].human == published_model(name).human
    assert [who.lower, who.lower_spread, who.upper, who.upper_spread] == own.tolist()
    followed = 100.0 * who.follow_tsc, 100.0 * who.follow_performance
    assert followed == pytest.approx((shares["C2"], shares["C4"]))
    assert published_thresholds(name) == (pair["TSC_l"], pair["TSC_u"])


@pytest.mark.parametrize("name", ["pilot", *PEOPLE])
def test_performance_under_manual_control_is_the_models(operators, name):
    """
    Oracle: (2.6) and the steady state of (2.3); a hand that drove equally well for all missed P_r
    by up to 0.03.
    """
    model, who = operators[name], published_operator(name)
    runs = [
        drive_modes(np.ones(4000, int), who, seed, r0=0.8 * model.human.beta) for seed in range(4)
    ]
    p_h = np.mean([model.human.performance(run["r"][2000:]).mean() for run in runs])
    assert np.mean([run["p_h"][2000:].mean() for run in runs]) == pytest.approx(p_h, abs=0.007)
    p_r = np.mean([run["p_r"][2000:].mean() for run in runs])
    assert p_r == pytest.approx(model.robot.steady_state(1.0, p_h), abs=0.009)


@pytest.mark.parametrize("name", ["1", "2", "4", "5"])
def test_captured_thresholds_lie_one_reaction_beyond_the_operators_own(name):
    """
    Oracle: own thresholds, and how far TSC runs on in the reaction; before the window was full it
    was far too high.
    """
    who = published_operator(name)
    runs = [run_condition("C1", name, seed=seed, r0=0.5).session for seed in range(6)]
    found = tl.estimate_thresholds(runs)
    assert found.distinguishable
    assert -0.14 < found.lower - who.lower < 0.0
    assert -0.05 < found.upper - who.upper < 0.1
