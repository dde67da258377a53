"""
What simulated tasks refuse: arguments that do not go together.
What tests/test_contract.py puts into every argument is not tried here again.
"""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

import trustlab as tl
from tests.loops import simulate_team
from trustlab.teleoperation import STUDIES, PassivityError, packet_delay
from trustlab.testbeds import published_operator

PATH = nx.path_graph(3)
UNIT, NONE = np.eye(6), np.zeros((6, 3))


def endless(k):
    """Decisions of one sample alone, which are infinite."""
    alpha = np.full(12000, np.nan)
    alpha[k] = np.inf
    return alpha


@pytest.mark.parametrize(
    ("graph", "options", "words"),
    [
        (nx.Graph([("a", "b"), ("c", "d")]), {}, r"parts are \['a', 'b'\]; \['c', 'd'\]"),
        ({0.0: PATH, 5.0: nx.empty_graph(3)}, {}, r"from t = 5 s on: .*parts are \[0\]; \[1\]"),
        (nx.MultiGraph([(0, 1), (0, 1)]), {}, "parallel edges"),
        (nx.DiGraph([(0, 1), (0, 2)]), {}, "it has no spanning tree"),
        (np.array([[0.0, -1.0], [-1.0, 0.0]]), {}, "from 0 to 1 it is -1.0"),
        ({0.0: PATH, -1.0: PATH}, {}, "must be 0 and others after 0"),
        (PATH, {"delay": (0.2, 1e9)}, "longer than the run"),
        (PATH, {"start": np.zeros((5, 3))}, "start must have shape"),
        (PATH, {"record_every": 0.0015}, "must be a multiple of sample_time"),
        (PATH, {"delay": 0.5, "min_dwell": 0.2}, "must be greater than the delay"),
    ],
)
def test_teams(graph, options, words):
    with pytest.raises(ValueError, match=words):
        simulate_team(graph, **{"duration": 10.0} | options)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"delay": (0.0, 0.1)}, "delay to the robot.* at least one sample"),
        ({"signals": {"push": np.full((12000, 3), np.nan)}}, "push .* but sample 0 is"),
        ({"signals": {"alpha": endless(50)}}, "alpha .* but sample 50 is inf"),
        (
            {"delay": (packet_delay([100.0, 130.0], [100.1, 130.1]), 0.1), "duration": 5.0},
            "the trace begins at 100 s, after the end of the run: give seconds from the start",
        ),
        (
            {"delay": (packet_delay([0.0, 0.1], [0.1, 0.2]), 0.1), "duration": 5.0},
            "delay to the robot: .*until 0.2 s, and the run lasts until",
        ),
        (
            {"scheme": "OMI", "task": tl.TrackingTask(vehicle=lambda state: (state.robot, NONE))},
            "three TransferFunction",
        ),
    ],
)
def test_flights(arguments, words):
    with pytest.raises(ValueError, match=words):
        tl.simulate_teleoperation(**arguments)


@pytest.mark.parametrize("matrices", [(UNIT, NONE[:, :2], UNIT), (np.nan * UNIT, NONE, UNIT)])
def test_vehicles_and_devices(matrices):
    with pytest.raises(ValueError, match=r"vehicle must be (finite|matrices)"):
        tl.TrackingTask(vehicle=matrices)
    with pytest.raises(PassivityError, match="not r-passive"):
        replace(STUDIES["main"], mass=1.0, weight=60.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"condition": "C5", "thresholds": (0.1, 0.6)}, "no effect in C5, where"),
        ({"participant": None}, "who drives"),
        ({"condition": None}, "condition must be one of .*or rule="),
        ({"testbed": "uav_tracking"}, "testbed must be one of 'ground_robot', 'uav_following'"),
        ({"testbed": "uav_following", "participant": 21}, "from 1 to 20, got 21"),
        ({"participant": published_operator(2)}, "model must be of class TscModel"),
    ],
)
def test_conditions(arguments, words):
    with pytest.raises(ValueError, match=words):
        tl.run_condition(**({"condition": "C3", "participant": 2} | arguments))
