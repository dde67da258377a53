"""Printed, predicted and simulated effects in one figure."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from trustlab.reproduction.effects import model_effects
from trustlab.reproduction.effects_simulated import effects_of

UNITS = {"p_r": "robot performance", "p_h": "human performance", "r": "utilization", "tlx": "task load"}
UNITS |= {"error": "tracking error [m]", "followed_percent": "suggestions followed [%]"}


def plot_effects(study: str, simulated: Mapping[str, pd.DataFrame]) -> np.ndarray:
    """
    Plot the effects of a study, a panel per measure: as printed, as the models predict, and as simulated.

    Parameters
    ----------
    study : {"ground_robot", "uav", "table_2.4", "table_2.5", "table_2.6", "table_3.1", "teleop"}
        The study.
    simulated : mapping of str to pandas.DataFrame
        Results of `simulated_effects` by what is assumed; bars are ± 2 standard errors.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes
    """
    import matplotlib.pyplot as plt

    wanted = [effect for effect in effects_of(study) if np.isfinite(effect.printed)]
    measures = list(dict.fromkeys(effect.measure for effect in wanted))
    predicted = model_effects().set_index("id")
    columns = min(4, len(measures))
    rows = -(-len(measures) // columns)
    figure, axes = plt.subplots(rows, columns, squeeze=False, layout="constrained", figsize=(3.2 * columns, 2.8 * rows))
    for axis in axes.flat[len(measures) :]:
        axis.axis("off")
    for axis, measure in zip(axes.flat, measures, strict=False):
        own = [effect for effect in wanted if effect.measure == measure]
        ids, x = [effect.id for effect in own], np.arange(len(own), dtype=float)
        axis.axhline(0.0, color="black", lw=0.6)
        axis.plot(x, [effect.printed for effect in own], "_", color="black", ms=16, mew=2, label="printed")
        axis.plot(x, predicted.loc[ids, "model"], "x", color="#444444", label="model")
        for i, (label, frame) in enumerate(simulated.items()):
            found = frame.set_index("id").loc[ids]
            place = x + 0.15 * (i + 1)
            axis.errorbar(place, found["simulated"], 2.0 * found["se"], fmt="o", ms=3, label=f"simulated: {label}")
        axis.set_xlim(-0.4, x[-1] + 0.2 + 0.15 * len(simulated))
        axis.set_xticks(x, [effect.contrast for effect in own], rotation=45)
        axis.set_title(UNITS.get(measure, measure), fontsize="medium")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2 + len(simulated))
    return axes.ravel()[: len(measures)]
