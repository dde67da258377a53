"""Figures of the ground robot: where it went, and how performance, utilization and TSC moved."""

import numpy as np

from trustlab.models.axes import axes_or_new
from trustlab.models.checks import finite_array, finite_number, of_class, one_of
from trustlab.sessions.plots import shade_manual
from trustlab.sessions.session import Session
from trustlab.testbeds.ground_robot.course import Course

PANELS = {
    "p_r": "robot performance\n$P_r$",
    "r": "human utilization\n$r$",
    "p_h": "human performance\n$P_h$",
    "tsc": "TSC",
}


def plot_path(session: Session, course: Course, start: float = 0.0, stop: float | None = None, axes=None):
    """
    Plot the desired path, the guide posts, and the robot's track under manual and autonomous control.

    Parameters
    ----------
    session : Session
        With columns robot_x, robot_y and mode.
    course : Course
        The course.
    start, stop : float, optional
        The part of the session to show [s]; to its end when `stop` is not given.
    axes : matplotlib.axes.Axes, optional
        Where to plot; a new figure when not given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood.
    """
    of_class("session", session, Session)
    of_class("course", course, Course)
    session.require("robot_x", "robot_y", "mode")
    stop = session.t[-1] if stop is None else finite_number("stop", stop)
    part = session.between(finite_number("start", start), stop)
    axes = axes_or_new(axes, figsize=(8.0, 5.6))
    axes.plot(*course.posts.T, ls="", marker="o", ms=4, mfc="none", color="0.55", label="guide posts")
    for manual, style, label in ((1, "-", "manual"), (0, ":", "autonomous")):
        here = part["mode"] == manual
        shown = here | np.r_[False, here[:-1]]
        x, y = np.where(shown, part["robot_x"], np.nan), np.where(shown, part["robot_y"], np.nan)
        width = 0.9 if manual else 1.3
        if here.any():
            axes.plot(x, y, ls=style, lw=width, color="black" if manual else "#0072b2", label=label)
    axes.plot(*course.path[:, :2].T, ls="--", lw=2.0, color="#d62728", label="desired")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(session.label, fontsize="medium")
    axes.legend(fontsize="small", ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False)
    return axes


def plot_run(run, bounds: dict[str, tuple[float, float]] | None = None):
    """
    Plot P_r, r, P_h and TSC of a run, one panel each, manual phases shaded.

    Parameters
    ----------
    run : ConditionRun
        What to plot.
    bounds : dict of str to (float, float), optional
        Lower and upper bounds to draw, by column.

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes, shape (4,)

    Raises
    ------
    ValueError
        If bounds name a column that is not plotted, or are not two finite numbers.
    """
    if not hasattr(run, "session"):
        raise ValueError(f"run must be a ConditionRun, got {type(run).__name__}")
    session = run.session
    try:
        bounds = dict(bounds if bounds is not None else {})
    except (TypeError, ValueError):
        raise ValueError(f"bounds must map columns to (low, high), got {bounds!r:.60}") from None
    for name, pair in bounds.items():
        one_of("a column of bounds", name, PANELS)
        bounds[name] = tuple(finite_array(f"bounds[{name!r}]", pair, length=2))
    if run.thresholds is not None:
        bounds.setdefault("tsc", run.thresholds)
    axes = axes_or_new(None, len(PANELS), sharex=True, figsize=(8.0, 7.6))
    unit = " [m/s]" if "v_command" in session else ""  # on the UAV testbed performance is a share
    for panel, (name, label) in zip(axes, PANELS.items(), strict=True):
        panel.plot(session.t, session[name], lw=1.2, color="#0072b2")
        values = np.r_[session[name], bounds.get(name, ())]
        margin = 0.08 * max(float(np.ptp(values)), 1e-6)
        panel.set_ylim(values.min() - margin, values.max() + margin)
        for bound in bounds.get(name, ()):
            panel.axhline(bound, ls="--", lw=1.0, color="#d55e00")
        panel.set_ylabel(label + unit * (name in ("p_r", "p_h")))
        shade_manual(panel, session.t, session["mode"])
    axes[-1].set(xlabel="time [s]", xlim=(session.t[0], session.t[-1]))
    lines = "; dashed: " + ("thresholds" if set(bounds) == {"tsc"} else "bounds") if bounds else ""
    axes[0].figure.suptitle(f"{session.label} (manual phases shaded{lines})", fontsize="medium")
    return axes
