"""A figure of the ground robot: where it went."""

import numpy as np

from trustlab.models.axes import axes_or_new
from trustlab.models.checks import finite_number, of_class
from trustlab.sessions.session import Session
from trustlab.testbeds.ground_robot.course import Course


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
