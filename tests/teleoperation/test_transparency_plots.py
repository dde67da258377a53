"""Figures of transparency show what the functions of the room return."""

import matplotlib as mpl
import numpy as np

from trustlab.teleoperation import STUDIES, plot_scales, plot_transparency

mpl.use("Agg")


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


def test_maps_mark_both_studies():
    axes = plot_transparency()
    ends = STUDIES["main"].scattering
    assert len(axes) == 3
    assert [line.get_label() for line in axes[0].lines] == list(STUDIES)
    assert axes[0].lines[1].get_xydata().tolist() == [
        [ends.beta_min / ends.beta_max, ends.alpha_min / ends.alpha_max]
    ]
