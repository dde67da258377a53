"""
Section 3.7: dominance of signals, and the scales of (3.5) and (3.6).
"""

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.teleoperation import STUDIES, plot_scales
from trustlab.teleoperation.ports.waves import Scattering
from trustlab.teleoperation.transparency import dominance

mpl.use("Agg")
SETTINGS = settings(max_examples=60, deadline=None, derandomize=True)
share = st.floats(0.02, 1.0)


@st.composite
def channels(draw):
    alphas, betas = sorted((draw(share), draw(share))), sorted((draw(share), draw(share)))
    return Scattering(draw(st.floats(0.1, 10.0)), alphas[0], alphas[1], betas[0], betas[1])


@SETTINGS
@given(channels())
def test_dominance_is_the_ratio_of_the_coefficients_of_3_22(channel):
    """Oracle: the closed forms of its docstring."""
    b, alpha, beta = channel.b, channel.alpha_max, channel.beta_max
    expected = {
        "force_operator": np.sqrt(2.0 / (b * beta)),
        "force_robot": np.sqrt(2.0 * alpha / b),
        "velocity_robot": np.sqrt(2.0 * b / alpha),
        "velocity_operator": np.sqrt(2.0 * b * beta),
    }
    assert dominance(channel) == pytest.approx(expected, rel=1e-12)


# Figures


def test_scales_are_those_of_the_settings():
    """Oracle: (3.5) by hand, from upper to lower bound as trust grows."""
    ends = STUDIES["main"].scattering
    lines = {line.get_label(): line for line in plot_scales(STUDIES["main"]).lines}
    for symbol, low, high in (
        ("α", ends.alpha_min, ends.alpha_max),
        ("β", ends.beta_min, ends.beta_max),
    ):
        trust, scale = lines[f"{symbol}, logistic"].get_data()
        expected = high + (low - high) / (1.0 + np.exp(-10.0 * (trust - 0.5)))
        np.testing.assert_allclose(scale, expected, rtol=1e-12)
        assert set(lines[f"{symbol}, step"].get_ydata()) == {low, high}
