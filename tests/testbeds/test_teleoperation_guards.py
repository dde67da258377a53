"""
Guards inside the loop: waves against ports, and the ledger under jitter and loss.
"""

import numpy as np
import pytest

from tests.flights import T, columns, jitter
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


def squares(wave):
    return (wave**2).sum(axis=1)


@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_waves_arrive_as_they_were_sent_and_carry_the_power_of_the_ports(scheme, study):
    ends = STUDIES[study].scattering
    data = simulate_teleoperation(
        scheme,
        study=study,
        seed=8,
        duration=20.0,
        delay=(0.13, 0.21),
        guidance="through_channel",
    ).data
    u_l, v_l, u_r, v_r = waves(data, ends)
    scale = max(np.abs(wave).max() for wave in (u_l, v_l, u_r, v_r))
    np.testing.assert_allclose(
        v_r[13:], u_l[:-13], atol=1e-11 * scale
    )  # constant delay: unit gain (Remark 10)
    np.testing.assert_allclose(v_l[21:], u_r[:-21], atol=1e-11 * scale)
    alpha, beta = data["alpha"].to_numpy(), data["beta"].to_numpy()
    carried = 0.5 * beta * (squares(u_l) / ends.beta_min - squares(v_l) / ends.beta_max)
    carried -= 0.5 * alpha * (squares(v_r) / ends.alpha_max - squares(u_r) / ends.alpha_min)
    logged = np.diff(data["energy_channel"], prepend=0.0) / T
    np.testing.assert_allclose(logged, carried, atol=1e-11 * np.abs(carried).max())


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_ledger_keeps_the_channel_passive_under_jitter_and_loss(scheme):
    for seed in range(8):
        lost = np.random.default_rng([71, seed]).uniform(size=(2, 3000)) < 0.3
        data = simulate_teleoperation(
            scheme,
            seed=seed,
            duration=30.0,
            delay=(jitter(2 * seed), jitter(2 * seed + 1)),
            signals={"arrives": ~lost.T},
            guidance="through_channel",
        ).data
        u_l, v_l, u_r, v_r = waves(data, STUDIES["main"].scattering)
        for number, (sent, read) in enumerate(((u_l, v_r), (u_r, v_l))):
            arrived = np.where(lost[number], 0.0, squares(sent))
            assert (np.cumsum(squares(read)) <= np.cumsum(arrived) * (1 + 1e-9) + 1e-15).all()
            assert read.any()
        exchanged = T * (np.abs(columns(data, "r_m") * columns(data, "f_m")).sum(axis=1)).cumsum()
        assert (data["energy_channel"] >= -1e-9 * exchanged).all()
