"""Sweeps against limit_cycle called point by point; sensitivities against what must come out."""

import dataclasses
import math

import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation.parameter_sweep import QUANTITIES, varied_model


def test_every_point_is_the_cycle_of_its_model(operators):
    tsc = operators["pilot"]
    lowers, betas = [0.0, 0.1, 0.3], [0.7, 0.8]
    found = tl.sweep(tsc, {"lower": lowers, "human.beta": betas}, upper=0.3, n_jobs=1)
    table = found.table()
    assert list(table.columns) == ["lower", "human.beta", "upper", "exists", *QUANTITIES, "reason"]
    assert len(table) == 6
    for row in table.itertuples(index=False):
        row = dict(zip(table.columns, row, strict=True))
        if row["lower"] == 0.3:
            assert not row["exists"]
            assert "not defined" in row["reason"]
            assert all(math.isnan(row[name]) for name in QUANTITIES)
            continue
        human = dataclasses.replace(tsc.human, beta=row["human.beta"])
        cycle = tl.limit_cycle(tl.TscModel(tsc.robot, human), row["lower"], 0.3, starts=1)
        assert row["mean_p_r"] == cycle.mean_p_r
        assert row["r_high"] == cycle.r_high
        assert (row["dwell_manual_low"], row["dwell_manual_high"]) == cycle.dwell_manual
        assert (row["dwell_autonomous_low"], row["dwell_autonomous_high"]) == cycle.dwell_autonomous


def test_where_the_rule_stops_switching_there_is_a_reason_and_no_number(operators):
    table = tl.sweep(operators["pilot"], {"upper": [0.3, 2.0]}, lower=0.0, n_jobs=1).table()
    assert list(table["exists"]) == [True, False]
    assert "stays manual" in table["reason"][1]
    assert table[list(QUANTITIES)].iloc[1].isna().all()


def test_wider_thresholds_mean_longer_phases(operators):
    """A property of the rule: in each mode TSC has further to go."""
    table = tl.sweep(operators["pilot"], {"upper": [0.2, 0.3, 0.4]}, lower=0.0, n_jobs=1).table()
    assert np.all(np.diff(table["dwell_manual_low"]) > 0)
    assert np.all(np.diff(table["dwell_autonomous_low"]) > 0)


def test_what_follows_from_a_change(operators):
    tsc = operators["pilot"]
    robot = tsc.robot
    follows = varied_model(tsc, {"robot.a": 0.99}).robot
    assert follows.b == pytest.approx(0.01 * (robot.p_max - robot.p_min) / robot.p_h_max, rel=1e-12)
    printed = tl.TscModel(dataclasses.replace(robot, b=0.0013), tsc.human)
    assert varied_model(printed, {"robot.a": 0.99}).robot.b == 0.0013
    assert varied_model(tsc, {"human.p_max": 0.5}).robot.p_h_max == 0.5
    assert varied_model(tsc, {"human.p_max": 0.5, "robot.p_h_max": 0.48}).robot.p_h_max == 0.48
    other = tl.TscModel(dataclasses.replace(robot, p_h_max=0.6), tsc.human)
    assert varied_model(other, {"human.p_max": 0.5}).robot.p_h_max == 0.6
    assert varied_model(tsc, {}) == tsc
    with pytest.raises(ValueError, match=r"what is varied must be one of .*, got 'beta'"):
        varied_model(tsc, {"beta": 0.5})


def test_sensitivity_points_at_what_was_varied_most(operators):
    ranges = {"upper": (0.2, 0.4), "human.beta": (0.739, 0.741)}
    found = tl.cycle_sensitivity(
        operators["pilot"],
        ranges,
        32,
        lower=0.0,
        quantities=("mean_p_r", "dwell_autonomous_high"),
        n_jobs=1,
        resamples=50,
    )
    table = found.table().set_index(["result", "parameter"])
    assert table.loc[("dwell_autonomous_high", "upper"), "total"] > 0.8
    assert table.loc[("dwell_autonomous_high", "human.beta"), "total"] < 0.1
    with pytest.raises(
        ValueError, match=r"a result is not finite, first at .*'mean_p_r': nan.* narrow the ranges"
    ):
        tl.cycle_sensitivity(
            operators["pilot"],
            {"upper": (0.2, 2.0), "human.beta": (0.7, 0.8)},
            8,
            lower=0.0,
            n_jobs=1,
        )


def test_plots_show_maps_and_lines(operators):
    import matplotlib.pyplot as plt

    found = tl.sweep(operators["pilot"], {"lower": [0.1, 0.0], "upper": [0.05, 0.3, 0.4]}, n_jobs=1)
    axes = found.plot("mean_r")
    (mesh,) = axes.collections
    shown = mesh.get_array().reshape(3, 2)
    table = found.table().set_index(["lower", "upper"])["mean_r"]
    want = [[table[lower, upper] for lower in (0.0, 0.1)] for upper in (0.05, 0.3, 0.4)]
    np.testing.assert_array_equal(np.ma.filled(shown, np.nan), want)
    assert "blank: no cycle (1 of 6 points)" in axes.get_title()
    assert axes.get_xlabel() == "lower threshold $TSC_l$"
    line = tl.sweep(operators["pilot"], {"upper": [0.3, 0.4]}, lower=0.0, n_jobs=1)
    assert (
        line.plot("dwell_manual_low").lines[0].get_ydata().tolist()
        == line.table()["dwell_manual_low"].tolist()
    )
    for arguments, said in (
        ({"quantity": "r"}, "quantity must be one of"),
        ({"x": "beta"}, "x, among what was varied, must be one of"),
        ({"x": "lower", "y": "lower"}, "must be different"),
    ):
        with pytest.raises(ValueError, match=said):
            found.plot(**arguments)
    three = tl.sweep(
        operators["pilot"],
        {"lower": [0.0], "upper": [0.3, 0.4], "human.beta": [0.7, 0.75]},
        n_jobs=1,
    )
    with pytest.raises(ValueError, match=r"human.beta was varied too"):
        three.plot("mean_r")
    three.plot("mean_r", x="upper", y="human.beta")
    plt.close("all")


@pytest.mark.parametrize(
    ("axes", "rest", "said"),
    [
        ({}, {}, "give what to vary"),
        ([0.1], {}, "give what to vary"),
        ({"beta": [0.7]}, {}, "what is varied must be one of 'lower', 'upper', 'robot.a'"),
        ({"upper": [0.3]}, {}, "threshold lower is missing"),
        ({"lower": [0.0], "upper": [0.3]}, {"lower": 0.1}, "threshold lower is there twice"),
        ({"upper": [0.3, np.nan]}, {"lower": 0.0}, "upper must be finite"),
        ({"upper": [0.3, 0.3]}, {"lower": 0.0}, "upper has a value twice"),
        ({"upper": []}, {"lower": 0.0}, "upper must be one-dimensional"),
        ({"upper": ["a"]}, {"lower": 0.0}, "upper must be an array of numbers"),
        ({"upper": [0.3]}, {"lower": "a"}, "lower must be a number"),
        ({"upper": [0.3]}, {"lower": 0.0, "starts": 0}, "starts must be"),
    ],
)
def test_bad_input_is_refused(operators, axes, rest, said):
    with pytest.raises(ValueError, match=said):
        tl.sweep(operators["pilot"], axes, n_jobs=1, **rest)


def test_other_bad_input_is_refused(operators):
    with pytest.raises(ValueError, match="tsc must be of class TscModel"):
        tl.sweep(5, {"upper": [0.3]}, lower=0.0)
    for quantities in (("r",), (), "mean_r"):
        with pytest.raises(ValueError, match="quantities must be among"):
            tl.cycle_sensitivity(
                operators["pilot"], {"upper": (0.2, 0.3)}, 8, lower=0.0, quantities=quantities
            )
