"""
Settings of a team under one operator: its blocks, its channel, how a run is made, and the simulated
operator of (4.30).
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    Share,
    finite_numbers,
    not_negative,
    of_class,
    one_of,
    positive,
    set_checked,
)
from trustlab.models.trust import TrustModel
from trustlab.teleoperation.delays import both_ways, delay_from
from trustlab.teleoperation.ports import HapticDevice, Scattering
from trustlab.teleoperation.team.graphs import GraphError, laplacian, team_graph

# What the filters F1 and F2 of Fig. 4.1 are, by name.
FILTERS = ("none", "corrected", "waves", "printed")


@dataclass(frozen=True, eq=False)
class TeamChannel(Checked):
    """
    The channel between the operator and the team, beside its scattering.

    Parameters
    ----------
    delay : float, callable, Delay, or a pair of these
        Delay both ways [s], or (to the robots, back); at least one sample. The operator's picture
        is as old as the greatest delay.
    filters : {"corrected", "waves", "printed", "none"}
        F1 and F2 of Fig. 4.1, with a cutoff of 10 rad/s, and the mean b for the corrected gains.
    switch_scattering : bool
        Whether the operator's end is switched with the leader, (4.7); False shows what that is for.

    Raises
    ------
    ValueError
        If an argument is not understood.
    """

    delay: Any = 0.2
    filters: str = "corrected"
    switch_scattering: bool = True

    def __post_init__(self):
        super().__post_init__()
        one_of("filters", self.filters, FILTERS)
        for name, delay in both_ways(self.delay).items():
            delay_from(name, delay, 0.0)


@dataclass(frozen=True, eq=False)
class TeamTrial(Checked):
    """
    How a run of a team is made: its time steps, its start, and what is recorded.

    Parameters
    ----------
    sample_time : float
        Step of the midpoint rule [s].
    record_every : float, optional
        Time between recorded rows [s], a multiple of `sample_time`; some 0.01 s when not given.
    tolerance : float
        Distance to the goal that counts as arrived [m].
    start : array_like, shape (N, 3), optional
        Where robots begin [m]; drawn within 5 m of the origin when not given.
    require_connected : bool
        Refuse a graph in several parts, or without a spanning tree.

    Raises
    ------
    ValueError
        If an argument is not understood.
    """

    sample_time: Annotated[float, (1e-6, 0.1)] = 1e-3
    record_every: Positive | None = None
    tolerance: Positive = 1e-3
    start: np.ndarray | None = None
    require_connected: bool = True

    def __post_init__(self):
        super().__post_init__()
        if self.start is not None:
            set_checked(self, finite_numbers, "start")

    @property
    def samples_per_row(self) -> int:
        """How many samples a recorded row stands for."""
        T = self.sample_time
        interval = self.record_every or max(T, 0.01)
        every = max(round(interval / T), 1)
        if self.record_every and abs(every * T - interval) > 1e-6 * interval:
            raise ValueError(
                f"record_every must be a multiple of sample_time = {T:g} s, got {interval:g}"
            )
        return every


@dataclass(frozen=True)
class TeamRobot(Checked):
    """
    What one robot makes of (4.22): a faultless one by default.

    Slow robots and lost packets leave the team passive: Lemmas 6 and 7 and Theorem 6 hold, with V_e
    in which a robot of speed s counts 1/s times. A robot that drifts is a source of energy; nothing
    is promised with one in the team.

    Parameters
    ----------
    speed : float
        s in (0, 1], by which the right sides of (4.22) are multiplied: a robot of speed 0.1 does in
        ten seconds what others do in one. As a leader it reports s times the force.
    drift : float
        Root mean square, on each axis, of a velocity that it has besides [m/s]: at random, and
        forgotten within some 5 s.
    loss : float
        Probability that a packet to it or from it does not arrive while it leads; 1 is deaf.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    speed: Annotated[float, (1e-9, 1.0)] = 1.0
    drift: NotNegative = 0.0
    loss: Share = 0.0


SCATTERING = Scattering(2.0, beta_min=0.5, beta_max=1.0)
TRUST = TrustModel(0.1, 0.1)
# Settings that may differ from robot to robot, and their classes.
PER_ROBOT: dict[str, Any] = {"robots": TeamRobot, "scattering": Scattering}


@dataclass(frozen=True)
class TeamSettings(Checked):
    """
    Settings of the blocks of Fig. 4.1 other than the graph. Chapter 4 prints no numbers; these are
    ours.

    What limits a large team is (4.22): a velocity r_s of the leader moves the mean of N robots by
    r_s/N only, and what the leader knows spreads along the slow eigenvectors of L. Three gains
    answer to that: ζ̇ = −c L q, q̇ = c Lᵀζ − c L q + g D r_s and f_s = φ c DᵀL q, with the coupling
    c, the leader's gain g and the force's gain φ. For any positive three the port stays passive,
    with V_fs φ/g and V_e/g as storages, so that Lemmas 6 and 7 and Theorem 6 hold as before. See
    `scaled`.

    Parameters
    ----------
    mass, damping, stiffness, weight : float
        M [kg], B [N s/m], K [N/m] and Λ [1/s] of the haptic device, the same on all axes (4.6).
    scattering : Scattering or sequence of Scattering
        b and the bounds of β (4.3), one for all robots or one per robot; α is 1 in Chapter 4.
    human_to_robot, robot_to_human : TrustModel
        (4.1) and (4.2), the same for all robots; performance between 0 and 1.
    robots : TeamRobot or sequence of TeamRobot
        How well robots do what they should, one for all or one per robot.
    steepness : float
        s of the scaling β(T_rh), as in (3.5); at least 10.
    performance_time : float
        How long a performance at random lasts before it is drawn anew, on average [s].
    lead_gain : float
        g, how many times the velocity at its port the leader drives; 1 as printed.
    force_gain : float
        φ, share of the force between the leader and those it sees that the operator feels; 1 as
        printed.
    coupling : float
        c, by which every a_ij is multiplied; 1 as printed.
    channel : TeamChannel
        Delays and filters.
    min_dwell : float, optional
        τ_min [s], how long every leader leads at least, greater than the delay; 5 T, at least 5 s,
        when not given.

    Raises
    ------
    PassivityError
        If the device is too heavy to be r-passive.
    ValueError
        If a setting is out of range.
    """

    mass: float = 0.5
    damping: float = 5.5
    stiffness: float = 20.0
    weight: float = 10.0
    scattering: Scattering | tuple[Scattering, ...] = SCATTERING
    human_to_robot: TrustModel = TRUST
    robot_to_human: TrustModel = TRUST
    robots: TeamRobot | tuple[TeamRobot, ...] = TeamRobot()
    steepness: Annotated[float, (10.0, 1e6)] = 10.0
    performance_time: Positive = 15.0
    lead_gain: Positive = 1.0
    force_gain: Positive = 1.0
    coupling: Positive = 1.0
    channel: TeamChannel = TeamChannel()
    min_dwell: Positive | None = None

    def __post_init__(self):
        super().__post_init__()
        for name, kind in PER_ROBOT.items():
            value = getattr(self, name)
            if np.iterable(value):
                value = tuple(value)
                object.__setattr__(self, name, value)
            for entry in value if isinstance(value, tuple) else [value]:
                of_class(name, entry, kind)
                if kind is Scattering and (entry.alpha_min, entry.alpha_max) != (1.0, 1.0):
                    raise ValueError(f"{name}: α is 1 in Chapter 4, got {entry}")
        for name in ("human_to_robot", "robot_to_human"):
            model = getattr(self, name)
            if (model.p_min, model.p_max) != (0.0, 1.0):
                raise ValueError(f"{name}: performance lies between 0 and 1 here, got {model}")
        HapticDevice(self.mass, self.damping, self.stiffness, self.weight)  # refused if not passive

    @classmethod
    def scaled(cls, graph, within: float = 200.0) -> "TeamSettings":
        """
        Return settings whose gains bring a team to its goal within a given time, whatever its size.

        A leader that is held at the goal draws the others there at the least eigenvalue μ of c L
        without the leader's row and column, and (4.22) at half of that. 1/μ is at most the sum of
        the effective resistances to the leader, N L⁺_ii + tr L⁺, over c: it grows as N on graphs
        with short paths (small worlds, random graphs), as N² on a ring. The coupling c makes this
        bound within/12; the leader's gain is g = min(N, 2 c d), with the least degree d, so that it
        moves the mean and yet runs only metres ahead; the force's gain is 1/g. Enough in simulation
        on rings, paths, complete graphs and small worlds of 4 to 1,000 robots. A ring of 1,000 gets
        a coupling above a thousand per second, more than robots can follow: no law that moves by
        differences to neighbours alone is quick there, and shortcuts are the remedy.

        Parameters
        ----------
        graph : networkx.Graph or array_like, shape (N, N)
            As in `team_graph`, undirected and connected.
        within : float
            Time to the goal [s].

        Raises
        ------
        GraphError
            If the graph is directed or not connected.
        """
        adjacency = team_graph(graph)[1]
        if (adjacency != adjacency.T).any():
            raise GraphError(
                "gains are known for undirected graphs only: give lead_gain, force_gain and "
                "coupling"
            )
        size, within = len(adjacency), positive("within", within)
        inverse = np.linalg.pinv(laplacian(adjacency), hermitian=True)
        slowest = size * inverse.diagonal().max() + np.trace(inverse)
        coupling = 12.0 / within * slowest
        gain = min(float(size), 2.0 * coupling * adjacency.sum(axis=1).min())
        return cls(coupling=coupling, lead_gain=gain, force_gain=1.0 / gain)

    def per_robot(self, count: int) -> list[tuple]:
        """
        Return what may differ of each robot: what it makes of (4.22), and scattering.

        Parameters
        ----------
        count : int
            How many robots there are.

        Raises
        ------
        ValueError
            If there are entries for another number of robots.
        """
        columns = []
        for name in PER_ROBOT:
            value = getattr(self, name)
            entries = value if isinstance(value, tuple) else (value,) * count
            if len(entries) != count:
                raise ValueError(f"{name} has {len(entries)} entries for {count} robots")
            columns.append(entries)
        return list(zip(*columns, strict=True))


@dataclass(frozen=True)
class TeamOperator(Checked):
    """
    A simulated operator: the hand pushes towards where the goal is seen from the leader, within an
    energy budget.

    f_h = σ κ e − d r_m with e = r_q − y_h(t − T), κ = push, ‖κ e‖ cut at `reach`, d = drag. V_h of
    (4.30) is observed, and the share σ ∈ [0, 1] is the greatest with which the hand leaves V_h ≥
    −β_h + reserve. A hand that pushes needs energy, which the budget holds; one that is dragged
    stores some. No control law of the hand can guarantee more, because it does not control r_s(t −
    T)ᵀe, for which the reserve is kept. The run reports whether V_h ≥ −β_h held.

    Parameters
    ----------
    push : float
        κ [N/m]; 0 is a hand that only holds on.
    reach : float
        Greatest force [N].
    drag : float
        d [N s/m].
    budget : float
        β_h in units of V_e(0) + 1 J (V_e as for g = 1 where g is greater), as teams that start far
        from the goal, or are slow, need more.
    reserve : float
        Share of β_h that pushing does not use.
    guarded : bool
        Observe V_h and scale; without it V_h is only logged.
    cautious : float
        κ_T [1/s]: over a delay T people push less, κ/(1 + κ_T T); 0 is a hand that does not.
    grip : float
        Of a live hand, which pulls the device to a place [N/m].

    Raises
    ------
    ValueError
        If a number is not finite or out of range.
    """

    push: NotNegative = 4.0
    reach: Positive = 6.0
    drag: float = 1.0
    budget: Positive = 4.0
    reserve: Annotated[float, (0.0, 0.999)] = 0.5
    guarded: bool = True
    cautious: NotNegative = 2.0
    grip: NotNegative = 100.0

    def __post_init__(self):
        super().__post_init__()
        # a hand that drives (negative drag) is active: allowed only where nothing is promised of
        # V_h
        if self.guarded:
            not_negative("drag", self.drag)

    def stiffness(self, delay: float) -> float:
        """
        Return κ [N/m] over a delay.

        Parameters
        ----------
        delay : float
            How old pictures are [s].
        """
        return self.push / (1.0 + self.cautious * delay)
