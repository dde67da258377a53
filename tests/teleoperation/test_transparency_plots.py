"""Figures of transparency show what the functions of the room return."""

import matplotlib as mpl
import numpy as np

from trustlab.teleoperation import (
    STUDIES,
    plot_rendered_spring,
    plot_scales,
    plot_transparency,
    rendered_impedance,
)

mpl.use("Agg")


def test_scales_are_those_of_the_settings():
    settings = STUDIES["main"]
    alpha, beta = settings.scalings()
    lines = plot_scales(settings).lines
    for line, scaling in ((lines[0], alpha), (lines[3], beta)):
        np.testing.assert_allclose(line.get_ydata(), scaling.value(line.get_xdata()), rtol=1e-12)


def test_maps_mark_both_studies():
    axes = plot_transparency(points=8)
    ends = STUDIES["main"].scattering
    assert [line.get_label() for line in axes[0, 0].lines] == list(STUDIES)
    assert axes[0, 0].lines[1].get_xydata().tolist() == [
        [ends.beta_min / ends.beta_max, ends.alpha_min / ends.alpha_max]
    ]
    assert axes[1, 1].lines[1].get_xdata()[0] == ends.b


def test_a_rendered_spring():
    lines = plot_rendered_spring(delay=0.1).lines
    main = STUDIES["main"]
    omega = lines[2].get_xdata()
    felt = rendered_impedance(main.scattering, omega, main.k_ffa / (1j * omega), 0.1, 0.1)
    np.testing.assert_allclose(lines[2].get_ydata(), np.abs(felt), rtol=1e-12)
