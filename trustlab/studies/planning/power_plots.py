"""Power drawn against what it depends on."""

from __future__ import annotations

import numpy as np

__all__ = ["plot_power"]

NAMES = {
    "n": "participants n",
    "effect_size": "population partial η²",
    "correlation": "correlation of conditions",
    "epsilon": "ε of the population",
}


def plot_power(result, against: str | None = None, test: str = "auto", axes=None):
    """
    Draw the power of the omnibus F with its Monte-Carlo intervals; crosses are the closed form.

    Parameters
    ----------
    result : PowerAnalysis
        The analysis.
    against : str, optional
        The horizontal axis; by default the first of n, effect_size, correlation, epsilon that takes several values.
    test : str
        Which of the tests.
    axes : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If `against` or `test` is unknown.
    """
    import matplotlib.pyplot as plt

    table = result.omnibus
    tests = list(dict.fromkeys(table["test"]))
    if test not in tests:
        raise ValueError(f"test must be one of {', '.join(tests)}, got {test!r:.60}")
    table = table[table["test"] == test]
    varying = result.varied
    if against is None:
        against = varying[0] if varying else "n"
    if against not in NAMES:
        raise ValueError(f"against must be one of {', '.join(NAMES)}, got {against!r:.60}")
    if axes is None:
        _, axes = plt.subplots(figsize=(6.0, 3.8), layout="constrained")
    others = [name for name in varying if name != against]
    groups = (
        [((), table)]
        if not others
        else table.groupby(table[others].round(9).apply(tuple, axis=1), sort=False)
    )
    for values, part in groups:
        part = part.sort_values(against)
        label = ", ".join(
            f"{NAMES[name]} {value + 0.0:.3g}" for name, value in zip(others, values, strict=True)
        )
        x, power = part[against].to_numpy(), part["power"].to_numpy()
        bars = np.maximum([power - part["ci_low"], part["ci_high"] - power], 0.0)
        drawn = axes.errorbar(x, power, bars, fmt="o-", ms=4, lw=1.3, capsize=3, label=label or None)
        if part["closed_form"].notna().any():
            axes.plot(x, part["closed_form"], "x", ms=8, color=drawn[0].get_color())
    axes.axhline(result.alpha, color="0.6", lw=0.8, ls=":")
    axes.set(xlabel=NAMES[against], ylabel="power", ylim=(-0.02, 1.02))
    axes.set_title(
        f"{result.origin}: F, correction “{test}”, level {result.alpha:g}, {100 * result.level:g} % Monte-Carlo intervals",
        fontsize="small",
    )
    if others:
        axes.legend(fontsize="x-small")
    return axes
