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


@pytest.mark.parametrize(("scheme", "kind"), [("TMIG", "logistic"), ("TMIS", "step")])
def test_each_trust_follows_its_own_model_in_its_own_units_and_scales_follow_trust(scheme, kind):
    data = tl.simulate_teleoperation(scheme, study=SETTINGS, seed=5, duration=60.0).data
    scalings = dict(zip(("alpha", "beta"), SETTINGS.scalings(kind), strict=True))
    for model, measure, column, scale in (
        (SETTINGS.human_to_robot, "p_r", "trust_hr", "alpha"),
        (SETTINGS.robot_to_human, "p_h", "trust_rh", "beta"),
    ):
        performance, trust = data[measure].clip(model.p_min, model.p_max), data[column].to_numpy()
        expected = model.simulate(performance.to_numpy(), 0.01, 0.5 * (model.t_min + model.t_max))
        np.testing.assert_allclose(trust, expected, atol=1e-9)
        np.testing.assert_allclose(data[scale], scalings[scale].value(trust), atol=1e-12)
