"""The steady cycle against long simulation."""

import re

import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation import limit_cycle, simulate_allocation
from trustlab.allocation.cycle import phases
from trustlab.allocation.cycle.limit_cycle import (
    CycleMotion,
    MotionSearch,
    _initial_states,
    _period,
)
from trustlab.reproduction import published_table


def settled(model, lower, upper, seed):
    rng = np.random.default_rng(seed)
    slow = max(model.human.a, model.robot.a)
    steps = int(60.0 / (1.0 - slow))
    run = simulate_allocation(
        model, lower, upper, 2 * steps, rng.random(), None, int(rng.integers(2))
    )
    return run.iloc[steps:]


def dwell_times(run, mode):
    edges = np.flatnonzero(np.diff(run["mode"])) + 1
    who = run["mode"].to_numpy()[edges[:-1]]
    return np.diff(edges)[who == mode]


@pytest.mark.parametrize("name", ["1", "2", "3", "4", "5"])
def test_printed_participants(operators, name):
    lower, upper = published_table("2.2").loc[["TSC_l", "TSC_u"], name].astype(float)
    cycle = limit_cycle(operators[name], lower, upper)
    run = settled(operators[name], lower, upper, 0)
    assert cycle.exists
    assert cycle.unique
    assert cycle.stable
    assert cycle.period in (1, 2)
    for key in ("r", "p_r", "tsc"):
        assert getattr(cycle, f"{key}_low") == pytest.approx(run[key].min(), abs=1e-9)
        assert getattr(cycle, f"{key}_high") == pytest.approx(run[key].max(), abs=1e-9)
    for key, mode in (("dwell_manual", 1), ("dwell_autonomous", 0)):
        lengths = dwell_times(run, mode)
        assert getattr(cycle, key) == (lengths.min(), lengths.max())


def test_dwell_times_alternate_for_participant_3(operators):
    cycle = limit_cycle(operators["3"], 0.0, 0.27)
    assert cycle.period == 2
    assert cycle.dwell_manual == (208, 209)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds", [range(250), pytest.param(range(250, 1000), marks=pytest.mark.long)], ids=str
)
def test_random_sets(random_model, seeds):
    """
    1,000 random sets: a long simulation from a random start stays in the ranges, exactly where the
    motion repeats.
    """
    repeating = 0
    for seed in seeds:
        model, lower, upper = random_model(np.random.default_rng([17, seed]))
        cycle = limit_cycle(model, lower, upper)
        run = settled(model, lower, upper, seed)
        alone = (
            cycle.period is not None and cycle.motions == 1 and "every other" not in cycle.reason
        )
        repeating += alone
        tolerance = 1e-9 if alone else 1e-6
        for key in ("r", "p_r", "tsc"):
            assert run[key].min() >= getattr(cycle, f"{key}_low") - tolerance, (seed, key)
            assert run[key].max() <= getattr(cycle, f"{key}_high") + tolerance, (seed, key)
            if alone:
                assert run[key].min() <= getattr(cycle, f"{key}_low") + tolerance, (seed, key)
                assert run[key].max() >= getattr(cycle, f"{key}_high") - tolerance, (seed, key)
        for key, mode in (("dwell_manual", 1), ("dwell_autonomous", 0)):
            lengths, range_ = dwell_times(run, mode), getattr(cycle, key)
            assert range_[0] <= lengths.min(), (seed, key)
            assert lengths.max() <= range_[1], (seed, key)
    assert repeating > len(seeds) // 2


def test_means_are_time_averages(operators):
    cycle = limit_cycle(operators["pilot"], 0.02, 0.45)
    run = simulate_allocation(operators["pilot"], 0.02, 0.45, 400_000).iloc[100_000:]
    assert cycle.mean_r == pytest.approx(run["r"].mean(), abs=2e-4)
    assert cycle.mean_p_r == pytest.approx(run["p_r"].mean(), abs=2e-4)
    assert list(cycle.table().columns) == ["low", "high", "mean"]


def test_a_rule_that_stops_switching_is_an_answer(operators):
    stays = limit_cycle(operators["1"], 0.15, 0.9)
    assert not stays.exists
    assert "stays manual" in stays.reason
    assert "TSC_u = 0.9" in stays.reason
    assert (stays.always, stays.period, stays.motions) == (False, None, 0)
    assert "stays autonomous" in limit_cycle(operators["1"], -0.9, 0.1).reason
    assert np.isnan(stays.table().loc["r", "low"])


@pytest.mark.parametrize("starts", [0, -3, 2.5, np.nan, np.inf, None, "8", True, [4]])
def test_refuses_starts_that_are_no_whole_number(operators, starts):
    with pytest.raises(ValueError, match="starts must be a whole number"):
        limit_cycle(operators["1"], 0.1, 0.5, starts=starts)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, None, "0.1", True, [0.1, 0.2]])
def test_refuses_thresholds_that_are_no_numbers(operators, wrong):
    with pytest.raises(ValueError, match="lower"):
        limit_cycle(operators["1"], wrong, 0.5)
    with pytest.raises(ValueError, match="upper"):
        limit_cycle(operators["1"], 0.1, wrong)


@pytest.mark.parametrize(("lower", "upper"), [(0.5, 0.1), (0.3, 0.3)])
def test_refuses_thresholds_in_the_wrong_order(operators, lower, upper):
    with pytest.raises(ValueError, match="below"):
        limit_cycle(operators["1"], lower, upper)


@pytest.mark.parametrize("model", [None, 3.0, "pilot", {}])
def test_refuses_what_is_no_model(model):
    with pytest.raises(ValueError, match="tsc must be of class TscModel"):
        limit_cycle(model, 0.1, 0.5)


@pytest.mark.parametrize(("seed", "periods"), [(4980, {2, 3}), (5910, {17, 20})])
def test_rare_coexisting_motions_are_found(random_model, seed, periods):
    """
    Two sets with a second motion that few starts are drawn to; it was found by brute force from
    random starts.
    """
    model, lower, upper = random_model(np.random.default_rng([17, seed]))
    cycle = limit_cycle(model, lower, upper)
    assert cycle.motions == 2
    assert cycle.period is None
    listed = cycle.reason.partition("(periods ")[2].partition(")")[0]
    assert {int(word) for word in listed.split(", ")} == periods
    for start in range(4):
        run = settled(model, lower, upper, start)
        for key in ("r", "p_r", "tsc"):
            assert run[key].min() >= getattr(cycle, f"{key}_low") - 1e-9
            assert run[key].max() <= getattr(cycle, f"{key}_high") + 1e-9
    # Negative control: the quick setting simulates from β and rest alone, and finds one of them
    # only.
    assert limit_cycle(model, lower, upper, starts=1).motions == 1


def test_utilization_that_saturates_has_a_cycle_too():
    model = tl.TscModel(
        tl.RobotModel(0.999, 0.24, 0.39, 0.4602), tl.HumanModel(0.5, 0.5, 0.391, 0.4602)
    )
    cycle = limit_cycle(model, -0.4, 0.4)
    assert cycle.exists
    assert cycle.always
    assert cycle.unique
    assert (cycle.r_low, cycle.r_high) == pytest.approx((0.0, 1.0), abs=1e-12)


def test_the_plot_shows_rule_run_and_cycle(operators):
    import matplotlib.pyplot as plt

    axes = limit_cycle(operators["2"], 0.0, 0.35).plot()
    labels = [line.get_label() for line in axes.lines]
    assert labels == ["$TSC_l$ = 0", "$TSC_u$ = 0.35", "from near rest", "steady cycle"]
    lower, upper, _, cycle = axes.lines
    low, high = (np.interp(cycle.get_xdata(), *line.get_data()) for line in (lower, upper))
    assert ((cycle.get_ydata() > low - 1e-3) & (cycle.get_ydata() < high + 1e-3)).all()
    assert len(limit_cycle(operators["1"], 0.15, 0.9).plot().lines) == 3
    plt.close("all")


def test_a_quick_operator_s_utilization_repeats_before_performance_does():
    """Dwell times alternate although r repeats to 1e-9 within a few cycles. Oracle: simulation."""
    p_h_max = 0.3081556230407075
    robot = tl.RobotModel(0.9980992372861659, 0.12043107813136816, 0.41828420499603064, p_h_max)
    human = tl.HumanModel(0.7770856095253732, 0.6176696259230177, 0.25891627050290766, p_h_max)
    model = tl.TscModel(robot, human)
    lower, upper = 0.40749046230221386, 0.4255255879747638
    cycle = limit_cycle(model, lower, upper)
    run = settled(model, lower, upper, 0)
    assert run["r"].max() > 0.91
    assert cycle.r_high == pytest.approx(run["r"].max(), abs=1e-9)
    assert cycle.r_low == pytest.approx(run["r"].min(), abs=1e-9)
    assert cycle.dwell_manual == (4, 5)


# --- the search -----------------------------------------------------------------------------------


def returned(model, r, lower, upper):
    """Utilization one cycle later, thresholds met between samples; from `TscModel.simulate`."""
    for mode, start, target in ((1.0, lower, upper), (0.0, upper, lower)):
        p_r = (start + model.b_T * model.human.performance(r)) / model.a_T
        run = model.simulate(np.full(20_000, mode), r, p_r)
        beyond = run["tsc"] >= target if mode else run["tsc"] <= target
        after = beyond.iloc[1:].idxmax()
        before = run.loc[after - 1]
        part = (target - before["tsc"]) / (run.loc[after, "tsc"] - before["tsc"])
        r = mode + (before["r"] - mode) * model.human.a**part
    return r


@pytest.mark.parametrize(
    ("name", "lower", "upper"), [("2", 0.0, 0.35), ("3", 0.0, 0.27), ("pilot", 0.02, 0.45)]
)
def test_slope_and_fixed_point_of_the_return_map(operators, name, lower, upper):
    model = operators[name]
    cycle = limit_cycle(model, lower, upper, starts=1)
    grid = np.array([0.2, 0.5, cycle.r_manual])
    expected = [returned(model, r, lower, upper) for r in grid]
    np.testing.assert_allclose(cycle._returned(grid), expected, rtol=0, atol=1e-12)
    # The map leads back to within a step of the motion with its overshoot.
    assert abs(expected[2] - cycle.r_manual) < 2.0 * model.human.b
    step = 1e-3 * min(cycle.r_manual, 1.0 - cycle.r_manual)
    around = [returned(model, cycle.r_manual + side * step, lower, upper) for side in (-1, 1)]
    assert cycle.slope == pytest.approx((around[1] - around[0]) / (2.0 * step), rel=1e-3, abs=1e-6)
    assert cycle.stable == (abs(cycle.slope) < 1.0)


def rows_of(r, p_r, manual):
    rows = np.zeros(len(r), phases.CYCLE)
    rows["r"], rows["p_r"], rows["manual"] = r, p_r, manual
    return rows


def test_a_motion_repeats_if_it_was_seen_three_times():
    """In r, in P_r and in dwell times, to a part in 1e9."""
    r, p_r, dwell = [0.3, 0.5], [0.2, 0.4], [7, 9]
    assert _period(rows_of(np.tile(r, 3), np.tile(p_r, 3), np.tile(dwell, 3))) == 2
    assert _period(rows_of(np.tile(r, 3)[:5], np.tile(p_r, 3)[:5], np.tile(dwell, 3)[:5])) is None
    assert _period(rows_of([0.3] * 6, [0.2] * 6, np.tile(dwell, 3))) == 2
    assert _period(rows_of([0.3] * 6, np.tile(p_r, 3), [7] * 6)) == 2
    assert _period(rows_of([0.3] * 3, [0.2] * 3, [7] * 3)) == 1
    for amount, repeats in ((0.5e-9, 1), (2e-9, None)):
        drift = np.array([0.3, 0.3, 0.3 + amount])
        assert _period(rows_of(drift, [0.2] * 3, [7] * 3)) == repeats
        assert _period(rows_of([0.3] * 3, drift, [7] * 3)) == repeats


def test_motions_are_told_apart_by_period_and_least_utilization():
    def motion(period, least):
        return CycleMotion(rows_of([least, 0.5], [0.2, 0.4], [7, 9]), phases.NOTHING, period)

    assert motion(2, 0.3).same(motion(2, 0.3 + 0.5e-8))
    assert not motion(2, 0.3).same(motion(2, 0.3 + 2e-8))
    assert not motion(2, 0.3).same(motion(3, 0.3))
    assert not motion(None, 0.3).same(motion(None, 0.3))
    assert motion(2, 0.3).passes(0.5 + 1.9e-5, 0.4 - 1.9e-5)
    assert not motion(2, 0.3).passes(0.5 + 2.1e-5, 0.4)
    assert not motion(2, 0.3).passes(0.5, 0.4 - 2.1e-5)


def test_starts_fill_the_states_in_which_manual_phases_can_begin(operators):
    """
    At β and at rest; then all over [0, 1], TSC at most one step below TSC_l; once a motion is
    known, within a step of its utilization and within 1.2 times its overshoot.
    """
    model, lower, upper = operators["2"], 0.0, 0.35
    human, robot = model.human, model.robot
    step = model.a_T * (1.0 - robot.a) * (robot.p_max - robot.p_min)
    search = MotionSearch(model, lower, upper)
    early = list(_initial_states(model, lower, 400, search))
    assert early[0][0] == human.beta
    assert model.value(early[0][1], human.p_max) == pytest.approx(lower, abs=1e-12)
    assert early[1] == (0.0, robot.p_min)
    r, p_r = np.array(early[2:]).T
    over = (lower - model.value(p_r, human.performance(r))) / step
    for values in (r, over):  # evenly: no gap longer than a few 400ths
        assert values.min() > -1e-12
        assert np.diff(np.sort([0.0, *values, 1.0])).max() < 4.0 / 400.0
    assert len(early) == 401

    search.follow(*early[0])
    states = list(_initial_states(model, lower, 400, search))
    assert states[:51] == early[:51]  # the first eighth is the same
    assert not set(states[51:]) & set(early[51:])
    (motion,) = search.motions
    r, p_r = np.array(states[51:]).T
    assert r.min() == pytest.approx(motion.rows["r"].min() - human.b, abs=1e-4)
    assert r.max() == pytest.approx(motion.rows["r"].max() + human.b, abs=1e-4)
    deepest = lower - motion.extremes.tsc_low
    over = (lower - model.value(p_r, human.performance(r))) / max(deepest, 0.2 * step)
    assert over.min() == pytest.approx(0.0, abs=0.02)
    assert over.max() == pytest.approx(1.2, abs=0.02)


def test_a_mode_that_stays_from_a_state_that_no_start_met_is_said(operators, monkeypatch):
    usual = limit_cycle(operators["2"], 0.0, 0.35, starts=1)
    assert usual.always
    monkeypatch.setattr(
        phases, "endless_phase", lambda tsc, lower, upper: "from full load it stays"
    )
    cycle = limit_cycle(operators["2"], 0.0, 0.35, starts=1)
    assert cycle.exists
    assert not cycle.always
    assert cycle.reason == f"{usual.reason}; but from full load it stays"


def test_what_effort_left_out_is_said(operators, monkeypatch):
    full = limit_cycle(operators["2"], 0.0, 0.35, starts=8)
    assert "simulated" not in full.reason
    monkeypatch.setattr(phases, "EFFORT", 150_000)
    short = limit_cycle(operators["2"], 0.0, 0.35, starts=8)
    assert re.search(r"; [1-8] of 9 starts were simulated, in about 2e\+05 samples", short.reason)
    assert (short.r_low, short.r_high) == (full.r_low, full.r_high)
    monkeypatch.setattr(phases, "EFFORT", 100_001)
    assert "; 1 of 2 starts" in limit_cycle(operators["2"], 0.0, 0.35, starts=1).reason


@pytest.mark.parametrize("effort", [150_000, 500_000])
def test_motions_that_do_not_repeat_are_recorded_within_the_effort(operators, monkeypatch, effort):
    model, lower, upper = operators["2"], 0.0, 0.35
    length = limit_cycle(model, lower, upper, starts=1)
    samples = np.mean(length.dwell_manual) + np.mean(length.dwell_autonomous)
    monkeypatch.setattr("trustlab.allocation.cycle.limit_cycle._period", lambda rows: None)
    monkeypatch.setattr(phases, "EFFORT", effort)
    cycle = limit_cycle(model, lower, upper, starts=1)
    assert cycle.period is None
    cycles = int(re.search(r"does not repeat within (\d+) cycles", cycle.reason)[1])
    assert 24 < cycles < 2000
    assert cycles == pytest.approx(effort / samples, rel=0.01)
    monkeypatch.setattr("trustlab.allocation.cycle.limit_cycle.MOST_CYCLES", 20)
    assert "within 20 cycles" in limit_cycle(model, lower, upper, starts=1).reason
