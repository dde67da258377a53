"""Make the figures of README.md and of the book: python -m reports.figures.make_figures."""

from pathlib import Path

import matplotlib.pyplot as plt

import trustlab as tl
from notebooks.diagrams import Diagram
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


STEPS = (
    ("log", "A log", "CSV, Parquet, ROS bags"),
    ("model", "Models of trust", "with their uncertainty"),
    ("pair", "Thresholds", "chosen, bounded,\ncorrected"),
    ("run", "Control", "passive under delay,\none robot or many"),
    ("study", "A study", "simulated, in a browser,\non a robot"),
    ("paper", "Statistics", "tables, figures, sentences"),
)


def chain() -> None:
    """Draw the whole chain, from a log to a paper's statistics."""
    d = Diagram(1.72)
    for i, (name, words, details) in enumerate(STEPS):
        d.block(name, words, 1.1 + 2.15 * (i % 3), 1.36 - 0.94 * (i // 3), 1.8, 0.68, details)
    d.arrow("log.e", "model.w")
    d.arrow("model.e", "pair.w")
    d.arrow("pair.s", (5.4, 0.89), (1.1, 0.89), "run.n")
    d.arrow("run.e", "study.w")
    d.arrow("study.e", "paper.w")
    d.figure.savefig(HERE / "chain.png", dpi=200)


if __name__ == "__main__":
    use_house_style()
    identification()
    chain()
