"""
What the parts of a teleoperation loop and simulated tasks refuse: arguments that do not go
together. What tests/test_contract.py puts into every argument is not tried here again.
"""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

import trustlab as tl
from tests.cases import drive, driver, refused
from tests.loops import simulate_team
from trustlab import TrackingTask, channel_run, run_condition
from trustlab.teleoperation import (
    STUDIES,
    GivenSequence,
    Guidance,
    GuidanceBudget,
    TwoPortFilter,
    packet_delay,
    passivity_margin,
)

ONES = np.ones((50, 1))
PATH = nx.path_graph(3)
UNIT, NONE = np.eye(6), np.zeros((6, 3))


def fly(**arguments):
    return tl.simulate_teleoperation(**{"duration": 5.0} | arguments)


def late_from(start):
    """A trace of two packets as the delay to the robot."""
    return packet_delay([start, start + 0.1], [start + 0.1, start + 0.2]), 0.1


REFUSED = [
    (lambda: tl.Scattering(1.0, alpha_min=0.9, alpha_max=0.3), "must not exceed alpha_max"),
    (lambda: channel_run(ONES, ONES, tl.Scattering(1.0), 0.01, alpha=1.5), "alpha must lie in"),
    (lambda: fly(delay=lambda t: 0.1 + 0.9 * t), "grows faster than max_rate = 0.5"),
    (lambda: packet_delay([0.0, 0.1], [0.1, 0.05]).samples(7, 0.1), "packet 1, sent at t = 0.1"),
    (lambda: TwoPortFilter(1.0, 0.2, 1.0), r"k_12 k_21 = 0\.2"),
    (lambda: passivity_margin([1.0], [1.0, -1.0]), "stable"),
    (lambda: tl.passivity(drive().session), "no column 'r_m_x'"),
    (lambda: passivity_margin([1.0, 0.0, 0.0], [1.0, 1.0]), "proper"),
    (lambda: fly(delay=(0.0, 0.1)), "delay to the robot.* at least one sample"),
    (
        lambda: fly(delay=late_from(100.0)),
        "arrives at 100.1 s, after the end of the run",
    ),
    (lambda: fly(delay=late_from(0.0)), "delay to the robot: .*until 0.2 s, and the run lasts"),
    (
        lambda: fly(signals={"push": np.full((500, 3), np.nan)}),
        "push .* but sample 0 is",
    ),
    (
        lambda: fly(scheme="OMI", task=TrackingTask(vehicle=lambda state: (state.robot, NONE))),
        "three TransferFunction",
    ),
    (lambda: TrackingTask(vehicle=(UNIT, NONE[:, :2], UNIT)), "vehicle must be matrices"),
    (lambda: TrackingTask(vehicle=(np.nan * UNIT, NONE, UNIT)), "vehicle must be finite"),
    (lambda: TrackingTask(autonomy=np.copy, reach=1.0), "reach would do nothing beside a con"),
    (
        lambda: tl.Teleoperator(law=np.copy, adaptation=0.9),
        "adaptation would do nothing beside a law of one's own",
    ),
    (lambda: Guidance(guard="off", budget=GuidanceBudget(1.0)), "under a guard, got .* 'off'"),
    (lambda: fly(scheme="MI", guidance=Guidance(force=np.copy)), "force would do nothing in .* MI"),
    (
        lambda: fly(scheme="MI", signals={"arrives": np.ones((500, 2))}),
        "arrives would do nothing in scheme MI: no force comes back",
    ),
    (lambda: fly(signals={"trust_hr": np.full(500, 62.0)}), r"trust_hr must lie in \[0, 1\]"),
    (lambda: fly(trust=tl.trust.MODELS["beta"]), "trust must be a function, got <class"),
    (lambda: replace(STUDIES["main"], mass=1.0, weight=60.0), "not r-passive"),
    (
        lambda: simulate_team({0.0: PATH, 5.0: nx.empty_graph(3)}, duration=10.0),
        r"from t = 5 s on: .*parts are \[0\]; \[1\]",
    ),
    (
        lambda: simulate_team({0.0: PATH, 100.0: nx.cycle_graph(3)}, duration=20.0),
        "from t = 100 s on would do nothing in a run of 20 s",
    ),
    (lambda: simulate_team(nx.MultiGraph([(0, 1), (0, 1)])), "parallel edges"),
    (lambda: simulate_team(nx.DiGraph([(0, 1), (0, 2)])), "it has no spanning tree"),
    (lambda: simulate_team(np.array([[0.0, -1.0], [-1.0, 0.0]])), "from 0 to 1 it is -1.0"),
    (lambda: simulate_team(PATH, GivenSequence(["z", 0])), "'z', which does not exist"),
    (lambda: simulate_team(PATH, record_every=0.0015), "must be a multiple of sample_time"),
    (lambda: simulate_team(PATH, delay=0.5, min_dwell=0.2), "must be greater than the delay"),
    (lambda: run_condition("C5", 2, thresholds=(0.1, 0.6)), "no effect in C5, where"),
    (lambda: run_condition("C3"), "who drives"),
    (
        lambda: tl.Operator("me", tl.HumanModel(0.999, 0.7, 0.4, 1.2)),
        "between 0.1 and 1, but human has p_min = 0.4 and p_max = 1.2",
    ),
    (
        lambda: tl.testbeds.Course(((0, 0), (4, 0), (4, 4), (0, 4)), radius=2.5),
        "corner 0 is 4 m long, but its bends of radius 2.5 m take 5 m",
    ),
    (lambda: run_condition("C3", 21, testbed="uav_following"), "from 1 to 20, got 21"),
    (lambda: run_condition("C3", driver()), "model must be of class TscModel"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=[words[:30] for _, words in REFUSED])
def test_what_does_not_go_together_is_refused(call, words):
    with refused(words):
        call()
