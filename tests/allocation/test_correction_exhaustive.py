"""
The clipped plan and its certificate against an exhaustive search: every sequence of modes, each a
quadratic programme of its own.

The oracle knows nothing of the plan: it writes (2.44), (2.41)-(2.42), the order of the thresholds
and the conditions of (2.8) as linear constraints for each of the 2^(N−1) sequences and solves for
both thresholds at once with CasADi's qrqp.
"""

import itertools
import math

import casadi
import numpy as np
import pytest

from tests.allocation.cases import drawn_model
from tests.cases import curve
from trustlab.allocation.correction import follow


def instance(rng):
    """A model and a state near a switch, with corrections as fast as TSC, in any direction."""
    spans = (0.05, 0.5), (0.2, 1.0)
    tsc = drawn_model(rng, (-2.5, -0.5), (-2.0, -0.5), (0.3, 0.9), spans)
    r = rng.uniform(0.05, 0.95)
    p_r = rng.uniform(tsc.robot.p_min, tsc.robot.p_max)
    mode = int(rng.integers(2))
    now = float(tsc.value(p_r, tsc.human.performance(r)))
    after = tsc.simulate(np.full(4, mode), r, p_r)["tsc"].to_numpy()
    pace = abs(after[3] - after[0]) / 3 + 1e-4
    c_b = pace * 10 ** rng.uniform(-0.7, 0.5)
    first = now + (1 if mode else -1) * pace * rng.uniform(0.2, 4)
    width = pace * 10 ** rng.uniform(-0.3, 1.5)
    lower, upper = (first - width, first) if mode else (first, first + width)
    targets = sorted((lower + c_b * rng.normal(0, 5), upper + c_b * rng.normal(0, 5)))
    return tsc, r, p_r, lower, upper, mode, *targets, c_b


def exhaustive(case, n):
    """
    Least cost over all sequences of modes, inequalities closed; and how many sequences are
    possible.
    """
    tsc, r0, p0, l0, u0, before, *target, c_b = case
    robot, human = tsc.robot, tsc.human
    value = tsc.a_T * p0 - tsc.b_T * curve(human, r0)
    first = 0 if value >= u0 else 1 if value <= l0 else before
    best, possible = math.inf, 0
    # Rows: the lower and the upper threshold.
    start, target = np.array([[l0], [u0]]), np.array(target)[:, None]
    step = np.eye(n + 1)[1:] - np.eye(n + 1)[:-1]
    A = np.vstack([np.kron(np.eye(2), step), np.kron([-1.0, 1.0], np.eye(n + 1))])
    square, quiet = casadi.Sparsity.diag(2 * (n + 1)), ("iter", "header", "info")
    solver = casadi.conic(
        "oracle",
        "qrqp",
        {"h": square, "a": casadi.Sparsity.dense(*A.shape)},
        {"error_on_fail": False} | {f"print_{what}": False for what in quiet},
    )
    for rest in itertools.product((0, 1), repeat=n - 1):
        modes = (first, *rest)
        r, p = [r0], [p0]
        for m in modes:
            p.append(
                robot.a * p[-1] + (1 - robot.a) * robot.p_min + m * robot.b * curve(human, r[-1])
            )
            r.append(human.a * r[-1] + (1 - human.a) * m)
        share = (np.array(p) - robot.p_min) / (robot.p_max - robot.p_min)
        high = np.maximum(0.5 * (2 - np.array(r) - share), 0)[:n] * c_b
        low = np.minimum(-0.5 * (np.array(r) + share), 0)[:n] * c_b
        least = np.repeat(np.minimum(start, target), n + 1, axis=1)
        most = np.repeat(np.maximum(start, target), n + 1, axis=1)
        least[:, :1] = most[:, :1] = start
        for k in range(1, n):
            value = tsc.a_T * p[k] - tsc.b_T * curve(human, r[k])
            side = modes[k - 1]  # alone TSC waits for the lower one, under manual control the upper
            if modes[k] == 0:
                most[side, k] = min(most[side, k], value)
            else:
                least[side, k] = max(least[side, k], value)
        if (least > most).any():
            continue
        # Both thresholds in units of c_b about their targets.
        apart = np.full(n + 1, target[0] - target[1])
        found = solver(
            h=casadi.DM(square, 2.0),
            a=A,
            lba=np.r_[low, low, apart] / c_b,
            uba=np.r_[high, high, np.full(n + 1, np.inf)] / c_b,
            lbx=np.ravel(least - target) / c_b,
            ubx=np.ravel(most - target) / c_b,
        )
        if not solver.stats()["success"]:
            continue
        possible += 1
        best = min(best, float(found["cost"]) * c_b**2 - ((start - target) ** 2).sum())
    return best, possible


def planned(case, n):
    """Cost and bound of the clipped plan."""
    tsc, *state, mode, lower, upper, c_b = case
    path = np.empty((7, n + 1))
    path[:4, 0] = state
    start, target = np.array(state[2:]), np.array([lower, upper])
    return follow(tsc.constants(), c_b, target, start, mode, np.full((2, n), np.nan), path)


@pytest.mark.parametrize("longest", [8, pytest.param(12, marks=pytest.mark.long)])
def test_what_is_called_optimal_is_unbeaten_and_no_plan_costs_less_than_the_bound(longest):
    """And where holding a threshold back brings about a switch that pays, the gap says so."""
    rng, sizes = np.random.default_rng(12), itertools.cycle((4, 6, 8, 10, longest))
    proved = chosen = beaten = 0
    while beaten < 12:
        case, n = instance(rng), next(sizes)
        cost, bound = planned(case, n)
        if bound == cost and proved == 80:
            continue
        best, possible = exhaustive(case, n)
        rounding = 1e-7 * max(best, case[-1] ** 2)
        assert bound <= best + rounding
        assert best <= cost + rounding
        if bound == cost:
            proved += 1
            assert abs(cost - best) <= rounding, (n, case)
        chosen += possible > 1
        beaten += cost > best * (1 + 1e-6)
    assert proved >= 60
    assert chosen >= 40
