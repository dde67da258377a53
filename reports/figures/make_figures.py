"""Make the figures that README.md shows: python reports/figures/make_figures.py."""

from pathlib import Path

import matplotlib.pyplot as plt

import trustlab as tl
from trustlab.publishing.figures import use_house_style
from trustlab.sessions.plots import shade_manual

HERE = Path(__file__).parent


def identification() -> None:
    """Measured and fitted performance of the pilot operator's synthetic session."""
    session = tl.read_session(HERE.parents[1] / "data" / "sessions" / "pilot.csv")
    robot, human = tl.fit_robot(session), tl.fit_human(session)
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(9, 4.4), layout="constrained")
    for axis, fit, name, label in zip(
        axes,
        (robot, human),
        ("p_r", "p_h"),
        ("robot performance $P_r$", "human performance $P_h$"),
        strict=True,
    ):
        run = fit.runs[0]
        axis.plot(run.t, run.measured[name], lw=0.5, color="0.65", label="measured (synthetic)")
        axis.plot(run.t, run.fitted[name], lw=1.8, color="C1", label=f"fitted, {fit.fit_percent:.1f} %")
        shade_manual(axis, run.t, run.mode)
        axis.set_ylabel(label)
        axis.legend(loc="upper center", fontsize="small")
    axes[1].set_xlabel("time [s]; manual phases shaded")
    figure.savefig(HERE / "identification.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    use_house_style()
    identification()
