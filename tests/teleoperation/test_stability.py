"""
Whether a run was stable, from its log. Oracles: the ports' energies that the loop books by itself,
and signals whose energy is known.
"""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl

SIGNALS = [f"{name}_x" for name in ("r_m", "f_m", "r_s", "f_s")]


def session(columns, T=0.01):
    t = pd.Index(T * np.arange(len(columns)), name="t")
    return tl.Session(pd.DataFrame(columns, index=t, columns=SIGNALS))


@pytest.mark.parametrize("guidance", ["at_operator", "through_channel"])
def test_energies_are_those_of_the_loops_own_books(guidance):
    run = tl.simulate_teleoperation("TMIG", seed=2, duration=30.0, guidance=guidance)
    answer = tl.passivity(run)
    np.testing.assert_allclose(answer.energies["operator"], run["energy_port"], atol=1e-9)
    np.testing.assert_allclose(answer.energies["robot"], run["energy_robot"], atol=1e-9)
    assert answer.passive
    assert answer.bounded
    assert (answer.least_energy >= -1e-9).all()
    assert answer.message.startswith("Passive: neither port")
    table = answer.table().set_index("port")
    assert table["final_energy"].tolist() == answer.energies.iloc[-1].tolist()


def test_without_its_guard_the_printed_guidance_is_not_passive():
    printed = tl.teleoperation.Guidance("through_channel", "off")
    run = tl.simulate_teleoperation("M", seed=1, duration=30.0, guidance=printed)
    answer = tl.passivity(run)
    assert not answer.passive
    assert answer.least_energy["robot"] < -1.0
    assert "the robot's port had given out" in answer.message


def test_energy_of_a_damper_and_of_a_motor():
    """A damper of 2 N s/m at 3 m/s takes 18 W; a motor that pushes with as much gives it out."""
    T, count = 0.01, 300
    damper = tl.passivity(session(np.tile([3.0, 6.0, 0.0, 0.0], (count, 1)), T))
    assert damper.energies["operator"].iloc[-1] == pytest.approx(18.0 * T * count)
    assert damper.passive
    motor = tl.passivity(session(np.tile([3.0, -6.0, 0.0, 0.0], (count, 1)), T))
    assert not motor.passive
    assert motor.least_energy["operator"] == pytest.approx(-18.0 * T * count)
    assert motor.bounded


def test_what_grows_is_not_bounded():
    growing = np.exp(0.05 * np.arange(300))
    answer = tl.passivity(session(np.column_stack([growing, growing, growing, growing])))
    assert not answer.bounded
    assert answer.growth == pytest.approx(np.exp(5.0))
    assert "grew 148-fold in the last third" in answer.message
    steady = np.sin(0.3 * np.arange(300))
    assert tl.passivity(session(np.column_stack([steady] * 4))).bounded


def test_nothing_moves():
    answer = tl.passivity(session(np.zeros((30, 4))))
    assert answer.passive
    assert answer.bounded


def test_a_plot_shows_the_energies():
    run = tl.simulate_teleoperation("M", seed=1, duration=10.0)
    answer = tl.passivity(run)
    axes = answer.plot()
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), answer.energies["operator"])


def test_a_session_without_the_signals_is_refused():
    run = tl.simulate_teleoperation("M", seed=1, duration=5.0)
    thin = tl.Session(run.data.drop(columns=["f_s_y"]), run.metadata)
    with pytest.raises(tl.SessionError, match="f_s_y"):
        tl.passivity(thin)
    with pytest.raises(tl.SessionError, match="r_m_x"):
        tl.passivity(tl.Session(run.data[["path_error"]], run.metadata))
    with pytest.raises(ValueError, match="session must be of class Session"):
        tl.passivity(run.data)
