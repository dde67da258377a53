"""Plots of posteriors: marginals beside the prior, fitted curves with bands, shrinkage."""

import numpy as np
import pandas as pd

from trustlab.identification.posterior.result import MODEL, summary

LABELS = {
    "human_time_constant": "operator's time constant [s]",
    "human_beta": "β",
    "human_p_min": "$P_{h,min}$",
    "human_p_max": "$P_{h,max}$",
    "robot_time_constant": "robot's time constant [s]",
    "robot_p_min": "$P_{r,min}$",
    "robot_p_max": "$P_{r,max}$",
}

# Share of the prior's range below which a posterior would be a mere line in it.
NARROW = 0.15


def plot_posterior(posterior):
    """Return the axes of `Posterior.plot`."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, 3, figsize=(10, 7.5), layout="constrained")
    panels = axes.ravel()
    for panel, name in zip(panels, MODEL, strict=False):
        low, high = posterior.prior_draws[name].quantile([0.01, 0.99])
        bins = np.linspace(low, high, 40)
        panel.hist(posterior.prior_draws[name], bins, density=True, color="0.8", label="prior")
        panel.hist(
            posterior.draws[name], 30, density=True, color="C0", alpha=0.7, label="posterior"
        )
        least, most = posterior.draws[name].quantile([0.01, 0.99])
        if most - least < NARROW * (high - low):
            panel.set_xlim(least - (most - least), most + (most - least))
            panel.locator_params(axis="x", nbins=4)
            panel.set_title(f"prior: {low:.3g} to {high:.3g}", fontsize="small")
        panel.set_xlabel(LABELS[name])
        panel.set_yticks([])
    panels[0].legend(fontsize="small")
    blocks = posterior.target.blocks
    size = blocks.first_block[1]
    t = (np.arange(size) + 0.5) * blocks.step * blocks.samples
    low, middle, high = np.quantile(posterior.simulated()[:, :, :size], [0.025, 0.5, 0.975], axis=0)
    for j, (panel, label) in enumerate(zip(panels[7:], ("$P_h$", "$P_r$"), strict=True)):
        panel.plot(t, blocks.measured[j, :size], lw=0.5, color="0.6", label="measured, 1-s means")
        panel.fill_between(t, low[j], high[j], color="C1", alpha=0.5, label="95 % of fitted curves")
        panel.plot(t, middle[j], color="C1", lw=1.2)
        panel.set(xlabel="time [s]", ylabel=label, title=posterior.labels[0])
        panel.title.set_fontsize("small")
    panels[7].legend(fontsize="x-small")
    if posterior.synthetic:
        figure.suptitle("Posterior, synthetic data", fontsize="small")
    return axes


def plot_shrinkage(people):
    """Return the axes of `Population.plot`."""
    import matplotlib.pyplot as plt

    table = people.table()
    alone = {name: summary(each.draws, 0.95) for name, each in people.alone.items()}
    names = table.index.get_level_values("person").unique()
    places = np.arange(len(names))
    figure, axes = plt.subplots(2, 4, figsize=(11, 5), sharey=True, layout="constrained")
    panels = axes.ravel()
    for panel, parameter in zip(panels, MODEL, strict=False):
        pooled = table.xs(parameter, level="parameter").loc[names]
        panel.hlines(places, pooled["ci_low"], pooled["ci_high"], color="C0", lw=2)
        panel.plot(pooled["mean"], places, "o", color="C0", label="pooled")
        own = pd.DataFrame({name: each.loc[parameter] for name, each in alone.items()}).T
        above = places[:-1] + 0.25
        panel.hlines(above, own["ci_low"], own["ci_high"], color="0.6")
        panel.plot(own["mean"], above, ".", color="0.6", label="alone")
        panel.set_xlabel(LABELS[parameter])
        panel.set_yticks(places, names)
    panels[7].axis("off")
    panels[7].legend(*panels[0].get_legend_handles_labels(), loc="center")
    if people.synthetic:
        figure.suptitle("Population, synthetic data", fontsize="small")
    return panels[:7]
