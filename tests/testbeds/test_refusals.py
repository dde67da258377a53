"""
What simulated tasks refuse: ranges, and arguments that do not go together.
What tests/test_contract.py puts into every argument is not tried here again.
"""

import inspect
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest

import trustlab as tl
from tests.teams import simulate_team
from trustlab.operators.answers import experience, simulated_answers
from trustlab.teleoperation import STUDIES, packet_delay
from trustlab.teleoperation.ports.device import PassivityError
from trustlab.testbeds import Pioneer, RobotTeam, published_operator, tracking_vehicle

PATH = nx.path_graph(3)
UNIT, NONE = np.eye(6), np.zeros((6, 3))


@pytest.mark.parametrize(
    ("graph", "words"),
    [
        (nx.Graph([("a", "b"), ("c", "d")]), "not connected.*{'a', 'b'}; {'c', 'd'}"),
        (nx.MultiGraph([(0, 1), (0, 1)]), "parallel"),
        (nx.Graph(), "two robots"),
        ([(3.0, PATH)], "dict from time"),
        ({0.0: PATH, -1.0: PATH}, "must be 0 and others after 0"),
        ({0.0: PATH, 3.0: np.zeros((2, 3))}, "from t = 3 s on: graph must be"),
    ],
)
def test_graphs(graph, words):
    with pytest.raises(ValueError, match=words):
        simulate_team(graph, duration=10.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"delay": (0.2, 1e9)}, "longer than the run"),
        ({"start": np.zeros((5, 3))}, "start must have shape"),
        ({"duration": 1e5, "sample_time": 1e-3}, "duration must lie in"),
    ],
)
def test_teams(change, words):
    with pytest.raises(ValueError, match=words):
        simulate_team(PATH, **({"duration": 10.0} | change))
    with pytest.raises(ValueError, match="an assumption must be one of"):
        RobotTeam().people(2, {"patience": 1.0})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"duration": -1.0}, "duration must lie in"),
        ({"delay": (0.0, 0.1)}, "delay to the robot.* at least one sample"),
        ({"signals": {"push": np.full((12000, 3), np.nan)}}, "push .* but sample 0 is"),
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
def test_vehicles(matrices):
    with pytest.raises(ValueError, match="vehicle must be finite matrices"):
        tl.TrackingTask(vehicle=matrices)


def test_devices_and_robots():
    with pytest.raises(PassivityError, match="not r-passive"):
        replace(STUDIES["main"], mass=1.0, weight=60.0)
    with pytest.raises(ValueError, match="must be of class TrustModel"):
        replace(STUDIES["main"], human_to_robot=1.0)
    with pytest.raises(ValueError, match="max_speed must be positive"):
        Pioneer(max_speed=0.0)


RUN = tl.simulate_teleoperation(duration=1.0)
CALLS = (
    (tl.simulate_teleoperation, {"duration": 1.0}),
    (tl.TeleoperationLoop, {"duration": 1.0}),
    (simulated_answers, {"session": RUN}),
    (experience, {"session": RUN}),
    (tl.TrackingTask, {}),
    (tl.Teleoperator, {}),
    (tl.OptimalBlending, {}),
    (tracking_vehicle, {}),
)


@pytest.mark.parametrize(
    ("call", "good", "name"),
    [
        (call, good, name)
        for call, good in CALLS
        for name in inspect.signature(call).parameters
        if name != "options"
    ],
)
def test_nothing_but_a_clear_error_comes_of_nonsense(call, good, name):
    for bad in (np.inf, b"x", True, 1j, np.array(["a"])):  # no values of tests/contract.py
        with pytest.raises(ValueError, match=r"\w+ \w+"):
            call(**(good | {name: bad}))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"thresholds": (0.6, 0.1)}, "the lower threshold must be below the upper threshold"),
        ({"condition": "C5", "thresholds": (0.1, 0.6)}, "no effect in C5, where Algorithm 2"),
        ({"participant": None}, "who drives"),
        ({"condition": None}, "condition must be one of .*or rule="),
        ({"r0": 2.0, "testbed": "uav_following"}, "r0 must lie in"),
        ({"testbed": "uav_tracking"}, "testbed must be one of 'ground_robot', 'uav_following'"),
        ({"testbed": "uav_following", "participant": 21}, "from 1 to 20, got 21"),
        ({"participant": published_operator(2)}, "model must be of class TscModel"),
    ],
)
def test_conditions(arguments, words):
    with pytest.raises(ValueError, match=words):
        tl.run_condition(**({"condition": "C3", "participant": 2} | arguments))
