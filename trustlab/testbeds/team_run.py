"""What a simulated team did: signals, energies, whether it arrived, and how it looks."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from trustlab.models.display import Result, as_html, axes_or_new
from trustlab.sessions.session import Metadata, Session

ENERGIES = {
    "v_h": "$V_h$ operator",
    "v_hd": "$V_{hd}$ device",
    "v_ch": "$V_{ch}$ channel",
    "v_fs": "$V_{fs}$ formation",
    "v_e_delayed": "$V_e(t-T)$ error",
    "v_filter": "filters",
}
# Columns of a session by the name that the run has for them.
LEADER = ["leader_x", "leader_y", "leader_z"]
RENAMED = {
    "leader_x": "robot_x",
    "leader_y": "robot_y",
    "leader_z": "robot_z",
    "supply_hand": "energy_operator",
    "v_hd": "energy_device",
    "lost_device": "energy_dissipated",
    "v_ch": "energy_channel",
    "supply_team": "energy_robot",
}
FORCE = ["f_m_x", "f_m_y", "f_m_z"]
SIGNALS = [f"{name}_{axis}" for name in ("device", "r_m", "f_h", "r_s", "f_s") for axis in "xyz"]
SIGNALS += [*FORCE, "beta", "trust_rh"]


@dataclass(frozen=True, eq=False, repr=False)
class TeamRun(Result):
    """
    One run of `simulate_team`; simulated throughout.

    Parameters
    ----------
    robots : tuple
        Names.
    goal : numpy.ndarray, shape (3,)
        r_q [m].
    data : pandas.DataFrame
        Signals by time; see `table`.
    positions : numpy.ndarray, shape (K, N, 3)
        q_i at the recorded times [m]; NaN while a robot is not in the team.
    trust : numpy.ndarray, shape (K, N)
        Human-to-robot trust (4.1) in every robot.
    switches : numpy.ndarray
        Times at which another robot took over [s], recorded or not.
    budget : float
        β_h of (4.30) [J].
    tolerance : float
        Distance to the goal that counts as arrived [m].
    facts : dict
        How the run was made.
    """

    robots: tuple
    goal: np.ndarray
    data: pd.DataFrame
    positions: np.ndarray
    trust: np.ndarray
    switches: np.ndarray
    budget: float
    tolerance: float
    facts: dict

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
        """Whether V_h ≥ −β_h held in all recorded samples (4.30)."""
        return bool(self.data["v_h"].min() >= -self.budget)

    @property
    def title(self) -> str:
        """One line for titles."""
        return (
            f"{len(self.robots)} robots, leader: {self.facts['policy']}, filter: "
            f"{self.facts['filter']} (synthetic)"
        )

    @property
    def message(self) -> str:
        """Whether and when the team arrived."""
        when = f"all at the goal after {self.time_to_goal:.1f} s"
        arrived = when if self.converged else "not all at the goal"
        return f"{arrived}, {len(self.switches)} switches in {self.t[-1]:.0f} s"

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

    @cached_property
    def session(self) -> Session:
        """
        What the operator and the leader of the moment did: robot_x … is the leader, reference_x …
        the goal.
        """
        number, leader = self.data["number"].to_numpy().astype(int), self.data[LEADER]
        columns = self.data[[*RENAMED, *SIGNALS]].rename(columns=RENAMED)
        columns["trust_hr"] = self.trust[np.arange(len(number)), number]
        columns["path_error"] = np.linalg.norm(leader - self.goal, axis=1)
        columns[["reference_x", "reference_y", "reference_z"]] = self.goal
        about = Metadata(
            "simulated", self.facts["policy"], "trustlab.testbeds.robot_team", True, self.facts
        )
        return Session(columns, about)

    @property
    def measures(self) -> dict[str, float]:
        """
        The outcome measures by name.

        time: until all robots are at the goal for good, or the whole run where they never are [s];
        arrived: 1 or 0; distance: of the farthest robot to the goal, mean [m]; force: that the
        operator feels, root mean square [N]; work: of the operator [J]; trust: in the robot that
        leads, mean; switches.
        """
        force = self.data[FORCE].to_numpy()
        return {
            "time": self.time_to_goal if self.converged else self.t[-1],
            "arrived": float(self.converged),
            "distance": self.farthest.mean(),
            "force": np.sqrt((force**2).sum(axis=1).mean()),
            "work": self.data["supply_hand"].iloc[-1],
            "trust": self.session["trust_hr"].mean(),
            "switches": float(len(self.switches)),
        }

    def _repr_html_(self) -> str:
        return as_html(self.message, pd.DataFrame([self.measures]), title=self.title)

    def plot(self, axes=None):
        """
        Plot distances to the goal, who leads, the force that the operator feels, and the storage
        functions.

        Parameters
        ----------
        axes : sequence of four matplotlib.axes.Axes, optional
            Where, in this order; a new figure when not given.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (4,)

        Raises
        ------
        ValueError
            If there are not four axes.
        """
        axes = axes_or_new(axes, 4, title=self.title, sharex=True, figsize=(8.0, 8.4))
        axes = np.ravel(axes)
        distance, leader, force, energy = axes
        t, data = self.t, self.data
        distance.semilogy(t, np.maximum(self.distances, 1e-9), lw=0.8, color="C0", alpha=0.6)
        distance.axhline(self.tolerance, color="0.4", ls="--", lw=0.8)
        distance.set(ylabel="distance to\nthe goal [m]", ylim=(0.1 * self.tolerance, None))
        leader.step(t, data["number"], where="post", color="0.3")
        leader.set(ylabel="leader")
        force.plot(t, data[FORCE], label=["$f_m$, x", "$f_m$, y", "$f_m$, z"])
        force.set_ylabel("force\nfeedback [N]")
        energy.plot(t, data[list(ENERGIES)], label=list(ENERGIES.values()))
        energy.plot(t, data["v_t"] - self.budget, "k", lw=1.6, label=r"$V_T - \beta_h$ (4.32)")
        # The first two seconds take a third of the axis, as all happens there.
        energy.set_xscale("symlog", linthresh=2.0, linscale=0.8)
        energy.set(ylabel="energy [J]", xlabel="time [s], logarithmic from 2 s on", xlim=t[[0, -1]])
        for axis in (force, energy):
            axis.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        return axes
