"""Whether a logged run of teleoperation was passive at its ports and stayed bounded."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class
from trustlab.models.display import Result
from trustlab.sessions.session import Session

# Velocity and force at each port; power is positive where it enters at the hand, and leaves to
# the robot.
PORTS = {"operator": ("r_m", "f_m"), "robot": ("r_s", "f_s")}

# What integrals may be off by rounding, as a share of all energy exchanged.
ROUNDING = 1e-9

# Up to which factor signals of the last third may exceed those before and count as bounded.
GROWTH = 10.0


@dataclass(frozen=True, eq=False, repr=False)
class Passivity(Result):
    """
    Energy at the ports of a run, integrated from its logged signals.

    Parameters
    ----------
    energies : pandas.DataFrame
        Energy [J] that each port has taken since the start, by time [s]: operator, robot.
    passive : bool
        Whether neither port ever gave out more energy than it had taken, up to rounding.
    bounded : bool
        Whether `growth` is at most ten.
    growth : float
        The largest velocity or force of the last third of the run, in m/s or N, over the largest
        before.
    """

    title = "Passivity of a run"

    energies: pd.DataFrame
    passive: bool
    bounded: bool
    growth: float

    @property
    def least_energy(self) -> pd.Series:
        """Least energy of each port [J], 0 at the start included."""
        return self.energies.min().clip(upper=0.0).rename("least_energy")

    @property
    def message(self) -> str:
        """Whether the run was passive and bounded, in a sentence."""
        least = self.least_energy
        port = str(least.idxmin())
        verdict = "Passive: neither port gave out more energy than it had taken"
        if not self.passive:
            verdict = (
                f"Not passive: at t = {self.energies[port].idxmin():g} s the {port}'s port had "
                f"given out {-least[port]:.3g} J more than it had taken"
            )
        bounds = "stayed bounded"
        if not self.bounded:
            bounds = f"grew {self.growth:.3g}-fold in the last third of the run"
        if np.isinf(self.growth):
            bounds = "began in the last third of the run, which does not show that they are bounded"
        return f"{verdict}; velocities and forces {bounds}."

    def table(self) -> pd.DataFrame:
        """
        Return one row per port.

        Returns
        -------
        pandas.DataFrame
            Columns port, least_energy [J], at [s] (when the energy was least), final_energy [J].
        """
        ports = self.energies.rename_axis(columns="port")
        when, final = ports.idxmin().rename("at"), ports.iloc[-1].rename("final_energy")
        return pd.concat([self.least_energy, when, final], axis=1).rename_axis("port").reset_index()


def passivity(session: Session) -> Passivity:
    """
    Check from a log whether teleoperation was passive at both ports, and its signals bounded.

    Parameters
    ----------
    session : Session
        With velocity and force at the operator's port, r_m_x … and f_m_x …, and at the robot's,
        r_s_x … and f_s_x …, on the axes that were logged, the same at all; of
        `simulate_teleoperation`, or of a robot.

    Returns
    -------
    Passivity
        With .passive, .bounded, .least_energy, .message and .table().

    Raises
    ------
    ValueError
        If `session` is no Session, a column is missing, or it is a team's: its leader hands energy
        on to other robots, and its operator has the budget of (4.30), `TeamRun.operator_passive`.

    Notes
    -----
    A log shows this run alone: that a loop is passive whatever operator, robot and delays do is
    what Theorems 3 and 4 promise, and no run can. Energy is the sum of power times the sample time,
    as the loop's own controllers count it; in the log of a continuous system it is off by about one
    sample's power.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.simulate_teleoperation("TMIG", seed=1, duration=20.0)
    >>> answer = tl.passivity(run)
    >>> answer.passive, answer.bounded
    (True, True)
    """
    of_class("session", session, Session)
    if session.metadata.source == "trustlab.testbeds.robot_team":
        raise ValueError(
            "in a team the leader hands energy on to other robots: see TeamRun.operator_passive"
        )
    axes = [axis for axis in "xyz" if f"r_m_{axis}" in session] or ["x"]
    names = [f"{name}_{axis}" for pair in PORTS.values() for name in pair for axis in axes]
    session.require(*names)
    energies, exchanged = {}, 0.0
    for port, (velocity, force) in PORTS.items():
        power = sum(session[f"{velocity}_{axis}"] * session[f"{force}_{axis}"] for axis in axes)
        energies[port] = session.sample_time * np.cumsum(power)
        exchanged += session.sample_time * float(np.abs(power).sum())
    frame = pd.DataFrame(energies, index=session.data.index)
    sizes = np.abs(session.data[names].to_numpy()).max(axis=1)
    last = len(sizes) - max(len(sizes) // 3, 1)
    before, after = sizes[:last].max(), sizes[last:].max()
    growth = float(after / before) if before > 0.0 else np.inf if after > 0.0 else 1.0
    passive = bool((frame.min() >= -ROUNDING * exchanged - 1e-12).all())
    return Passivity(frame, passive, bool(growth <= GROWTH), growth)
