"""
The operator's budget (4.30): the share of a push is the greatest whose power is within what is
free.
"""

import numpy as np
from hypothesis import given, settings, strategies as st

from trustlab.teleoperation.team.kernel import push_share


@given(st.integers(0, 100_000))
@settings(max_examples=300)
def test_power_of_the_hand(seed):
    """Oracle: r (σ p − d r) with r = a + y σ p, axis by axis."""
    rng = np.random.default_rng(seed)
    a, p = 10 ** rng.uniform(-2, 1, 2)[:, None] * rng.normal(size=(2, 3))
    drag = 10 ** rng.uniform(-2, 1)
    y = rng.uniform(0.01, 0.99, 3) / drag
    power = 10 ** rng.uniform(-3, 1) * rng.choice([-1, 1, 1, 1])
    pull = float((p * a * (1 - 2 * drag * y)).sum())
    stir = float((y * p**2 * (1 - drag * y)).sum())
    share = push_share(1.0, power, pull, stir, float((a**2).sum()), drag)

    def given_out(sigma):
        r = a + y * sigma * p
        return float((r * (sigma * p - drag * r)).sum())

    assert 0.0 <= share <= 1.0
    if power <= 0.0:
        assert share == 0.0
    else:
        slack = 1e-9 * (abs(power) + drag * float((a**2).sum()) + stir + abs(pull))
        assert given_out(share) <= power + slack
        if share < 1.0:
            assert given_out(share) >= power - slack  # no less than may be
            assert given_out(min(1.01 * share + 1e-3, 1.0)) > power - slack
    assert push_share(0.0, power, pull, stir, 1.0, drag) == 0.0
