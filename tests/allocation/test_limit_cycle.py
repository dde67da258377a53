"""The limit cycle against long simulation."""

import itertools
import tracemalloc

import matplotlib.pyplot as plt
import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

import trustlab as tl
from tests.allocation.cases import (
    OPERATORS,
    SECOND,
    ends_of_tsc,
    made,
    phases,
    random_case,
    settled,
    written_out,
)
from trustlab.allocation import limit_cycle, steady
from trustlab.allocation.steady import SCREEN, endless_phase, survey

approx = pytest.approx


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds", [range(250), pytest.param(range(250, 1000), marks=pytest.mark.long)], ids=str
)
def test_random_sets(seeds):
    """
    1,000 random sets: a long simulation from a random start nearly always has these ranges; where
    motions coexist, some steps of overshoot apart, the bounds for every trajectory hold.
    """
    names, apart = ["r", "p_r", "tsc"], []
    for seed in seeds:
        case = random_case(default_rng([17, seed]))
        cycle, rng = limit_cycle(*case), default_rng(seed)
        steps = 2 * int(60.0 / (1.0 - max(case[0].human.a, case[0].robot.a)))
        run = settled(*case, steps, r0=rng.random(), mode=int(rng.integers(2)))
        ends = cycle.table().loc[["r", "P_r", "TSC"], ["low", "high"]].to_numpy()
        seen = run[names].agg(["min", "max"]).T.to_numpy()
        apart.append((np.abs(seen - ends).T / run[names].diff().abs().max().to_numpy()).max())
        if apart[-1] > 1e-3:
            bounds = tl.invariant_bounds(*case, cells=32)
            assert bounds.r_low <= run["r"].min(), seed
            assert run["r"].max() <= bounds.r_high, seed
            continue
        # A length that recurs once in hundreds of cycles may be missing from the shorter run.
        who, lengths = phases(run["mode"])
        for mode, (low, high) in ((1, cycle.dwell_manual), (0, cycle.dwell_autonomous)):
            own = lengths[who == mode]
            assert low <= own.min() <= low + 1, seed
            assert high - 1 <= own.max() <= high, seed
    assert np.mean(np.array(apart) <= 1e-3) > 0.8
    assert np.mean(np.array(apart) <= 3.0) > 0.97


def test_a_rule_that_stops_switching_is_an_answer():
    stays = limit_cycle(OPERATORS["1"], 0.15, 0.9)
    assert not stays.exists
    assert not stays.always
    assert "stays autonomous" in limit_cycle(OPERATORS["1"], -0.9, 0.1).reason
    assert np.isnan(stays.table().loc["r", "low"])
    assert len(stays.plot().lines) == 3, "without a cycle"
    plt.close("all")


def test_a_quick_operator_s_utilization_repeats_before_performance_does():
    """Dwell times alternate although r repeats to 1e-9 within a few cycles. Oracle: simulation."""
    model = made(
        (0.7770856095253732, 0.6176696259230177, 0.25891627050290766, 0.3081556230407075),
        (0.9980992372861659, 0.12043107813136816, 0.41828420499603064),
    )
    pair = 0.40749046230221386, 0.4255255879747638
    cycle = limit_cycle(model, *pair)
    run = settled(model, *pair, r0=0.6)
    assert run["r"].max() > 0.91
    assert cycle.r_high == approx(run["r"].max(), abs=1e-9)
    assert cycle.r_low == approx(run["r"].min(), abs=1e-9)
    assert cycle.dwell_manual == (4, 5)


def test_means_are_of_whole_periods():
    """Of its 17 cycles one is long: 300 cycles, some periods and a part, have another mean."""
    operator = 0.9773112082, 0.6590122170, 0.4711750365, 0.5134963447
    model = made(operator, (0.9977032962, 0.2709157444, 0.3449345707))
    pair = (-0.0473185, 0.0)
    motion = written_out(model, pair, 0.6, model.robot.p_min, 1)
    r, p_r = np.array([row[:2] for row in itertools.islice(motion, 30_000, 31_682)]).T
    assert r[:841] == approx(r[841:], abs=1e-9)
    cycle = limit_cycle(model, *pair)
    means = r[:841].mean(), p_r[:841].mean()
    assert (cycle.mean_r, cycle.mean_p_r) == approx(means, abs=1e-7)


def test_coexisting_motions_are_not_one():
    """From rest r is .745 to .755, from β .797 to .803; neither encloses β. Oracle: simulation."""
    model = made(
        (0.9931173542037335, 0.7667916440216367, 0.7135135891192641, 1.191955246242121),
        (0.745136609875909, 0.07233246624518448, 0.5811750650117329),
    )
    pair, human = (0.02376088811222299, 0.35270687220735775), model.human
    cycle = limit_cycle(model, *pair)
    rest, best = (
        settled(model, *pair, r0=r0, p_r0=p_r0)
        for r0, p_r0 in ((0.0, None), (human.beta, (pair[0] + model.b_T * human.p_max) / model.a_T))
    )
    assert rest["r"].max() < human.beta < best["r"].min()
    assert not cycle.encloses_beta
    assert "another motion" in cycle.reason
    assert (cycle.r_low, cycle.r_high) == approx((rest["r"].min(), best["r"].max()), abs=1e-6)
    assert cycle.mean_r == approx(best["r"].mean(), abs=1e-3)


def test_beta_is_enclosed_from_both_starts_or_not():
    """From β utilization encloses it for ever; from rest the mode stays autonomous."""
    operator = 0.9131666959659053, 0.40012977640063824, 0.3068925829445642, 0.42270031179191847
    model = made(operator, (0.9622789725948355, 0.2822559568792657, 0.5377885121888203))
    cycle = limit_cycle(model, -0.44122657620529815, 0.4952845370781124)
    assert cycle.r_low < model.human.beta < cycle.r_high
    assert not cycle.always
    assert not cycle.encloses_beta


def test_a_start_beyond_the_upper_threshold_is_autonomous_at_once():
    """Neither start switches, though others do."""
    model = made((0.8, 0.98, 0.3, 0.6), (0.99, 0.8, 1.2))
    assert settled(model, -0.03, 0.12)["mode"].nunique() == 1
    cycle = limit_cycle(model, -0.03, 0.12)
    assert not cycle.exists
    assert "stays autonomous" in cycle.reason


# --- many pairs -----------------------------------------------------------------------------------


def test_a_survey_has_the_motions_of_limit_cycle_and_a_quick_one_comes_near():
    pairs = [[0.0, 0.3], [-0.1, 0.2], [-3.0, 3.0]]
    models = [OPERATORS[name] for name in ("2", "3", "pilot")]
    exact, screened = survey(models, pairs), survey(models, pairs, SCREEN)
    cycles = [limit_cycle(tsc, *pair) for tsc, pair in itertools.product(models, pairs)]
    assert np.column_stack([exact["lower"], exact["upper"]]).tolist() == pairs * 3
    for rows, near in ((exact, 1e-3), (screened, 0.01)):
        assert rows["p_switches"].tolist() == [cycle.exists for cycle in cycles]
        for name in ("r_low", "mean_r", "mean_p_r"):
            assert_allclose(rows[name], [getattr(cycle, name) for cycle in cycles], atol=near)
    assert exact["p_encloses"].tolist() == [cycle.encloses_beta for cycle in cycles]


def test_a_survey_of_many_pairs_is_small(monkeypatch):
    """Of a posterior a fine grid has a million motions, 26 numbers each."""
    monkeypatch.setattr(steady, "steady_motion", lambda *_: np.ones((6, 3)))
    pairs = steady.grid_of_pairs(0.0, 0.1, 100)
    tracemalloc.start()
    survey([SECOND], pairs, SCREEN)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 900 * len(pairs)


# --- phases that never end ------------------------------------------------------------------------


def test_from_where_a_mode_stays_for_ever():
    rest, load = ends_of_tsc(SECOND)
    for off in (1e-6, 1e-9):
        assert endless_phase(SECOND, rest + off, load - off).startswith("the mode may stay")
        assert endless_phase(SECOND, rest + off, load + off).startswith("from full load")
        assert endless_phase(SECOND, rest - off, load - off).startswith("from rest")
    assert endless_phase(SECOND, rest, 0.2).startswith("from rest")
    assert endless_phase(SECOND, 0.0, load).startswith("from full load")
    assert endless_phase(SECOND, 0.7 * rest + 0.3 * load, 0.5 * (rest + load)) == ""


def test_rounding_widens_the_limits_of_a_slow_robot():
    """P_r stalls 1e-12/(1 − a) before its limit, 1e-9 for a = .999."""
    slow = made((0.998, 0.6, 0.3, 0.5), (0.999, 0.2, 0.4))
    rest, load = ends_of_tsc(slow)
    for off, stays in ((0.8e-9, True), (1.2e-9, False)):
        assert ("from rest" in endless_phase(slow, rest + off, 0.1)) == stays
        assert ("from full load" in endless_phase(slow, 0.1, load - off)) == stays
