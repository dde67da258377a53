"""
Appendix A: cost against an independent integration of its printed equations, minimum against a fine
grid and CasADi.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from trustlab.allocation.blending import OptimalBlending


def situation(seed):
    rng = np.random.default_rng([61, seed])
    sizes = (0.3, 0.3, 1.0, 0.5, 0.5)
    return [rng.normal(0.0, 10 ** rng.uniform(-1, 0.5) * size, 3) for size in sizes]


def cost(blending, alpha, now):
    """The cost that `step` minimizes, of an α that is held."""
    states = np.column_stack(now)
    series = np.einsum("ai,maij,aj->m", states, blending.weights, states)
    return np.polynomial.polynomial.polyval(2.0 * alpha - 1.0, series)


def printed_cost(horizon, share, now):
    """(A.3) along the printed equations, of a share that is held."""
    p, d = np.array([(0.5, 0.5, 1.5), (0.02, 0.02, 0.0)])

    def change(t, x):
        u_h, u_a, e, v, a = x[:15].reshape(5, 3)
        drive = share * u_h + (1 - share) * u_a
        a = np.array([*a[:2], -0.495 * v[2] - 0.985 * drive[2]])  # z is of order one
        jerk = -np.array([1.473, 0.4706, 0.0]) * a - np.array([0.2214, 2.457, 0.0]) * v
        jerk -= np.array([9.22, 3.806, 0.0]) * drive
        rate = 200.0 * (e @ e) + (1 - share) ** 2 * np.sum((u_h - u_a) ** 2)
        return np.r_[np.zeros(3), p * v + d * a, v, a, jerk, rate]

    start = np.r_[np.ravel(now), 0.0]
    return solve_ivp(change, (0.0, horizon), start, rtol=1e-11, atol=1e-13, max_step=0.01).y[-1, -1]


@pytest.mark.parametrize("horizon", [0.1, 0.2])
def test_cost_is_that_of_the_printed_equations(horizon):
    blending = OptimalBlending(horizon=horizon)
    for seed in range(4):
        now = situation(seed)
        for alpha in (0.0, 0.2, 0.63, 1.0):
            expected = printed_cost(horizon, alpha, now)
            assert cost(blending, alpha, now) == pytest.approx(expected, rel=1e-8)


@settings(max_examples=40)
@given(st.integers(0, 100_000), st.floats(0.0, 0.8))
def test_share_is_the_global_minimum(seed, low):
    blending, now = OptimalBlending(alpha_min=low), situation(seed)
    alpha = blending.step(*now)
    assert low <= alpha <= 1.0
    grid = [cost(blending, alpha, now) for alpha in np.linspace(low, 1.0, 301)]
    assert cost(blending, alpha, now) <= min(grid) * (1 + 1e-12)
