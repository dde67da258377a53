"""What a simulated team did: signals, energies, whether it arrived, and how it looks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from trustlab.models.display import as_html, axes_or_new
from trustlab.sessions.session import Metadata, Session

if TYPE_CHECKING:
    from trustlab.testbeds.team_animation import AnimationPage

ENERGIES = {
    "v_h": "$V_h$ operator",
    "v_hd": "$V_{hd}$ device",
    "v_ch": "$V_{ch}$ channel",
    "v_fs": "$V_{fs}$ formation",
    "v_e_delayed": "$V_e(t-T)$ error",
    "v_filter": "filters",
}
SIGNALS = ("device", "r_m", "f_h", "f_m", "r_s", "f_s")


@dataclass(frozen=True, eq=False)
class TeamRun:
    """
    One run of `simulate_team`; simulated throughout.

    Parameters
    ----------
    robots : tuple
        Names.
    adjacency : numpy.ndarray, shape (N, N)
        a_ij.
    goal : numpy.ndarray, shape (3,)
        r_q [m].
    data : pandas.DataFrame
        Signals by time; see `table`.
    positions : numpy.ndarray, shape (K, N, 3)
        q_i at the recorded times [m].
    trust : numpy.ndarray, shape (K, N)
        Human-to-robot trust (4.1) in every robot.
    budget : float
        β_h of (4.30) [J].
    tolerance : float
        Distance to the goal that counts as arrived [m].
    facts : dict
        How the run was made.
    changes : tuple
        Later graphs: when each began [s], and its a_ij. Robots that are not in the team have
        positions of NaN.
    """

    robots: tuple
    adjacency: np.ndarray
    goal: np.ndarray
    data: pd.DataFrame
    positions: np.ndarray
    trust: np.ndarray
    budget: float
    tolerance: float
    facts: dict
    changes: tuple = ()

    @property
    def t(self) -> np.ndarray:
        """Recorded times [s], shape (K,)."""
        return self.data.index.to_numpy()

    @cached_property
    def distances(self) -> np.ndarray:
        """‖q_i − r_q‖ of every robot [m], shape (K, N)."""
        return np.linalg.norm(self.positions - self.goal, axis=2)

    @cached_property
    def spread(self) -> np.ndarray:
        """Greatest distance of a robot to the team's centre [m], shape (K,): zero in synchrony."""
        centre = np.nanmean(self.positions, axis=1, keepdims=True)
        return np.nanmax(np.linalg.norm(self.positions - centre, axis=2), axis=1)

    @cached_property
    def farthest(self) -> np.ndarray:
        """Distance to the goal of the robot farthest from it [m], shape (K,)."""
        return np.nanmax(self.distances, axis=1)

    @cached_property
    def links(self) -> list[tuple[float, np.ndarray]]:
        """When each graph began [s], and which robots it links, shape (E, 2)."""
        graphs = ((0.0, self.adjacency), *self.changes)
        return [(since, np.argwhere(np.triu(graph + graph.T))) for since, graph in graphs]

    @property
    def converged(self) -> bool:
        """Whether every robot is within the tolerance of the goal at the end."""
        return bool(self.farthest[-1] < self.tolerance)

    @property
    def synchronised(self) -> bool:
        """Whether all robots are within the tolerance of each other's centre at the end."""
        return bool(self.spread[-1] < self.tolerance)

    @property
    def time_to_goal(self) -> float:
        """When the last robot came within the tolerance for good [s]; NaN if not all did."""
        if not self.converged:
            return float("nan")
        outside = np.flatnonzero(self.farthest >= self.tolerance)
        return float(self.t[outside[-1] + 1]) if outside.size else 0.0

    @property
    def operator_passive(self) -> bool:
        """Whether V_h ≥ −β_h held throughout (4.30)."""
        return bool(self.data["v_h"].min() >= -self.budget)

    @property
    def switches(self) -> np.ndarray:
        """Times at which another robot took over [s]."""
        return self.t[1:][np.diff(self.data["number"].to_numpy()) != 0.0]

    @property
    def label(self) -> str:
        """One line for titles."""
        return (
            f"{len(self.robots)} robots, leader: {self.facts['policy']}, filter: "
            f"{self.facts['filter']} (synthetic)"
        )

    def table(self) -> pd.DataFrame:
        """
        Return signals and energies, one row per recorded time.

        leader_x … are the leader's position at the midpoint of the sample; number is its place in
        `robots`; push the share σ of the operator; ``v_…`` the storages of (4.32), v_t their sum;
        ``supply_…`` energy taken in by team, error system, hand, device and filters since the
        start, supply_links what V_fs gained by changes of the graph, ``lost_…`` what was
        dissipated.
        """
        return self.data.copy()

    def session(self) -> Session:
        """
        Return what the operator and the leader of the moment did, as a session: robot_x … is the
        leader, reference_x … the goal.
        """
        data, number = self.data, self.data["number"].to_numpy().astype(int)
        columns = {}
        for axis, at in zip("xyz", self.goal, strict=True):
            columns |= {f"robot_{axis}": data[f"leader_{axis}"], f"reference_{axis}": at}
            columns |= {f"{name}_{axis}": data[f"{name}_{axis}"] for name in SIGNALS}
        leader = data[["leader_x", "leader_y", "leader_z"]].to_numpy()
        columns |= {
            "beta": data["beta"],
            "trust_hr": self.trust[np.arange(len(number)), number],
            "trust_rh": data["trust_rh"],
            "path_error": np.linalg.norm(leader - self.goal, axis=1),
            "energy_operator": data["supply_hand"],
            "energy_device": data["v_hd"],
            "energy_dissipated": data["lost_device"],
            "energy_channel": data["v_ch"],
            "energy_robot": data["supply_team"],
        }
        about = Metadata(
            "simulated", self.facts["policy"], "trustlab.testbeds.robot_team", True, self.facts
        )
        return Session(pd.DataFrame(columns, index=data.index), about)

    def summary(self) -> pd.DataFrame:
        """Return one row: whether and when the team arrived, and what held on the way."""
        rises = np.diff((self.data["v_t"] - self.data["supply_links"]).to_numpy())
        row = {
            "robots": len(self.robots),
            "policy": self.facts["policy"],
            "filter": self.facts["filter"],
            "switches": len(self.switches),
            "converged": self.converged,
            "time_to_goal": self.time_to_goal,
            "distance": float(self.farthest[-1]),
            "spread": float(self.spread[-1]),
            "operator_passive": self.operator_passive,
            "least_v_h": float(self.data["v_h"].min()),
            "budget": self.budget,
            "least_v_ch": float(self.data["v_ch"].min()),
            "greatest_rise_v_t": float(rises.max()),
        }
        return pd.DataFrame([row])

    def __repr__(self) -> str:
        state = (
            f"all at the goal after {self.time_to_goal:.1f} s"
            if self.converged
            else "not all at the goal"
        )
        return (
            f"TeamRun({self.label}: {state}, {len(self.switches)} switches in {self.t[-1]:.0f} s)"
        )

    def _repr_html_(self) -> str:
        return as_html("", self.summary().T.set_axis([""], axis=1), title=self.label)

    def plot(self, axes=None):
        """
        Plot distances to the goal, who leads, the force that the operator feels, and the storage
        functions.

        Parameters
        ----------
        axes : sequence of four matplotlib.axes.Axes, optional
            Where; a new figure when not given.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (4,)

        Raises
        ------
        ValueError
            If there are not four axes.
        """
        heights = (3, 1.6, 2, 3)
        axes = axes_or_new(
            axes, 4, title=self.label, sharex=True, figsize=(8.0, 8.4), height_ratios=heights
        )
        axes = np.asarray(axes, dtype=object).ravel()
        if axes.size != 4 or not all(hasattr(axis, "plot") for axis in axes):
            raise ValueError(
                "axes must be four Matplotlib axes: distances, leader, force, energies"
            )
        t, data = self.t, self.data
        axes[0].semilogy(t, np.maximum(self.distances, 1e-9), lw=0.8, color="#0072b2", alpha=0.6)
        axes[0].axhline(self.tolerance, color="0.4", ls="--", lw=0.8)
        axes[0].set(ylabel="distance to\nthe goal [m]", ylim=(0.1 * self.tolerance, None))
        axes[1].step(t, data["number"], where="post", color="#444444", lw=1.0)
        axes[1].set(ylabel="leader", ylim=(-0.5, len(self.robots) - 0.5))
        if len(self.robots) <= 12:
            axes[1].set_yticks(
                range(len(self.robots)), [str(name) for name in self.robots], fontsize="small"
            )
        for name, colour in zip("xyz", ("#0072b2", "#d55e00", "#009e73"), strict=True):
            axes[2].plot(t, data[f"f_m_{name}"], lw=0.9, color=colour, label=f"$f_m$, {name}")
        axes[2].set_ylabel("force\nfeedback [N]")
        for name, label in ENERGIES.items():
            if name != "v_filter" or data[name].any():
                axes[3].plot(t, data[name], lw=0.9, label=label)
        axes[3].plot(
            t, data["v_t"] - self.budget, lw=1.6, color="black", label=r"$V_T - \beta_h$ (4.32)"
        )
        axes[3].set(ylabel="energy [J]", xlabel="time [s], logarithmic from 2 s on")
        # The first two seconds take a third of the axis, as all happens there.
        axes[3].set_xscale("symlog", linthresh=2.0, linscale=0.8)
        ticks = [tick for tick in (0, 1, 2, 5, 10, 20, 50, 100, 200, 500) if tick <= t[-1]]
        axes[3].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes[3].set_xlim(t[0], t[-1])
        for axis in axes[2:]:
            axis.legend(
                fontsize="small", frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5)
            )
        for axis in axes:
            for at in self.switches:
                axis.axvline(at, color="0.85", lw=0.6, zorder=0)
        return axes

    def plot_distance(self, axis=None, label: str | None = None):
        """
        Plot the distance to the goal of the robot farthest from it.

        Parameters
        ----------
        axis : matplotlib.axes.Axes, optional
            Where; a new figure when not given.
        label : str, optional
            For a legend.

        Returns
        -------
        matplotlib.axes.Axes
        """
        axis = axes_or_new(axis, title=self.label, figsize=(8.0, 3.2))
        axis.semilogy(self.t, np.maximum(self.farthest, 1e-9), label=label)
        if len(axis.lines) == 1:
            axis.axhline(self.tolerance, color="0.5", ls="--", lw=0.8)
        axis.set(xlabel="time [s]", ylabel="greatest distance\nto the goal [m]")
        return axis

    def animate(self, path: str | Path | None = None, rate: float = 5.0) -> Path | AnimationPage:
        """
        Return an animation as one HTML page without anything from outside, or write it to a file.

        Robots and their links, the leader, the goal, and the force that the operator feels, seen
        from above and from the side.

        Parameters
        ----------
        path : str or pathlib.Path, optional
            File to write; its folder must exist.
        rate : float
            Simulated seconds per second at the start; the page has a slider for the time.

        Returns
        -------
        pathlib.Path or AnimationPage
            The file, where one was named; else the page, text that a notebook shows.

        Raises
        ------
        ValueError
            If the rate is not positive, or the folder does not exist.
        """
        from trustlab.testbeds.team_animation import AnimationPage, animation_page

        page = animation_page(self, rate)
        if path is not None:
            target = Path(path)
            if not target.parent.is_dir():
                raise ValueError(f"there is no folder {target.parent} to write the animation to")
            target.write_text(page, encoding="utf-8")
            return target
        return AnimationPage(page)

    def picture(self, until: float | None = None, lasting: float = 20.0) -> str:
        """
        Return a moving picture as one SVG without a script, for reports: the team from above, and
        the force felt.

        Parameters
        ----------
        until : float, optional
            Where to stop [s]; at the end of the run when not given.
        lasting : float
            How long one showing lasts [s].

        Raises
        ------
        ValueError
            If `until` is not within the run, or `lasting` is not positive.
        """
        from trustlab.testbeds.team_animation import animated_svg

        return animated_svg(self, until, lasting)
