"""(2.1)-(2.2) by what they are made for, and the printed step bound of Remark 3."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trustlab as tl


@st.composite
def models(draw):
    r_min, h_min = draw(st.floats(0.0, 0.5)), draw(st.floats(0.0, 0.5))
    robot = tl.RobotModel(0.99, r_min, r_min + draw(st.floats(0.02, 0.5)), 0.9)
    return tl.TscModel(
        robot, tl.HumanModel(0.999, draw(st.floats(0.1, 0.9)), h_min, h_min + draw(st.floats(0.02, 0.5)))
    )


@given(models())
def test_extremes_are_plus_and_minus_one(model):
    robot, human = model.robot, model.human
    assert model.value(robot.p_max, human.p_min) == pytest.approx(1.0, abs=1e-12)
    assert model.value(robot.p_min, human.p_max) == pytest.approx(-1.0, abs=1e-12)
    grid = model.value(
        np.linspace(robot.p_min, robot.p_max, 50)[:, None], np.linspace(human.p_min, human.p_max, 50)[None, :]
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
    np.testing.assert_allclose(run["tsc"], model.a_T * run["p_r"] - model.b_T * run["p_h"], atol=1e-15)
    assert list(run.columns) == ["r", "p_r", "p_h", "tsc", "mode"]


def test_refuses():
    robot, human = tl.RobotModel(0.99, 0.2, 0.4, 0.5), tl.HumanModel(0.999, 0.7, 0.3, 0.5)
    with pytest.raises(ValueError, match="in this order; got HumanModel and RobotModel"):
        tl.TscModel(human, robot)
    with pytest.raises(ValueError, match="a_T and b_T"):
        tl.TscModel(tl.RobotModel(0.99, -0.4, 0.2, 0.5), human)
    with pytest.raises(ValueError, match="cannot be negative"):
        tl.TscModel(robot, human).delta(-0.1, 0.0)
