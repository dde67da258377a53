"""
Passivity controllers, the energies of a session, and the share of a leader's push.

Oracles: energy balances of the logged signals; sessions that were made passive and not.
"""

import networkx as nx
import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings, strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize_scalar

import trustlab as tl
from tests.cases import refused
from trustlab.teleoperation import PassivityController, passivity
from trustlab.teleoperation.ports import activation
from trustlab.teleoperation.team.kernel import push_share

# --- controllers ----------------------------------------------------------------------------------


T = 0.01


@given(st.integers(0, 10_000))
def test_controllers_keep_energy_above_one_sample_or_zero_and_book_it(seed):
    rng = np.random.default_rng([41, seed])
    v = np.repeat(rng.normal(size=(80, 3)), 5, axis=0) * 10 ** rng.uniform(-2, 1)
    f = rng.normal(size=v.shape) - rng.uniform(-1, 1) * v
    power = (v * f).sum(axis=1)
    overdrawn = T * np.abs(np.minimum(power, 0.0)).max() + 1e-12
    for method, least in (("cancel", overdrawn), ("repay", 1e-12 * T * np.abs(v * f).sum())):
        controller = PassivityController(T, method)
        steps = [controller.step(*sample) for sample in zip(v, f, strict=True)]
        force, _, energy, deficit = map(np.array, zip(*steps, strict=True))
        assert energy.min() >= -least
        assert_allclose(energy, T * np.cumsum((v * force).sum(axis=1)), atol=1e-9)
        assert_array_equal(deficit, np.maximum(-energy, 0.0))
        if method == "cancel":  # never raises the force
            size = np.linalg.norm(f, axis=1)
            assert (np.linalg.norm(force, axis=1) <= size * (1 + 1e-12)).all()


@given(st.floats(-5, 5), st.floats(0.01, 50), st.floats(-2, 3))
@example(-1.0, 0.5, 0.0)
def test_damping_of_a_yielding_port_takes_the_power_demanded(power, gain, demand):
    w = activation(power, gain, demand)
    size = 1.0 + abs(power) + gain
    assert w >= 0.0

    def taken(w):
        return ((1 + w) * power + w * gain) / (1 + w) ** 2

    if np.isinf(w):
        assert power + gain <= 0.0
    elif taken(w) >= demand - 1e-9 * size:
        if w > 0.0:
            assert taken(w) <= demand + 1e-9 * size
            assert all(taken(share * w) <= demand + 1e-9 for share in (0.0, 0.3, 0.9))
    else:
        best = minimize_scalar(lambda x: -taken(np.exp(x)), bounds=(-20, 20), method="bounded")
        most = max(-best.fun, taken(0.0))
        assert most <= demand + 1e-9
        assert taken(w) >= most - 1e-6 * size


@pytest.mark.parametrize("method", ["cancel", "repay"])
def test_a_port_that_stands_still_is_not_damped(method):
    controller = PassivityController(T, method)
    controller.step([1.0], [-1.0])
    done = controller.step([0.0], [-3.0])
    assert (done.force.tolist(), done.z, controller.energy) == ([-3.0], 0.0, done.energy)


# --- is a session stable? -------------------------------------------------------------------------


SIGNALS = [f"{name}_x" for name in ("r_m", "f_m", "r_s", "f_s")]


def session(columns):
    t = pd.Index(0.01 * np.arange(len(columns)), name="t")
    return tl.Session(pd.DataFrame(columns, index=t, columns=SIGNALS))


def test_energies_are_those_of_the_loops_own_books():
    run = tl.simulate_teleoperation("TMIG", seed=2, duration=30.0)
    answer = passivity(run)
    for port, column in (("operator", "energy_port"), ("robot", "energy_robot")):
        assert_allclose(answer.energies[port], run[column], atol=1e-9)
    assert answer.passive
    assert answer.bounded
    assert (answer.least_energy >= -1e-9).all()
    assert answer.message.startswith("Passive: neither port")
    final = answer.table().set_index("port")["final_energy"]
    assert final.tolist() == answer.energies.iloc[-1].tolist()


@pytest.mark.parametrize("force", [6.0, -6.0, 0.0])
def test_energy_of_a_damper_and_of_a_motor(force):
    """A damper of 2 N s/m at 3 m/s takes 18 W; a motor that pushes with as much gives it out."""
    answer = passivity(session(np.tile([3.0, force, 0.0, 0.0], (300, 1))))
    energies = 3.0 * force * 0.01 * np.arange(1, 301)
    assert_allclose(answer.energies["operator"], energies)
    assert answer.least_energy["operator"] == pytest.approx(min(energies.min(), 0.0))
    assert answer.passive == (force >= 0.0)
    assert ("the operator's port had given out 54 J" in answer.message) == (force < 0.0)


def test_what_grows_is_not_bounded():
    k = np.arange(300)
    growing, steady, late = (
        passivity(session(np.column_stack([signal] * 4)))
        # of the last nothing is there before the last third
        for signal in (np.exp(0.05 * k), np.sin(0.3 * k), np.where(k < 250, 0.0, 1e9))
    )
    assert (growing.bounded, steady.bounded, late.bounded) == (False, True, False)
    assert growing.growth == pytest.approx(np.exp(5.0))
    assert "grew 148-fold in the last third" in growing.message
    assert "began in the last third of the run" in late.message


def test_a_team_has_a_criterion_of_its_own():
    """Its leader hands energy on to other robots, which was called not passive."""
    team = tl.simulate_team(nx.path_graph(2), duration=1.0)
    with refused(r"see TeamRun\.operator_passive"):
        passivity(team.session)


# --- a leader's push ------------------------------------------------------------------------------


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
    assert push_share(0.0, power, pull, stir, 1.0, drag) == 0.0
