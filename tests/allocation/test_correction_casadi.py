"""
The CasADi engine of the correction, its programs and what a user may add.

Oracles: the exact engine, whose optimum is proved and searched exhaustively in
`test_correction_exhaustive`; closed forms where corrections are limited by a constant; a grid for
one step; (2.41)-(2.44) written out.
"""

import casadi
import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation.correction.casadi_engine import CasadiEngine
from trustlab.allocation.correction.casadi_program import SOLVERS
from trustlab.allocation.correction.dynamics import simulate_correction
from trustlab.allocation.correction.exact import ExactEngine
from trustlab.allocation.correction.incentive import incentive_bounds, incentive_box
from trustlab.allocation.correction.plan import CorrectionStatus

ROBOT = tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.4602)
PILOT = tl.TscModel(ROBOT, tl.HumanModel(a=0.9991, beta=0.74, p_min=0.391, p_max=0.4602))
TARGET, C_B = (0.15, 0.56), 1e-5
FAR = (0.5, 0.315, 0.02, 0.45, 1)
NEAR = (0.5, 0.315, TARGET[0] + 4.3e-5, TARGET[1] - 6.1e-5, 1)


def engine(horizon=30, c_b=C_B, **options):
    return CasadiEngine(PILOT, *TARGET, c_b, horizon, **options)


def check(plan, state, c_b=C_B, bounds=incentive_bounds):
    """
    (2.44) from its own actions, (2.41)-(2.42) at its own states, thresholds in order and between
    start and target.
    """
    r, p_r, lower, upper, mode = state
    again = simulate_correction(
        PILOT, r, p_r, lower, upper, mode, plan.actions_l, plan.actions_u, TARGET
    )
    assert plan.cost == again["cost"]
    for name in ("r", "p_r", "lower", "upper", "mode"):
        np.testing.assert_array_equal(getattr(plan, name), again[name])
    least, most = bounds(plan.r[:-1], plan.p_r[:-1], c_b, PILOT)
    for actions in (plan.actions_l, plan.actions_u):
        assert (actions >= least - 1e-9 * c_b).all()
        assert (actions <= most + 1e-9 * c_b).all()
    assert (plan.lower < plan.upper).all()
    for path, start, target in ((plan.lower, lower, TARGET[0]), (plan.upper, upper, TARGET[1])):
        assert path.min() >= min(start, target) - 1e-15
        assert path.max() <= max(start, target) + 1e-15


@pytest.mark.parametrize("regime", ["saturated", "near"])
def test_both_engines_agree_along_a_noisy_closed_loop(regime):
    exact, ours = ExactEngine(PILOT, *TARGET, C_B, 200), engine(200)
    rng = np.random.default_rng(np.random.SeedSequence(3))
    r, p_r, lower, upper, mode = FAR if regime == "saturated" else NEAR
    limited = set()
    inside = 0
    switches = 0
    for _ in range(300):
        state = (r, p_r, lower, upper, mode)
        best, plan = exact.solve(*state), ours.solve(*state)
        assert plan.status is CorrectionStatus.CONVERGED
        assert abs(plan.cost - best.cost) <= 1e-6 * max(best.cost, C_B**2)
        assert abs(plan.c_l - best.c_l) <= 1e-3 * C_B
        assert abs(plan.c_u - best.c_u) <= 1e-3 * C_B
        check(plan, state)
        least, most = incentive_bounds(r, p_r, C_B, PILOT)
        at = [np.isclose(c, (least, most), atol=1e-10).any() for c in (best.c_l, best.c_u)]
        limited.add(tuple(at))
        inside += not all(at)
        switches += bool(np.any(np.diff(best.mode)))
        noise = rng.normal(size=4)
        r = float(np.clip(best.r[1] + 0.01 * noise[0], 0.0, 1.0))
        p_r = float(np.clip(best.p_r[1] + 0.003 * noise[1], ROBOT.p_min, ROBOT.p_max))
        lower = lower + best.c_l
        upper = upper + best.c_u
        mode = int(best.mode[0])
        if regime == "near":
            lower, upper = lower + C_B * noise[2], upper + C_B * noise[3]
    if regime == "near":
        assert len(limited) == 4, "the active set must move"
    else:
        assert inside == 0
        assert switches > 20, "switches must lie inside the horizon"


@pytest.mark.parametrize(("c_b", "horizon"), [(1e-5, 1), (1e-5, 2), (1e-4, 60), (1e-3, 12)])
def test_agrees_with_the_exact_engine_near_switches(c_b, horizon):
    exact, ours = ExactEngine(PILOT, *TARGET, c_b, horizon), engine(horizon, c_b)
    rng = np.random.default_rng(horizon)
    for i in range(24):
        r, p_r = rng.uniform(0.02, 0.98), rng.uniform(ROBOT.p_min, ROBOT.p_max)
        now = float(PILOT.value(p_r, PILOT.human.performance(r)))
        apart = abs(rng.normal()) * 5e-3
        lower, upper = (now - apart, now + 0.3) if i % 2 else (now - 0.3, now + apart)
        state = (r, p_r, lower, upper, int(rng.integers(2)))
        best, plan = exact.solve(*state), ours.solve(*state)
        check(plan, state, c_b)
        assert plan.cost <= best.cost * (1.0 + 1e-6) + 1e-6 * c_b**2
        assert plan.cost >= best.cost_lower_bound * (1.0 - 1e-9) - 1e-9 * c_b**2
        ours.reset()


def test_holding_a_threshold_back_for_a_switch_is_found():
    """
    Where clipping is not optimal, the search over switches finds the plan that the exact engine
    proves.
    """
    found = 0
    exact, ours = ExactEngine(PILOT, *TARGET, 1e-3, 40), engine(40, 1e-3)
    plain = engine(40, 1e-3)
    plain._moved_switches = lambda run: []
    rng = np.random.default_rng(3)
    for _ in range(60):
        r, p_r = rng.uniform(0.3, 0.9), rng.uniform(0.26, 0.37)
        now = float(PILOT.value(p_r, PILOT.human.performance(r)))
        state = (r, p_r, now - rng.uniform(0.0, 0.02), now + 0.4, 0)
        best, clipped = exact.solve(*state), plain.solve(*state)
        if clipped.cost > best.cost * (1.0 + 1e-6):
            found += ours.solve(*state).cost < clipped.cost
            check(ours.solve(*state), state, 1e-3)
    assert found >= 1


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_finds_the_same_plan(solver):
    best = ExactEngine(PILOT, *TARGET, C_B, 30)
    ours = engine(solver=solver)
    ours._programs = ours._programs[:1]
    for state in (FAR, NEAR):
        plan = ours.solve(*state)
        assert plan.status is CorrectionStatus.CONVERGED, plan.message
        assert plan.cost == pytest.approx(best.solve(*state).cost, rel=1e-6)
        assert np.isnan(plan.cost_lower_bound)


@pytest.mark.parametrize("solver", ["piqp", "fatrop"])
def test_a_constant_limit_below_the_incentive_is_met_exactly(solver):
    """
    Far from the target each correction is at the limit, so that the cost is a sum of squares known
    beforehand.
    """
    ours = engine(
        extra_constraints=lambda x, u, k: [u[0] - 3e-6, u[1] - 2e-6], switch_width=0, solver=solver
    )
    plan = ours.solve(*FAR)
    check(plan, FAR)
    np.testing.assert_allclose(plan.actions_u, 3e-6, rtol=1e-5)
    np.testing.assert_allclose(plan.actions_l, 2e-6, rtol=1e-5)


def test_a_limit_on_both_corrections_goes_to_the_threshold_farther_off():
    plan = engine(extra_constraints=lambda x, u, k: u[0] + u[1] - 4e-6, switch_width=0).solve(*FAR)
    check(plan, FAR)
    np.testing.assert_allclose(plan.actions_l, 4e-6, rtol=1e-5)
    np.testing.assert_allclose(plan.actions_u, 0.0, atol=1e-10)


def test_a_rate_penalty_for_one_step_is_the_minimum_of_a_parabola():
    """N = 1: (z + c)² + λc² is least at −z/(1 + λ)."""
    weight, off = 3.0, 4e-6
    state = (0.5, 0.315, TARGET[0] + off, TARGET[1] + off, 1)
    plan = engine(
        1, extra_cost=lambda x, u, k: weight * (u[0] ** 2 + u[1] ** 2), switch_width=0
    ).solve(*state)
    assert plan.c_l == pytest.approx(-off / (1.0 + weight), rel=1e-5)
    assert plan.c_u == pytest.approx(-off / (1.0 + weight), rel=1e-5)
    assert plan.cost_with_additions == pytest.approx(
        plan.cost + weight * (plan.c_l**2 + plan.c_u**2), rel=1e-9
    )


def test_a_rate_penalty_trades_cost_for_smaller_corrections():
    plain = engine(switch_width=0).solve(*NEAR)
    slow = engine(extra_cost=lambda x, u, k: 30.0 * casadi.sumsqr(u), switch_width=0).solve(*NEAR)
    check(slow, NEAR)
    assert np.sum(slow.actions_l**2 + slow.actions_u**2) < np.sum(
        plain.actions_l**2 + plain.actions_u**2
    )
    assert slow.cost > plain.cost


def test_a_cost_may_use_the_step_and_functions_of_matrices():
    table = casadi.interpolant(
        "table", "bspline", [np.linspace(0.0, 1.0, 9)], np.linspace(0.0, 1.0, 9) ** 2
    )
    late = engine(
        12,
        extra_cost=lambda x, u, k: casadi.if_else(k < 6, 1e3, 0.0) * casadi.sumsqr(u),
        switch_width=0,
    )
    plan = late.solve(*NEAR)
    assert np.abs(plan.actions_l[:6]).max() < 0.1 * np.abs(plan.actions_l[6:]).max()
    matrix = engine(12, extra_cost=lambda x, u, k: 1e-12 * table(x[0]), switch_width=0).solve(*NEAR)
    assert matrix.cost == pytest.approx(engine(12).solve(*NEAR).cost, rel=1e-6)


def test_own_incentives_bound_the_corrections():
    def careful(r, p_r, c_b, p_min, p_max):
        return -0.1 * c_b * r, 0.2 * c_b * (1.0 - r)

    plan = engine(incentive=careful).solve(*FAR)
    np.testing.assert_allclose(plan.actions_u, 0.2 * C_B * (1.0 - plan.r[:-1]), rtol=1e-6)
    check(plan, FAR, bounds=lambda r, p_r, c_b, model: careful(r, p_r, c_b, 0, 1))


@pytest.mark.parametrize("width", [3e-4, 1e-3, 3e-3])
def test_the_smoothed_switch_never_costs(width):
    """
    Its solution is only a guess of the modes; what comes back is at least as good as without it.
    """
    now = float(PILOT.value(0.3, PILOT.human.performance(0.5)))
    for state in (
        (0.5, 0.3, now - 0.4, now + 0.006, 1),
        (0.5, 0.3, now - 0.004, now + 0.4, 0),
        FAR,
        NEAR,
    ):
        hard, soft = (
            engine(c_b=1e-4).solve(*state),
            engine(c_b=1e-4, switch_width=width).solve(*state),
        )
        check(soft, state, 1e-4)
        assert soft.cost <= hard.cost * (1.0 + 1e-6)


def test_the_smoothed_switch_becomes_the_hard_one():
    """
    m(k) of the documented recursion, run outside the engine, against (2.8) as the width goes to 0.
    """
    run = tl.simulate_allocation(PILOT, 0.02, 0.45, 4000, r0=0.5)
    tsc, apart = run["tsc"].to_numpy(), []
    for width in (1e-3, 1e-5, 1e-7):
        m, memory = [], 1.0
        for value in tsc:
            up, down = (
                1.0 / (1.0 + np.exp(np.clip(-y / width, -700, 700)))
                for y in (value - 0.45, 0.02 - value)
            )
            memory = (1.0 - up) * (down + (1.0 - down) * memory)
            m.append(memory)
        apart.append(np.abs(np.array(m) - run["mode"]).mean())
    assert apart[0] > apart[1] > apart[2]
    assert apart[2] < 1e-3


@pytest.mark.parametrize("constraint", [lambda x, u, k: 1.0 - u[0], lambda x, u, k: 2e-5 - u[0]])
def test_where_no_solver_succeeds_the_thresholds_are_held(constraint):
    plan = engine(8, extra_constraints=constraint, switch_width=0).solve(*FAR)
    assert plan.status is CorrectionStatus.FAILED
    assert plan.status.held
    assert plan.message
    assert (plan.c_l, plan.c_u) == (0.0, 0.0)
    assert (plan.actions_l == 0.0).all()
    assert (plan.lower == FAR[2]).all()
    check(plan, FAR)


def test_a_solver_that_returns_nonsense_is_not_believed(monkeypatch):
    """The guards: a solution far from the optimum, and a plan that leaves (2.41)."""
    ours = engine(12)
    for program in ours._programs:
        monkeypatch.setattr(
            program, "solve", lambda guess, mode, thresholds=None: (np.full((2, 12), 0.5), "")
        )
    plan = ours.solve(*FAR)
    assert plan.status is CorrectionStatus.FAILED
    assert "costs more than the guess" in plan.message

    ours = engine(12)
    hard_run = ours._model.run

    def too_far(state, w, allowed):
        run = hard_run(state, w, allowed)
        run.inputs[:] = 2.0 * C_B
        return run

    monkeypatch.setattr(ours._model, "run", too_far)
    plan = ours.solve(*FAR)
    assert plan.status is CorrectionStatus.FAILED
    assert "does not reproduce" in plan.message
    assert plan.c_l == 0.0


def test_incentives_that_exclude_holding_at_a_predicted_state_hold_the_thresholds():
    def late(r, p_r, c_b, p_min, p_max):
        return casadi.if_else(r > 0.95, 0.1, -0.1) * c_b, 0.5 * c_b

    plan = engine(8, incentive=late).solve(0.97, 0.3, 0.02, 0.45, 1)
    assert plan.status is CorrectionStatus.FAILED
    assert "incentives that exclude 0" in plan.message


def test_at_rest_and_at_full_load_the_plan_is_finite():
    for r in (0.0, 1.0):
        plan = engine().solve(r, ROBOT.p_min, 0.02, 0.45, 1)
        assert plan.status is CorrectionStatus.CONVERGED, plan.message
        check(plan, (r, ROBOT.p_min, 0.02, 0.45, 1))


def test_the_last_plan_is_only_where_the_next_one_starts():
    ours, fresh = engine(), engine()
    ours.solve(*NEAR)
    np.testing.assert_allclose(
        ours.solve(*FAR).actions_l, fresh.solve(*FAR).actions_l, atol=1e-6 * C_B
    )
    ours.reset()
    np.testing.assert_array_equal(ours.solve(*NEAR).actions_l, engine().solve(*NEAR).actions_l)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"solver": "qrqp"}, "'piqp', 'hpipm', 'fatrop', 'ipopt'"),
        ({"solver": None, "switch_width": -1e-3}, "switch_width"),
        ({"switch_width": np.nan}, "finite"),
        ({"switch_width": "wide"}, "number"),
        ({"extra_cost": 3.0}, "function"),
        ({"extra_constraints": [1]}, "function"),
        ({"incentive": None}, "function"),
        ({"extra_cost": lambda x, u, k: u}, "scalar"),
        ({"extra_cost": lambda x, u, k: None}, "expression"),
        ({"extra_cost": lambda x, u, k: "u"}, "expression"),
        ({"extra_cost": lambda x, u: 0.0}, "could not be called"),
        ({"extra_cost": lambda x, u, k: 1.0 if x[0] > 0 else 0.0}, "if_else"),
        ({"extra_cost": lambda x, u, k: casadi.SX.sym("free") * u[0]}, "arguments alone"),
        ({"extra_cost": lambda x, u, k: casadi.log(-x[0])}, "finite"),
        ({"extra_cost": lambda x, u, k: np.nan}, "finite"),
        ({"extra_constraints": lambda x, u, k: []}, "nothing"),
        ({"extra_constraints": lambda x, u, k: [None]}, "expression"),
        ({"incentive": lambda r, p_r, c_b, low, high: c_b}, "two values"),
        ({"incentive": lambda r, p_r, c_b, low, high: (0.1 * c_b, c_b)}, "held"),
        ({"incentive": lambda r, p_r, c_b, low, high: (-c_b, 2.0 * c_b)}, "c_b"),
    ],
)
def test_options_that_cannot_be_used_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        engine(4, **options)


def test_through_the_corrector():
    with pytest.warns(tl.allocation.TargetWarning):
        corrector = tl.ThresholdCorrector(
            PILOT, TARGET, horizon=20, engine="casadi", incentive=incentive_box
        )
    step = corrector.step(r=0.5, p_r=0.315, lower=0.02, upper=0.45, mode=1)
    assert step.engine == "casadi"
    assert step.status is CorrectionStatus.CONVERGED
    assert step.solve_time > 0.0
    assert step.table().shape == (21, 7)
    with pytest.raises(ValueError, match="extra_cost"), pytest.warns(tl.allocation.TargetWarning):
        tl.ThresholdCorrector(PILOT, TARGET, engine="casadi", rate=1.0)
