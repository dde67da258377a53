"""
Over real DDS, on this machine alone: the node by rclpy, the robot by ir-sim and rclpy, or by
Cyclone DDS in a process without ROS and without the package, the oracle of what was sent.
"""

import random
import signal
import time

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.ros.driving import EXAMPLE, MISSING, PEER, driven, processes, run_for_peer
from trustlab.ros import read_run

pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=f"needs ROS 2: {MISSING}"),
    pytest.mark.xdist_group("dds"),
]
V_MAX = 0.5
V_RATE = 1.0


def log_of(path):
    return pd.read_csv(path, names=["t", "v", "w", "delay", "stamp"])


def agree(result):
    assert result.verified
    session = tl.read_session(result.path)
    assert session == tl.read_session(result.path.with_suffix(".csv")) == result.session


def test_a_robot_of_another_vendor_is_driven(tmp_path):
    log = tmp_path / "robot.csv"
    peer = [PEER, "robot,operator", 120, log]
    result = driven(tmp_path, peer, run_for_peer(tmp_path), 7)
    agree(result)
    robot = log_of(log)
    assert robot["v"].max() == pytest.approx(0.4)
    assert (robot["v"].abs() <= V_MAX).all()
    assert robot["v"].iloc[-1] == 0.0  # a run that ends stops the robot
    # what the robot did is what was decided, bit for bit and in this order
    applied = robot["v"][(robot["v"] != 0.0) & (robot["v"].diff() != 0.0)]
    decided = iter(result.decisions["v"])
    assert len(applied) > 5
    assert all(v in decided for v in applied)
    assert len(result.session) >= 80


def test_a_run_without_a_session_fails(tmp_path):
    with processes(tmp_path) as start:
        for duration, code in ((1, 1), ("nan", 2)):
            node = start("-m", "trustlab.ros", run_for_peer(tmp_path), "--duration", duration)
            assert node.wait(120) == code
    said = (tmp_path / "0.log").read_text()
    assert "never heard: odometry" in said
    assert "Traceback" not in said
    assert "--duration must be positive, got nan" in (tmp_path / "1.log").read_text()


@pytest.mark.long
def test_the_robot_of_the_guide_is_driven_and_changes_hands(tmp_path):
    robot = [EXAMPLE / "simulated_robot.py"]
    result = driven(tmp_path, robot, EXAMPLE / "run.toml", 50)
    agree(result)
    assert set(result.session["mode"]) == {0.0, 1.0}
    assert result.session.duration > 40.0


@pytest.mark.long
def test_a_stop_is_with_the_robot_within_a_tenth_of_a_second(tmp_path):
    stops = tmp_path / "stops.csv"
    peer = [PEER, "robot,operator,stop", 60, tmp_path / "robot.csv", stops]
    assert driven(tmp_path, peer, run_for_peer(tmp_path), 20).verified
    seconds = np.loadtxt(stops)
    assert len(seconds) >= 4
    assert seconds.max() < 0.1


@pytest.mark.long
def test_no_phase_of_a_hostile_robot_leads_outside_the_bounds(tmp_path):
    """Thirty-two faults, half a second each; oracle: every command as another vendor got it."""
    log, commands = tmp_path / "robot.csv", tmp_path / "commands.csv"
    result = driven(tmp_path, [PEER, "hostile", 60, log, commands], run_for_peer(tmp_path), 26)
    assert result.verified
    phases = pd.read_csv(log, names=["t", "v", "w", "topic", "fault"], keep_default_na=False)
    assert phases.loc[phases["topic"] != "", ["topic", "fault"]].drop_duplicates().shape[0] == 32
    got = pd.read_csv(commands, names=["t", "v", "w"])
    assert len(got) > 400
    assert np.isfinite(got[["v", "w"]]).all().all()
    assert (got["v"].abs() <= V_MAX).all()
    assert (got["w"].abs() <= 1.0).all()
    change = got["v"].diff().abs().iloc[1:]
    assert (change[got["v"].iloc[1:] != 0.0] <= V_RATE * 0.05 + 1e-9).all()
    notes = result.session.metadata.more["notes"]
    assert len(notes) < 700, "notes of one kind are counted"
    assert any("in frame 'moon'" in note for note in notes)


@pytest.mark.long
def test_twenty_kills(tmp_path):
    draw = random.Random(0)
    for k in range(20):
        folder = tmp_path / str(k)
        folder.mkdir()
        with processes(folder) as start:
            killed_at_random(folder, start, draw)


def killed_at_random(folder, start, draw):
    victim = draw.choice(["robot", "operator", "node"])
    log = folder / "robot.csv"
    running = {
        "robot": start(PEER, "robot", 60, log),
        "operator": start(PEER, "operator", 60, folder / "operator.csv"),
        "node": start("-m", "trustlab.ros", run_for_peer(folder), "--duration", 60),
    }
    wait_for_motion(log)
    time.sleep(draw.uniform(0.0, 1.5))
    running[victim].kill()
    running[victim].wait()  # until its threads are gone, which a busy machine takes time for
    killed = time.monotonic()
    time.sleep(2.0)
    if victim == "node":
        (left,) = (folder / "runs").glob("*.jsonl")
        result = read_run(left)
        assert result.session.metadata.more["interrupted"]
        done = set(log_of(log)["v"]) - set(result.decisions["v"])
        assert len(done) <= 1  # nothing was done that is not recorded, but one on its way
    else:
        running["node"].send_signal(signal.SIGTERM)
        assert running["node"].wait(30) == 0
        (bag,) = (folder / "runs").glob("*.mcap")
        result = read_run(bag)
    assert result.verified
    assert len(result.session) > 2
    if victim == "robot":
        assert (result.decisions["v"].tail(5) == 0.0).all()
    else:
        robot = log_of(log)
        rest = robot[robot["t"] > killed + 0.5 + V_MAX / V_RATE + 0.2]
        assert len(rest) > 5
        assert (rest["v"] == 0.0).all()


def wait_for_motion(log, timeout=60.0):
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if log.exists() and log.stat().st_size and log_of(log)["v"].max() > 0.2:
            return
        time.sleep(0.05)
    raise TimeoutError
