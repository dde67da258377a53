"""The limit cycle against long simulation."""

import itertools
import tracemalloc

import matplotlib.pyplot as plt
import numpy as np
import pytest

import trustlab as tl
from tests.allocation.cases import phases, settled, written_out
from trustlab.allocation import limit_cycle, steady
from trustlab.allocation.steady import SCREEN, endless_phase, survey
from trustlab.reproduction import published_table


def from_anywhere(model, lower, upper, seed):
    """The steady part of a run from a random start."""
    rng = np.random.default_rng(seed)
    steps = 2 * int(60.0 / (1.0 - max(model.human.a, model.robot.a)))
    start = {"r0": rng.random(), "mode": int(rng.integers(2))}
    return settled(model, lower, upper, steps, **start)


@pytest.mark.parametrize("name", ["1", "2", "3", "4", "5"])
def test_printed_participants(operators, name):
    pair = published_table("2.2").loc[["TSC_l", "TSC_u"], name].astype(float)
    cycle = limit_cycle(operators[name], *pair)
    run = from_anywhere(operators[name], *pair, 0)
    assert cycle.exists
    assert cycle.always
    for key in ("r", "p_r", "tsc"):
        assert getattr(cycle, f"{key}_low") == pytest.approx(run[key].min(), abs=1e-9)
        assert getattr(cycle, f"{key}_high") == pytest.approx(run[key].max(), abs=1e-9)
    assert cycle.mean_r == pytest.approx(run["r"].mean(), abs=2e-3)
    assert cycle.mean_p_r == pytest.approx(run["p_r"].mean(), abs=2e-4)
    who, lengths = phases(run["mode"])
    for key, mode in (("dwell_manual", 1), ("dwell_autonomous", 0)):
        own = lengths[who == mode]
        assert getattr(cycle, key) == (own.min(), own.max())


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds", [range(250), pytest.param(range(250, 1000), marks=pytest.mark.long)], ids=str
)
def test_random_sets(random_model, seeds):
    """
    1,000 random sets: a long simulation from a random start nearly always has these ranges; where
    motions coexist, some steps of overshoot apart, the bounds for every trajectory hold.
    """
    alike = near = 0
    for seed in seeds:
        case = random_model(np.random.default_rng([17, seed]))
        cycle = limit_cycle(*case)
        run = from_anywhere(*case, seed)
        apart = 0.0
        for key in ("r", "p_r", "tsc"):
            low, high = getattr(cycle, f"{key}_low"), getattr(cycle, f"{key}_high")
            step = run[key].diff().abs().max()
            apart = max(apart, abs(run[key].min() - low) / step, abs(run[key].max() - high) / step)
        if apart > 1e-3:
            bounds = tl.invariant_bounds(*case, cells=32)
            assert bounds.r_low <= run["r"].min(), seed
            assert run["r"].max() <= bounds.r_high, seed
        else:
            # A length that recurs once in hundreds of cycles may be missing from the shorter run.
            who, lengths = phases(run["mode"])
            for mode, (low, high) in ((1, cycle.dwell_manual), (0, cycle.dwell_autonomous)):
                own = lengths[who == mode]
                assert low <= own.min() <= low + 1, seed
                assert high - 1 <= own.max() <= high, seed
        alike += apart <= 1e-3
        near += apart <= 3.0
    assert alike > 0.8 * len(seeds)
    assert near > 0.97 * len(seeds)


def test_a_rule_that_stops_switching_is_an_answer(operators):
    stays = limit_cycle(operators["1"], 0.15, 0.9)
    assert not stays.exists
    assert "stays manual" in stays.reason
    assert "TSC_u = 0.9" in stays.reason
    assert not stays.always
    assert "stays autonomous" in limit_cycle(operators["1"], -0.9, 0.1).reason
    assert np.isnan(stays.table().loc["r", "low"])


def test_the_plot_shows_rule_run_and_cycle(operators):
    axes = limit_cycle(operators["2"], 0.0, 0.35).plot()
    labels = [line.get_label() for line in axes.lines]
    assert labels[0] == "manual below $TSC_l$ = 0"
    assert labels[2:] == ["from near rest", "limit cycle"]
    assert len(limit_cycle(operators["1"], 0.15, 0.9).plot().lines) == 3
    plt.close("all")


def test_a_quick_operator_s_utilization_repeats_before_performance_does():
    """Dwell times alternate although r repeats to 1e-9 within a few cycles. Oracle: simulation."""
    p_h_max = 0.3081556230407075
    robot = tl.RobotModel(0.9980992372861659, 0.12043107813136816, 0.41828420499603064, p_h_max)
    human = tl.HumanModel(0.7770856095253732, 0.6176696259230177, 0.25891627050290766, p_h_max)
    model = tl.TscModel(robot, human)
    pair = 0.40749046230221386, 0.4255255879747638
    cycle = limit_cycle(model, *pair)
    run = from_anywhere(model, *pair, 0)
    assert run["r"].max() > 0.91
    assert cycle.r_high == pytest.approx(run["r"].max(), abs=1e-9)
    assert cycle.r_low == pytest.approx(run["r"].min(), abs=1e-9)
    assert cycle.dwell_manual == (4, 5)


def test_means_are_of_whole_periods():
    """Of its 17 cycles one is long: 300 cycles, some periods and a part, have another mean."""
    human = tl.HumanModel(0.9773112082, 0.6590122170, 0.4711750365, 0.5134963447)
    robot = tl.RobotModel(0.9977032962, 0.2709157444, 0.3449345707, human.p_max)
    model, pair = tl.TscModel(robot, human), (-0.0473185, 0.0)
    motion = written_out(model, pair, 0.6, robot.p_min, 1)
    r, p_r = np.array([row[:2] for row in itertools.islice(motion, 30_000, 31_682)]).T
    assert r[:841] == pytest.approx(r[841:], abs=1e-9)
    cycle = limit_cycle(model, *pair)
    means = r[:841].mean(), p_r[:841].mean()
    assert (cycle.mean_r, cycle.mean_p_r) == pytest.approx(means, abs=1e-7)


def test_coexisting_motions_are_not_one():
    """From rest r is .745 to .755, from β .797 to .803; neither encloses β. Oracle: simulation."""
    human = tl.HumanModel(
        0.9931173542037335, 0.7667916440216367, 0.7135135891192641, 1.191955246242121
    )
    robot = tl.RobotModel(
        0.745136609875909, 0.07233246624518448, 0.5811750650117329, 1.191955246242121
    )
    pair = 0.02376088811222299, 0.35270687220735775
    model = tl.TscModel(robot, human)
    cycle = limit_cycle(model, *pair)
    rest, best = (
        settled(model, *pair, r0=r0, p_r0=p_r0)
        for r0, p_r0 in ((0.0, None), (human.beta, (pair[0] + model.b_T * human.p_max) / model.a_T))
    )
    assert rest["r"].max() < human.beta < best["r"].min()
    assert not cycle.encloses_beta
    assert "another motion" in cycle.reason
    assert (cycle.r_low, cycle.r_high) == pytest.approx(
        (rest["r"].min(), best["r"].max()), abs=1e-6
    )
    assert cycle.mean_r == pytest.approx(best["r"].mean(), abs=1e-3)


def test_a_start_beyond_the_upper_threshold_is_autonomous_at_once():
    """Neither start switches, though others do."""
    robot = tl.RobotModel(a=0.99, p_min=0.8, p_max=1.2, p_h_max=0.6)
    model = tl.TscModel(robot, tl.HumanModel(a=0.8, beta=0.98, p_min=0.3, p_max=0.6))
    assert settled(model, -0.03, 0.12)["mode"].nunique() == 1
    cycle = limit_cycle(model, -0.03, 0.12)
    assert not cycle.exists
    assert "stays autonomous" in cycle.reason


# --- many pairs -----------------------------------------------------------------------------------


def test_a_survey_has_the_motions_of_limit_cycle(operators):
    pairs = np.array([[0.0, 0.3], [-0.1, 0.2], [-3.0, 3.0]])
    models = [operators[name] for name in ("2", "3", "pilot")]
    exact, screened = survey(models, pairs), survey(models, pairs, SCREEN)
    cases = itertools.product(models, pairs.tolist())
    for k, (tsc, pair) in enumerate(cases):
        cycle = limit_cycle(tsc, *pair)
        assert exact["p_switches"][k] == screened["p_switches"][k] == cycle.exists
        assert exact.loc[k, ["lower", "upper"]].tolist() == pair
        if not cycle.exists:
            assert np.isnan(exact["r_low"][k])
            continue
        assert exact["p_encloses"][k] == cycle.encloses_beta
        for rows, near in ((exact, 1e-6), (screened, 0.01)):
            row = rows.loc[k]
            assert row["mean_r"] == pytest.approx(cycle.mean_r, abs=max(near, 1e-3))
            assert row["mean_p_r"] == pytest.approx(cycle.mean_p_r, abs=max(near, 1e-4))
            assert row["r_low"] == pytest.approx(cycle.r_low, abs=near)


def test_a_survey_of_many_pairs_is_small(operators, monkeypatch):
    """Of a posterior a fine grid has a million motions, 26 numbers each."""
    monkeypatch.setattr(steady, "steady_motion", lambda *_: np.ones((6, 3)))
    pairs = steady.grid_of_pairs(0.0, 0.1, 250)
    tracemalloc.start()
    survey([operators["2"]], pairs, SCREEN)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 900 * len(pairs)


# --- phases that never end ------------------------------------------------------------------------


def settles(model, mode, r0):
    """Where TSC settles in one mode; 60 time constants on."""
    run = model.simulate(np.full(150_000, mode), r0, model.robot.p_min)
    return run["tsc"].iloc[-1]


def test_from_where_a_mode_stays_for_ever(operators):
    model = operators["2"]
    rest, load = settles(model, 0.0, 0.0), settles(model, 1.0, 1.0)
    for off in (1e-6, 1e-9):
        assert endless_phase(model, rest + off, load - off).startswith("the mode may stay")
        assert endless_phase(model, rest + off, load + off).startswith("from full load")
        assert endless_phase(model, rest - off, load - off).startswith("from rest")
    middle = rest + 0.3 * (load - rest)
    assert endless_phase(model, middle, rest + 0.5 * (load - rest)) == ""
    text = endless_phase(model, rest - 0.1, middle)
    assert f"TSC settles at {rest:.6g} without falling to TSC_l = {rest - 0.1:.6g}" in text


def test_rounding_widens_the_limits_of_a_slow_robot():
    """P_r stalls 1e-12/(1 − a) before its limit, 1e-9 for a = .999."""
    human = tl.HumanModel(1.0 - 1.0 / 500.0, 0.6, 0.3, 0.5)
    slow = tl.TscModel(tl.RobotModel(1.0 - 1.0 / 1000.0, 0.2, 0.4, 0.5), human)
    rest, load = settles(slow, 0.0, 0.0), settles(slow, 1.0, 1.0)
    assert "from rest" in endless_phase(slow, rest + 0.8e-9, 0.1)
    assert "from rest" not in endless_phase(slow, rest + 1.2e-9, 0.1)
    middle = 0.5 * (rest + load)
    assert "from full load" in endless_phase(slow, middle, load - 0.8e-9)
    assert "from full load" not in endless_phase(slow, middle, load - 1.2e-9)
