"""
The CasADi program of the correction: against the clipped plan, closed forms, and with costs of
one's own.
"""

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose

import trustlab as tl
from tests.allocation.cases import SECOND, TARGET, corrector
from tests.cases import refused

approx = pytest.approx
parametrize = pytest.mark.parametrize

C_B = 1e-5
FAR = (0.5, 0.315, 0.02, 0.45, 1)
NEAR = (0.5, 0.315, TARGET[0] - 1.2e-4, TARGET[1] - 0.9e-4, 1)


def engine(horizon=30, c_b=C_B, **options):
    return corrector(c_b=c_b, horizon=horizon, engine="casadi", **options)


def clipped(horizon, state):
    return corrector(c_b=C_B, horizon=horizon).step(*state)


def test_without_a_cost_of_ones_own_it_comes_to_the_clipped_plan():
    ours, rng = engine(), np.random.default_rng(0)
    drawn = rng.uniform((0.3, 0.26), (0.9, 0.38), (12, 2)).tolist()
    for r, p_r in ((0.0, 0.24), (1.0, 0.24), *drawn):
        for state in ((r, p_r, *FAR[2:]), (r, p_r, *NEAR[2:])):
            plan = ours.step(*state)
            assert plan.status == "planned", plan.message
            assert plan.cost == approx(clipped(30, state).cost, rel=1e-9)
            assert np.isnan(plan.cost_lower_bound)


def test_the_solver_itself_comes_to_the_clipped_plan():
    """
    Not only as one of the plans it is compared with; least exactly in its last steps, on which the
    cost hardly depends.
    """
    for state in (FAR, NEAR):
        path = clipped(30, state).path
        corrections, reason = engine().program._solved(path)
        assert reason == ""
        assert_allclose(corrections, path[5:, :-1], atol=0.03 * C_B)


def test_a_rate_penalty_for_one_step_is_the_minimum_of_a_parabola():
    """N = 1: (z + c)² + λc² is least at −z/(1 + λ)."""
    off = 4e-6
    state = (0.5, 0.315, TARGET[0] + off, TARGET[1] + off, 1)
    plan = engine(1, extra_cost=lambda x, u, k: 3.0 * casadi.sumsqr(u)).step(*state)
    assert (plan.c_l, plan.c_u) == approx((-off / 4.0, -off / 4.0), rel=1e-4)
    base = sum((off + c) ** 2 + 3.0 * c**2 for c in (plan.c_l, plan.c_u))
    assert plan.cost == approx(base, rel=1e-6)
    assert "not proved optimal" in plan.message


def test_a_cost_may_use_the_step_and_functions_of_matrices():
    late = engine(12, extra_cost=lambda x, u, k: casadi.if_else(k < 6, 1e5, 0.0) * casadi.sumsqr(u))
    actions = late.step(*NEAR).table()["c_l"].abs()
    assert actions[:6].max() < 0.1 * actions[6:12].max()
    r = np.linspace(0.0, 1.0, 9)
    table = casadi.interpolant("table", "linear", [r], r**2)
    matrix = engine(12, extra_cost=lambda x, u, k: 1e-14 * table(x[0])).step(*NEAR)
    assert matrix.cost == approx(clipped(12, NEAR).cost, rel=1e-3)


def test_a_cost_of_utilization_is_judged_under_the_hard_switch():
    """No plan costs more than clipping."""
    ours = engine(60, 1e-3, extra_cost=lambda x, u, k: 0.1 * x[0] ** 2)

    def cost(path):
        base = ((path[2:4, 1:] - np.array(TARGET)[:, None]) ** 2).sum()
        return base + 0.1 * (path[0, :-1] ** 2).sum()

    for p_r in np.linspace(0.33, 0.38, 6):
        state = (0.7, float(p_r), 0.02, 0.45)
        plan = ours.step(*state, 1)
        assert plan.cost == approx(cost(plan.path), rel=1e-9)
        free = ours.followed(np.array(state), 1, ours._clipped)[2]
        assert plan.cost <= cost(free) * (1 + 1e-12)


@parametrize("engine", [None, "casadi"])
def test_own_incentives_bound_the_corrections(engine):
    def careful(r, p_r, c_b, p_min, p_max):
        return -0.1 * c_b * r, 0.2 * c_b * (1.0 - r)

    plan = corrector(c_b=C_B, horizon=30, incentive=careful, engine=engine).step(*FAR)
    table = plan.table().iloc[:-1]
    assert_allclose(table["c_u"], 0.2 * C_B * (1.0 - table["r"]), rtol=1e-6)


def test_a_state_from_which_a_step_never_returned_is_solved_or_held_in_time():
    def cost(x, u, k):
        return 0.1 * (x[0] - 0.6) ** 2 + 10.0 * casadi.sumsqr(u)

    ours = engine(60, 5e-4, model=SECOND, target=(0.05, 0.35), extra_cost=cost, limit=2.0)
    plan = ours.step(0.54657, 0.33080, 0.039193, 0.339193, 1)
    assert plan.status in ("planned", "held")


def test_the_solver_stops_where_its_time_is_over():
    ours = engine(60, limit=1e-6)
    ours.step(*FAR)
    assert ours.program._solver.stats()["return_status"] == "Maximum_WallTime_Exceeded"


class Fails(casadi.Callback):
    """A function of the user's that CasADi can differentiate, but not evaluate."""

    def __init__(self):
        casadi.Callback.__init__(self)
        self.construct("fails", {"enable_fd": True})

    def eval(self, values):
        raise ValueError("no such cost")


FAILS = Fails()


@parametrize(
    ("options", "words"),
    [
        ({"limit": 1e-6}, "longer than limit = 1e-06 s"),
        ({"extra_cost": lambda x, u, k: casadi.log(-x[0])}, "no plan has a finite cost"),
        ({"extra_cost": lambda x, u, k: FAILS(x[0])}, "no such cost"),
    ],
)
def test_without_a_plan_the_thresholds_are_held(options, words):
    plan = engine(60, **options).step(*FAR)
    assert (plan.status, plan.c_l, plan.c_u) == ("held", 0.0, 0.0)
    assert words in plan.message
    assert plan.table()["lower"][0] == FAR[2]


def test_a_solver_that_returns_nonsense_is_not_believed(monkeypatch):
    ours = engine(12)
    monkeypatch.setattr(ours.program, "_solved", lambda *_: (np.full((2, 12), 1.0), ""))
    assert ours.step(*NEAR).cost == clipped(12, NEAR).cost


@parametrize(
    ("cost", "words"),
    [
        (lambda x, u, k: casadi.MX.sym("own"), "its arguments alone"),
        (lambda x, u, k: u, "one number"),
    ],
)
def test_costs_that_cannot_be_used_are_refused(cost, words):
    with refused(words):
        engine(4, extra_cost=cost)


def test_no_plan_lets_the_thresholds_cross():
    """The target of the lower one lies above the upper one, which a cost holds back."""
    start, cost = (0.0, 0.1), {"extra_cost": lambda x, u, k: 1e4 * u[0] ** 2}
    ours = engine(10, 0.02, model=SECOND, target=(0.2, 0.35), limit=9.0, **cost)
    online = tl.OnlineCorrection(ours, start)
    for _ in range(30):
        step = online.update(0.3, 0.39)
        assert step.status == "planned", step.message
        assert online.lower < online.upper
        free = ours.followed(np.array([step.r, 0.3, step.lower, step.upper]), 1, ours._clipped)
        assert step.cost < 0.9 * ours.program._judged(free[0], free[2])[0]
    assert online.lower > start[1]
