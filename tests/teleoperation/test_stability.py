"""
Whether a run was stable, from its log. Oracles: the ports' energies that the loop books by itself,
and signals whose energy is known.
"""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl

SIGNALS = [f"{name}_x" for name in ("r_m", "f_m", "r_s", "f_s")]


def session(columns):
    t = pd.Index(0.01 * np.arange(len(columns)), name="t")
    return tl.Session(pd.DataFrame(columns, index=t, columns=SIGNALS))


@pytest.mark.parametrize("guidance", ["at_operator", "through_channel"])
def test_energies_are_those_of_the_loops_own_books(guidance):
    run = tl.simulate_teleoperation("TMIG", seed=2, duration=30.0, guidance=guidance)
    answer = tl.passivity(run)
    for port, column in (("operator", "energy_port"), ("robot", "energy_robot")):
        np.testing.assert_allclose(answer.energies[port], run[column], atol=1e-9)
    assert answer.passive
    assert answer.bounded
    assert (answer.least_energy >= -1e-9).all()
    assert answer.message.startswith("Passive: neither port")
    final = answer.table().set_index("port")["final_energy"]
    assert final.tolist() == answer.energies.iloc[-1].tolist()
    drawn = answer.plot().lines[0].get_ydata()
    np.testing.assert_array_equal(drawn, answer.energies["operator"])


def test_without_its_guard_the_printed_guidance_is_not_passive():
    printed = tl.teleoperation.Guidance("through_channel", "off")
    run = tl.simulate_teleoperation("M", seed=1, duration=30.0, guidance=printed)
    answer = tl.passivity(run)
    assert not answer.passive
    assert answer.least_energy["robot"] < -1.0
    assert "the robot's port had given out" in answer.message


@pytest.mark.parametrize("force", [6.0, -6.0, 0.0])
def test_energy_of_a_damper_and_of_a_motor(force):
    """A damper of 2 N s/m at 3 m/s takes 18 W; a motor that pushes with as much gives it out."""
    answer = tl.passivity(session(np.tile([3.0, force, 0.0, 0.0], (300, 1))))
    energies = 3.0 * force * 0.01 * np.arange(1, 301)
    np.testing.assert_allclose(answer.energies["operator"], energies)
    assert answer.least_energy["operator"] == pytest.approx(min(energies.min(), 0.0))
    assert answer.passive == (force >= 0.0)
    assert answer.bounded


def test_what_grows_is_not_bounded():
    growing = np.exp(0.05 * np.arange(300))
    answer = tl.passivity(session(np.column_stack([growing, growing, growing, growing])))
    assert not answer.bounded
    assert answer.growth == pytest.approx(np.exp(5.0))
    assert "grew 148-fold in the last third" in answer.message
    steady = np.sin(0.3 * np.arange(300))
    assert tl.passivity(session(np.column_stack([steady] * 4))).bounded
