"""
Appendix A: cost against an independent integration of its printed equations, minimum against a fine
grid and CasADi.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from trustlab.allocation.blending import OptimalBlending

ZERO = np.zeros(3)


def situation(seed):
    rng = np.random.default_rng([61, seed])
    sizes = (0.3, 0.3, 1.0, 0.5, 0.5)
    return [rng.normal(0.0, 10 ** rng.uniform(-1, 0.5) * size, 3) for size in sizes]


def cost(blending, alpha, now):
    """The cost that `step` minimizes, of an α that is held."""
    states = np.column_stack(now)
    series = np.einsum("ai,maij,aj->m", states, blending.weights, states)
    return np.polynomial.polynomial.polyval(2.0 * alpha - 1.0, series)


def printed_cost(alpha, u_h, u_a, e, rate, acceleration):
    """(A.3) along the fourteen printed equations, α given as a function of time."""

    def change(t, x):
        u = alpha(t)
        d = np.zeros(15)
        d[3] = 0.5 * x[9] + 0.02 * x[12]
        d[4] = 0.5 * x[10] + 0.02 * x[13]
        d[5] = 1.5 * x[11]
        d[6] = x[9]
        d[7] = x[10]
        d[8] = x[11]
        d[9], d[10] = x[12], x[13]
        d[11] = -0.495 * x[11] - 0.985 * (x[2] * u + x[5] * (1 - u))
        d[12] = -1.473 * x[12] - 0.2214 * x[9] - 9.22 * (x[0] * u + x[3] * (1 - u))
        d[13] = -0.4706 * x[13] - 2.457 * x[10] - 3.806 * (x[1] * u + x[4] * (1 - u))
        d[14] = 200.0 * (x[6:9] @ x[6:9]) + (1 - u) ** 2 * np.sum((x[:3] - x[3:6]) ** 2)
        return d

    start = np.r_[u_h, u_a, e, rate, acceleration[:2], 0.0]
    return solve_ivp(change, (0.0, 0.2), start, rtol=1e-11, atol=1e-13, max_step=0.01).y[-1, -1]


@pytest.mark.parametrize("seed", range(8))
def test_cost_is_that_of_the_printed_equations(seed):
    now = situation(seed)
    for alpha in (0.0, 0.2, 0.63, 1.0):
        expected = printed_cost(lambda t, alpha=alpha: alpha, *now)
        assert cost(OptimalBlending(), alpha, now) == pytest.approx(expected, rel=1e-8)


@settings(max_examples=40)
@given(st.integers(0, 100_000), st.floats(0.0, 0.8))
def test_share_is_the_global_minimum(seed, low):
    blending, now = OptimalBlending(alpha_min=low), situation(seed)
    alpha = blending.step(*now)
    assert low <= alpha <= 1.0
    grid = [cost(blending, alpha, now) for alpha in np.linspace(low, 1.0, 301)]
    assert cost(blending, alpha, now) <= min(grid) * (1 + 1e-12)


def test_without_an_error_the_operator_drives():
    """The horizon is so short that no command leads to one."""
    now = (np.array([0.2, -0.1, 0.3]), ZERO, ZERO, ZERO, ZERO)
    assert OptimalBlending(horizon=1e-3).step(*now) == pytest.approx(1.0, abs=1e-6)


def test_the_better_command_gets_the_authority():
    # an error to the right: the controller steers towards it, the operator away, and the reverse
    e, right = np.array([2.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    assert OptimalBlending().step(-right, right, e, ZERO, ZERO) < 1.0
    assert OptimalBlending(horizon=1.0).step(-right, right, e, ZERO, ZERO) == 0.2
    assert OptimalBlending().step(right, -right, e, ZERO, ZERO) == 1.0
