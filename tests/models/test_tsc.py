"""(2.1)-(2.2) by what they are made for, and the printed step bound of Remark 3."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st

import trustlab as tl
from trustlab.models.tsc import advance, human_at, human_range, threshold_mode, tsc_at


@st.composite
def models(draw):
    r_min, h_min = draw(st.floats(0.0, 0.5)), draw(st.floats(0.0, 0.5))
    robot = tl.RobotModel(0.99, r_min, r_min + draw(st.floats(0.02, 0.5)), 0.9)
    return tl.TscModel(
        robot,
        tl.HumanModel(0.999, draw(st.floats(0.1, 0.9)), h_min, h_min + draw(st.floats(0.02, 0.5))),
    )


@given(models())
def test_extremes_are_plus_and_minus_one(model):
    robot, human = model.robot, model.human
    assert model.value(robot.p_max, human.p_min) == pytest.approx(1.0, abs=1e-12)
    assert model.value(robot.p_min, human.p_max) == pytest.approx(-1.0, abs=1e-12)
    grid = model.value(
        np.linspace(robot.p_min, robot.p_max, 50)[:, None],
        np.linspace(human.p_min, human.p_max, 50)[None, :],
    )
    assert np.abs(grid).max() <= 1.0 + 1e-12


def test_step_bound_of_the_pilot_is_the_printed_one(operators):
    # Remark 3: δ_Pr = 0.00069 and δ_Ph = 0.00021 give 0.0084.
    assert round(operators["pilot"].delta(0.00069, 0.00021), 4) == 0.0084


def test_simulation_is_the_two_models_in_turn(operators, switching):
    model = operators["pilot"]
    run = model.simulate(switching, r0=0.2, p_r0=0.25)
    r, p_h = model.human.simulate(switching, 0.2)
    np.testing.assert_array_equal(run["r"], r)
    np.testing.assert_array_equal(run["p_r"], model.robot.simulate(switching, p_h, 0.25))
    np.testing.assert_allclose(
        run["tsc"], model.a_T * run["p_r"] - model.b_T * run["p_h"], atol=1e-15
    )
    assert list(run.columns) == ["r", "p_r", "p_h", "tsc", "mode"]
    rested = model.simulate(switching)
    assert (rested["r"].iloc[0], rested["p_r"].iloc[0]) == (0.0, model.robot.p_min)


def test_refuses():
    robot, human = tl.RobotModel(0.99, 0.2, 0.4, 0.5), tl.HumanModel(0.999, 0.7, 0.3, 0.5)
    with pytest.raises(ValueError, match="in this order; got HumanModel and RobotModel"):
        tl.TscModel(human, robot)
    with pytest.raises(ValueError, match="got HumanModel and HumanModel"):
        tl.TscModel(human, human)
    with pytest.raises(ValueError, match="delta_p_r must not be negative"):
        tl.TscModel(robot, human).delta(-0.1, 0.0)


@pytest.mark.parametrize(
    ("of_robot", "of_human"),
    [
        ((-0.4, 0.2), (0.3, 0.5)),
        ((-0.5, 0.5), (0.2, 0.4)),  # b_T = 0
        ((0.2, 0.4), (-0.5, 0.5)),  # a_T = 0
        ((-1.0, 1.0), (-1.0, 1.0)),  # no denominator
        ((-2.0, -1.0), (-2.0, -1.0)),  # quotients of negative numbers
        ((-2.0, 0.5), (-2.0, 0.5)),
    ],
)
def test_ranges_without_weights_are_refused(of_robot, of_human):
    with pytest.raises(ValueError, match=r"a_T and b_T of \(2\.2\) must be positive"):
        tl.TscModel(tl.RobotModel(0.99, *of_robot, 0.5), tl.HumanModel(0.999, 0.7, *of_human))


@given(st.floats(-1.0, 1.0), st.floats(1e-3, 1.0), st.floats(-1.0, 1.0), st.floats(1e-3, 1.0))
def test_ranges_are_accepted_where_both_weights_and_their_denominator_are_positive(a, b, c, d):
    """Oracle: (2.2) written out in exact fractions."""
    r_min, r_max, h_min, h_max = map(Fraction, (a, a + b, c, c + d))
    scale = r_max * h_max - r_min * h_min
    right = scale > 0 and (h_min + h_max) / scale > 0 and (r_min + r_max) / scale > 0
    models = tl.RobotModel(0.99, a, a + b, 0.5), tl.HumanModel(0.999, 0.7, c, c + d)
    if right:
        assert tl.TscModel(*models).a_T > 0.0
    else:
        with pytest.raises(ValueError, match="must be positive"):
            tl.TscModel(*models)


def test_compiled_equations_are_those_of_the_models(operators, switching):
    model = operators["pilot"]
    c, run = model.constants(), model.simulate(switching, r0=0.2, p_r0=0.25)
    assert c._asdict() == {
        "a_r": model.human.a,
        "beta": model.human.beta,
        "p_h_min": model.human.p_min,
        "p_h_max": model.human.p_max,
        "a_pr": model.robot.a,
        "b_pr": model.robot.b,
        "p_r_min": model.robot.p_min,
        "p_r_max": model.robot.p_max,
        "a_T": model.a_T,
        "b_T": model.b_T,
    }
    r, p_r = 0.2, 0.25
    for row in run.head(500).itertuples():
        assert (r, p_r) == (row.r, row.p_r)
        p_h = human_at(r, c)
        assert p_h == row.p_h
        assert tsc_at(p_r, p_h, c) == row.tsc
        r, p_r = advance(r, p_r, p_h, row.mode, c)


@given(models(), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_range_of_human_performance_is_that_of_a_fine_grid(model, one, other):
    low, high = sorted((one, other))
    values = model.human.performance(np.linspace(low, high, 400))
    least, greatest = human_range(low, high, model.constants())
    assert least == pytest.approx(values.min(), abs=1e-12)
    assert values.max() - 1e-12 <= greatest <= values.max() + 0.005


def test_the_rule_switches_at_the_thresholds_and_holds_between_them():
    assert [threshold_mode(tsc, 0.1, 0.4, mode) for tsc in (0.1, 0.25, 0.4) for mode in (0, 1)] == [
        1,
        1,
        0,
        1,
        0,
        0,
    ]
