"""Make the figures that README.md shows: python -m reports.figures.make_figures."""

from pathlib import Path

import matplotlib.pyplot as plt

import trustlab as tl
from trustlab.publishing.figures import use_house_style
from trustlab.sessions.plots import shade_manual

HERE = Path(__file__).parent


def identification() -> None:
    """Measured and fitted performance of the pilot operator's synthetic session."""
    session = tl.sessions.example("pilot")
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
        axis.plot(
            run.t, run.fitted[name], lw=1.8, color="C1", label=f"fitted, {fit.fit_percent:.1f} %"
        )
        shade_manual(axis, run.t, run.mode)
        axis.set_ylabel(label)
        axis.legend(loc="upper center", fontsize="small")
    axes[1].set_xlabel("time [s]; manual phases shaded")
    figure.savefig(HERE / "identification.png", dpi=110)
    plt.close(figure)


CHAIN = (
    ("logs", "CSV, Parquet,\nROS bags", "sessions"),
    ("models", "trust models with\ntheir uncertainty", "identification"),
    ("thresholds", "chosen, bounded,\ncorrected on line", "allocation"),
    ("control", "passive under delay,\none robot or many", "teleoperation"),
    ("virtual study", "simulated operators,\npower, sweeps", "testbeds, campaign"),
    ("statistics", "figures, tables,\nsentences, audit", "studies, reproduction"),
)


def chain() -> None:
    """Draw the whole chain, from logs to a paper's statistics."""
    figure, axis = plt.subplots(figsize=(11, 1.9), layout="constrained")
    for i, (title, what, rooms) in enumerate(CHAIN):
        box = {"boxstyle": "round,pad=0.5", "facecolor": "white", "edgecolor": "C0"}
        axis.text(i, 0.62, title, ha="center", va="center", weight="bold", bbox=box)
        axis.text(i, 0.30, what, ha="center", va="center", fontsize="small")
        axis.text(
            i, 0.04, rooms, ha="center", va="center", fontsize="small", style="italic", color="0.4"
        )
        if i:
            arrow = {"arrowstyle": "->", "color": "0.4"}
            axis.annotate("", (i - 0.36, 0.62), (i - 0.64, 0.62), arrowprops=arrow)
    axis.set(xlim=(-0.5, len(CHAIN) - 0.5), ylim=(-0.05, 0.85))
    axis.set_axis_off()
    figure.savefig(HERE / "chain.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    use_house_style()
    identification()
    chain()
