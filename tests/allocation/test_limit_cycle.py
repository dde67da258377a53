"""The steady cycle against long simulation."""

import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation import limit_cycle, simulate_allocation
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
