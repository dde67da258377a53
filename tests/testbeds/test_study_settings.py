"""
A study is the same by name and as settings; each trust model has its own ranges; columns are in the
models' units.
"""

from dataclasses import replace

import numpy as np
import pytest

import trustlab as tl
from trustlab.models.trust import TrustModel
from trustlab.teleoperation import STUDIES
from trustlab.teleoperation.loop.settings import LoopSettings


@pytest.mark.parametrize("study", STUDIES)
def test_settings_fly_the_task_delays_and_reach_of_their_study(study):
    by_name = tl.simulate_teleoperation("M", study=study, seed=5, duration=20.0)
    assert tl.simulate_teleoperation("M", study=STUDIES[study], seed=5, duration=20.0) == by_name
    changed = replace(STUDIES[study], window=9.0, title="window of 9 s")
    data = tl.simulate_teleoperation("M", study=changed, seed=5, duration=20.0).data
    np.testing.assert_array_equal(data["reference_x"], by_name.data["reference_x"])


SETTINGS = replace(
    STUDIES["main"],
    human_to_robot=TrustModel(0.3, 0.2, t_min=0.0, t_max=2.0, p_min=0.2, p_max=0.9),
    robot_to_human=TrustModel(0.1, 0.1, t_min=-1.0, t_max=1.0, p_min=0.1, p_max=0.6),
)


def test_each_trust_follows_its_own_model_in_its_own_units():
    assert isinstance(SETTINGS, LoopSettings)
    data = tl.simulate_teleoperation("TMIG", study=SETTINGS, seed=5, duration=60.0).data
    for model, measure, column in (
        (SETTINGS.human_to_robot, "p_r", "trust_hr"),
        (SETTINGS.robot_to_human, "p_h", "trust_rh"),
    ):
        performance = data[measure].clip(model.p_min, model.p_max).to_numpy()
        expected = model.simulate(performance, 0.01, 0.5 * (model.t_min + model.t_max))
        np.testing.assert_allclose(data[column], expected, atol=1e-9)
    alpha, beta = SETTINGS.scalings()
    np.testing.assert_allclose(data["alpha"], alpha.value(data["trust_hr"].to_numpy()), atol=1e-12)
    np.testing.assert_allclose(data["beta"], beta.value(data["trust_rh"].to_numpy()), atol=1e-12)
