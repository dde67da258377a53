"""
Guards inside the loop: waves against ports, and the ledger under jitter and loss.
"""

import numpy as np
import pytest

from tests.flights import T, columns, power
from trustlab.teleoperation.loop.settings import STUDIES
from trustlab.testbeds.uav_tracking import simulate_teleoperation

SCHEMES = ("M", "MMI", "TMIG", "TMIS", "OMI")


def waves(data, ends):
    """u_l, v_l, u_r, v_r by (3.13) from what was logged at the two ports."""
    b = ends.b
    back, out = columns(data, "f_m") / data["beta"].to_numpy()[:, None], columns(data, "r_m")
    force, said = columns(data, "f_s"), columns(data, "r_s") / data["alpha"].to_numpy()[:, None]
    return (
        np.sqrt(ends.beta_min / (2 * b)) * (back + b * out),
        np.sqrt(ends.beta_max / (2 * b)) * (back - b * out),
        np.sqrt(ends.alpha_min / (2 * b)) * (force - b * said),
        np.sqrt(ends.alpha_max / (2 * b)) * (force + b * said),
    )


@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_waves_arrive_as_they_were_sent_and_the_channel_holds_what_its_ports_took(scheme, study):
    data = simulate_teleoperation(
        scheme,
        study=study,
        seed=8,
        duration=20.0,
        delay=(0.13, 0.21),
        guidance="through_channel",
    ).data
    u_l, v_l, u_r, v_r = waves(data, STUDIES[study].scattering)
    atol = 1e-11 * max(np.abs(wave).max() for wave in (u_l, v_l, u_r, v_r))
    np.testing.assert_allclose(v_r[13:], u_l[:-13], atol=atol)  # unit gain (Remark 10)
    np.testing.assert_allclose(v_l[21:], u_r[:-21], atol=atol)
    held = T * np.cumsum(power(data, "r_m", "f_m") - power(data, "r_s", "f_s"))
    np.testing.assert_allclose(data["energy_channel"], held, atol=1e-9 * np.abs(held).max())
