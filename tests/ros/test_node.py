"""The node on a stand-in for rclpy with the test's clock; oracles: rosbags alone, the bounds."""

import math
import re
import shutil
import struct
import sys
import time
from dataclasses import replace
from datetime import date
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.highlevel import AnyReader

import trustlab as tl
from tests.ros import fake_ros
from trustlab.live.log import Log, read_log
from trustlab.ros import (
    Allocation,
    CoreSettings,
    RunSettings,
    Topic,
    measures_table,
    read_run,
    read_toml,
)
from trustlab.ros.__main__ import main, recover
from trustlab.ros.node import Recorder
from trustlab.ros.recorded import log_entry
from trustlab.ros.run import RUN
from trustlab.sessions.errors import SessionError

MODEL = tl.published_models()["1"]
STEP = 50_000_000
SHORT = CoreSettings(window=2.0)
MCAP = rosbag2.StoragePlugin.MCAP
TWIST = "geometry_msgs/msg/Twist"
JOY = "sensor_msgs/msg/Joy"


class Always:
    """A rule that always says the same."""

    def step(self, tsc, p_r):
        return 0


class Broken:
    """A rule that fails once the robot has moved."""

    def step(self, tsc, p_r):
        if p_r > 0.1:
            raise RuntimeError("no idea")


def test_a_recorder_ends_though_a_message_comes_behind_its_end(tmp_path):
    """As of a callback that another thread runs while the node finishes."""
    recorder = Recorder(tmp_path / "a.jsonl", print)
    entered, go_on, append = Event(), Event(), recorder.log.append

    def slow(entries):
        entered.set()
        go_on.wait(10.0)
        append(entries)

    recorder.log.append = slow
    recorder.write("/a", 1, b"x")
    assert entered.wait(10.0)
    recorder.queue.put(None)
    recorder.write("/a", 2, b"y")
    go_on.set()
    recorder.thread.join(5.0)
    assert not recorder.thread.is_alive()
    assert [entry[1] for entry in read_log(recorder.log.path).entries] == [1, 2]


class Half:
    """A rule that blends both commands in equal parts."""

    def step(self, tsc, p_r):
        return 0.5


@pytest.fixture
def node(monkeypatch):
    fake_ros.install(monkeypatch)
    node = fake_ros.Node()
    monkeypatch.setattr("trustlab.ros.node.monotonic_ns", lambda: node.time)
    return node


def inputs(node, rng, x, skip=(), stamp=None):
    """One round of messages, odometry last as it brings about the step."""
    twists = {"/operator/cmd_vel": 0.5, "/autonomy/cmd_vel": 0.3}
    for topic, most in twists.items():
        if topic not in skip:
            node.send(topic, TWIST, linear__x=rng.uniform(0, most), angular__z=rng.normal())
    if "/path_error" not in skip:
        node.send("/path_error", "std_msgs/msg/Float64", data=abs(rng.normal(scale=0.3)))
    if "/odom" not in skip:
        stamp = node.time - 1_000_000 if stamp is None else stamp
        node.send("/odom", "nav_msgs/msg/Odometry", stamp, pose__pose__position__x=x)


def driven(node, run, path, steps=200, seed=0):
    allocation = Allocation(node, run, path)
    rng = np.random.default_rng(seed)
    x = 0.0
    for _ in range(steps):
        node.time += STEP
        x += rng.uniform(0.0, 0.03)
        inputs(node, rng, x)
        node.tick()
    return allocation


def by_rosbags(path, topics):
    """Columns of a bag, read by rosbags alone."""
    columns = {topic: [] for topic in topics}
    with AnyReader([path], default_typestore=fake_ros.STORE) as reader:
        for connection, _, data in reader.messages():
            if connection.topic in columns:
                message = reader.deserialize(data, connection.msgtype)
                columns[connection.topic].append(message)
    return columns


def test_a_run_leaves_a_bag_and_a_session_that_agree(node, tmp_path):
    run = RunSettings(
        MODEL, "C3", (-0.2, 0.3), settings=SHORT, facts={"participant": 3, "synthetic": True}
    )
    result = driven(node, run, tmp_path / "a.mcap").finish()
    assert result.verified
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".csv", ".mcap"]
    session = tl.read_session(tmp_path / "a.mcap")
    assert session == result.session == tl.read_session(tmp_path / "a.csv")
    assert len(session) == 200
    assert session.metadata.participant == 3
    assert session.metadata.more["interrupted"] is False
    again = session.with_performance(window=2.0)
    assert again["p_r"] == pytest.approx(session["p_r"], abs=1e-12)
    columns = by_rosbags(
        tmp_path / "a.mcap", ["/trustlab/tsc", "/cmd_vel", "/odom", "/allocation/mode"]
    )
    assert [m.data for m in columns["/trustlab/tsc"]] == session["tsc"].tolist()
    assert [m.data for m in columns["/allocation/mode"]] == session["mode"].tolist()
    assert set(session["mode"]) == {0.0, 1.0}
    sent = [(m.linear.x, m.angular.z) for m in node.sent["/cmd_vel"]]
    assert [(m.linear.x, m.angular.z) for m in columns["/cmd_vel"]] == sent[:-1]
    assert sent[-1] == (0.0, 0.0)  # the last word of a run that ends
    assert len(columns["/odom"]) == 200
    assert result.decisions[["v", "w"]].to_numpy().tolist() == [list(pair) for pair in sent[:-1]]


FAULTS = {
    "lost": "messages lost",
    "repeated": "odometry: repeated",
    "reordered": "odometry: out of order",
    "NaN": "operator: not a finite value",
    "late": "odometry: late by",
    "sixty": "odometry: out of order",
}


def faulty(node, rng, x, fault):
    """One round of messages with faults of a kind."""
    stamp = node.time - 1_000_000
    if fault == "late":
        inputs(node, rng, x, stamp=stamp - 700_000_000)
        return
    topics = ["/operator/cmd_vel", "/autonomy/cmd_vel", "/path_error", "/odom"]
    inputs(node, rng, x, skip=topics if fault == "lost" else ())
    if fault == "repeated":
        inputs(node, rng, x, skip=["/path_error"], stamp=stamp)
    elif fault == "sixty":
        for _ in range(60):
            inputs(node, rng, x, stamp=stamp - STEP // 2)
    elif fault == "reordered":
        inputs(node, rng, x, stamp=stamp - 2 * STEP)
    elif fault == "NaN":
        value = rng.choice([math.nan, math.inf, -math.inf, 1e300])
        node.send("/operator/cmd_vel", TWIST, linear__x=value)
        node.send("/path_error", "std_msgs/msg/Float64", data=value)
        node.send("/odom", "nav_msgs/msg/Odometry", node.time, pose__pose__position__x=value)


def test_no_fault_leads_outside_the_bounds_and_each_is_named(node, tmp_path):
    run = RunSettings(MODEL, rule=Always(), settings=SHORT)
    allocation = Allocation(node, run, tmp_path / "a.mcap")
    rng = np.random.default_rng(1)
    faults = [*FAULTS, *[""] * 5]
    for k in range(600):
        node.time += STEP
        # none at all for longer than a watchdog waits, then one after another
        fault = faults[k // 15] if k < 165 else faults[rng.integers(len(faults))]
        faulty(node, rng, 0.01 * k, fault)
        node.tick()
    result = allocation.finish()
    sent = np.array([(m.linear.x, m.angular.z) for m in node.sent["/cmd_vel"]])[:-1]
    assert (np.abs(sent) <= [SHORT.v_max, SHORT.w_max]).all()
    rates = np.abs(np.diff(sent, axis=0)) / SHORT.period
    assert (rates <= [SHORT.v_rate + 1e-9, SHORT.w_rate + 1e-9]).all()
    notes = result.session.metadata.more["notes"]
    assert len(notes) < 700, "notes of one kind are counted"
    for note in FAULTS.values():
        assert any(note in line for line in notes), note
        assert any(note in line for line in node.log), note
    assert result.verified


def test_a_rule_without_a_name_is_needed_again_for_a_replay(node, tmp_path):
    run = RunSettings(MODEL, rule=Always(), settings=SHORT)
    assert driven(node, run, tmp_path / "a.mcap", 60).finish().verified
    with pytest.raises(ValueError, match="needs one of these"):
        read_run(tmp_path / "a.mcap")
    named = RunSettings(MODEL, rule="tests.ros.test_node:Always", settings=SHORT)
    assert driven(node, named, tmp_path / "b.mcap", 60).finish().verified
    with pytest.raises(SessionError, match="test_node:Always'; if you trust it, say own_rules"):
        read_run(tmp_path / "b.mcap")  # a stranger's bag calls nothing
    again = read_run(tmp_path / "b.mcap", own_rules=True)
    assert again.verified
    assert again.run == named


@pytest.mark.parametrize("cuts", [8, pytest.param(20, marks=pytest.mark.long)])
def test_cuts_leave_what_was_written_before(node, tmp_path, cuts):
    run = RunSettings(MODEL, "C3", (-0.2, 0.3), settings=SHORT)
    allocation = driven(node, run, tmp_path / "a.mcap", 50)
    whole = allocation.core.session()
    allocation.recorder.close()
    content = (tmp_path / "a.jsonl").read_bytes()
    rng = np.random.default_rng(0)
    for cut in rng.integers(len(content) // 5, len(content), cuts):
        (tmp_path / "cut.jsonl").write_bytes(content[:cut])
        result = read_run(tmp_path / "cut.jsonl")
        assert result.verified
        assert result.session.metadata.more["interrupted"] is True
        count = len(result.session)
        assert np.array_equal(result.session["tsc"], whole["tsc"][:count])
        assert abs(count - 50 * cut / len(content)) < 5
        assert not (tmp_path / "cut.jsonl").exists()
    for length in (0, 5, 40):
        (tmp_path / "cut.jsonl").write_bytes(content[:length])
        with pytest.raises(SessionError, match="no run is recorded"):
            read_run(tmp_path / "cut.jsonl")
    read_run(tmp_path / "a.jsonl").path.write_bytes(b"?" * 99)
    with pytest.raises(SessionError, match="not the whole bag of a run"):
        read_run(tmp_path / "a.mcap")


def test_what_cannot_be_recovered_is_left_and_the_others_are(node, tmp_path, capsys):
    driven(node, RunSettings(MODEL, "C1", settings=SHORT), tmp_path / "b.mcap", 50).recorder.close()
    tables = fake_ros.Kind("std_msgs/msg/String")(data="[]")
    Log(tmp_path / "a.jsonl").append([log_entry(RUN, 1, fake_ros.serialize(tables))])
    recover(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.jsonl", "b.csv", "b.mcap"]
    assert "a.jsonl: left as it is" in capsys.readouterr().out
    with pytest.raises(SessionError, match=r"c\.jsonl: there is no file"):
        read_run(tmp_path / "c.jsonl")
    assert not (tmp_path / "c.jsonl").exists()


def test_facts_are_refused_before_the_robot_drives():
    for facts, words in (
        ({"notes": "first trial"}, "'notes' is written by the run itself; choose another name"),
        ({"condition": "C1"}, "'condition' is written by the run itself"),
        ({"day": date(2026, 11, 29)}, "'day' would not read back the same"),
        ({"synthetic": "yes"}, "synthetic must be bool"),
    ):
        with pytest.raises(ValueError, match=words):
            RunSettings(MODEL, "C1", facts=facts)


def test_a_full_disk_ends_the_log_and_not_the_run(node, tmp_path, monkeypatch):
    run = RunSettings(MODEL, "C1", settings=SHORT)
    allocation = driven(node, run, tmp_path / "a.mcap", 50)

    def full(handle, data):
        raise OSError(28, "No space left on device")

    while not allocation.recorder.queue.empty():
        time.sleep(0.01)
    monkeypatch.setattr("trustlab.live.log.os.write", full)
    rng = np.random.default_rng(0)
    before = len(node.sent["/cmd_vel"])
    for k in range(20):
        node.time += STEP
        inputs(node, rng, 1.0 + 0.01 * k)
    assert len(node.sent["/cmd_vel"]) == before + 20
    result = allocation.finish()
    assert 2 <= len(result.session) <= 51
    assert any("No space left on device" in line for line in node.log)


def test_the_operators_stop_is_sent_at_once_and_a_held_one_is_not_released(node, tmp_path):
    allocation = driven(node, RunSettings(MODEL, "C1", settings=SHORT), tmp_path / "a.mcap", 60)
    flag = "std_msgs/msg/Bool"
    assert node.sent["/cmd_vel"][-1].linear.x > 0.0
    node.send("/operator/stop", flag, data=True)
    last = node.sent["/cmd_vel"][-1]
    assert (last.linear.x, last.angular.z) == (0.0, 0.0)
    node.send("/operator/release", flag, data=True)
    assert allocation.core.stopped
    node.send("/operator/release", flag, data=False)
    node.send("/operator/stop", flag, data=False)
    assert allocation.core.stopped  # it ends by a release alone
    node.send("/operator/release", flag, data=True)
    assert not allocation.core.stopped
    node.send("/operator/manual", flag, data=False)
    assert allocation.core.mode == 0
    assert allocation.finish().verified


def test_steps_follow_odometry_and_a_timer_where_there_is_none(node, tmp_path):
    allocation = driven(node, RunSettings(MODEL, "C1", settings=SHORT), tmp_path / "a.mcap", 40)
    rng = np.random.default_rng(0)
    for _ in range(5):  # odometry five times as often as steps
        node.time += STEP // 5
        inputs(node, rng, 1.0, skip=["/path_error"])
    assert len(allocation.core.rows) == 41
    for _ in range(20):
        node.time += STEP
        node.tick()
    assert allocation.latest.driver == "nobody"
    assert 57 <= len(allocation.core.rows) <= 61
    node.time += STEP
    inputs(node, rng, 1.0)
    assert len(allocation.core.rows) == 62  # those missing are made up for
    command = allocation.core.command
    node.time += 60 * 10**9
    inputs(node, rng, 1.0)
    assert len(allocation.core.rows) == 63
    assert any("gap: no sample for 60" in note for _, note in allocation.core.notes)
    assert abs(allocation.core.command[0] - command[0]) <= SHORT.v_rate * SHORT.period + 1e-12
    assert allocation.finish().verified


STICK = """
rule = "tests.ros.test_node:Half"
[model]
published = 1
[settings]
window = 2.0
[topics.operator]
topic = "/joy"
type = "sensor_msgs/msg/Joy"
stamp = "receive"
fields = ["axes[1]", "axes[0]"]
scale = [0.5, 2.0]
[topics.stop]
topic = "/joy"
type = "sensor_msgs/msg/Joy"
stamp = "receive"
fields = ["buttons[3]"]
[topics.path_error]
topic = "/reference"
type = "geometry_msgs/msg/PoseStamped"
fields = ["pose.position.x", "pose.position.y"]
best_effort = true
[topics.command]
topic = "/cmd_vel"
type = "geometry_msgs/msg/TwistStamped"
fields = ["twist.linear.x", "twist.angular.z"]
"""


def test_a_run_that_is_not_there_is_said_to_be_missing(tmp_path):
    with pytest.raises(SessionError, match=r"run.mcap: there is no file at this path"):
        read_run(tmp_path / "run.mcap")
    with pytest.raises(ValueError, match=r"run.toml: No such file or directory$"):
        read_toml(tmp_path / "run.toml")


def test_a_stick_a_reference_and_stamped_commands(node, tmp_path):
    (tmp_path / "run.toml").write_text(STICK)
    run = read_toml(tmp_path / "run.toml")
    allocation = Allocation(node, run, tmp_path / "a.mcap")
    assert node.profiles["/reference"].reliability == "best effort"
    assert node.profiles["/odom"].reliability == "reliable"
    axes = np.array([0.1, 0.8], dtype=np.float32)
    buttons = np.zeros(4, dtype=np.int32)
    for k in range(60):
        node.time += STEP
        node.send("/joy", JOY, axes=axes, buttons=buttons)
        node.send("/autonomy/cmd_vel", TWIST, linear__x=0.2)
        node.send("/odom", "nav_msgs/msg/Odometry", node.time, pose__pose__position__x=0.1 * k)
        stamp = node.time
        kind = "geometry_msgs/msg/PoseStamped"
        node.send("/reference", kind, stamp, pose__position__x=0.1 * k, pose__position__y=0.3)
    assert allocation.latest.driver == "both"
    assert allocation.latest.v == pytest.approx(0.5 * 0.4 + 0.5 * 0.2)
    assert allocation.core.rows[-1][5] == pytest.approx(0.3)
    sent = node.sent["/cmd_vel"][-1]
    assert sent.twist.linear.x == allocation.latest.v
    assert sent.header.stamp.sec == node.time // 10**9
    node.send("/joy", JOY, axes=axes[:1], buttons=buttons)
    assert any("operator: no number at axes[1]" in note for _, note in allocation.core.notes)
    buttons[3] = 1
    node.send("/joy", JOY, axes=axes, buttons=buttons)
    assert allocation.core.stopped
    result = allocation.finish()
    assert result.verified
    assert set(result.session["mode"]) == {0.5, 1.0}


def test_a_command_is_scaled_and_may_have_32_bits(node, tmp_path):
    kind = "geometry_msgs/msg/Point32"
    command = Topic("/wheels", kind, ("x", "y"), scale=(1000.0, 3.0))
    run = RunSettings(MODEL, "C1", settings=SHORT, topics={"command": command})
    result = driven(node, run, tmp_path / "a.mcap", 60).finish()
    assert result.verified
    sent = by_rosbags(tmp_path / "a.mcap", ["/wheels"])["/wheels"]
    scaled = result.decisions[["v", "w"]].to_numpy() * [1000.0, 3.0]
    assert [(m.x, m.y) for m in sent] == [tuple(row) for row in scaled.astype(np.float32).tolist()]
    assert scaled[-1, 0] > 100.0
    _written_again(tmp_path / "a.mcap", lambda rows: _flip(rows, "/wheels", lambda m: m.x, "<f"))
    assert not read_run(tmp_path / "a.mcap").verified
    wrong = RunSettings(MODEL, "C1", topics={"command": Topic("/wheels", kind, ("linear.x", "y"))})
    with pytest.raises(ValueError, match=r"no number at linear\.x, y"):
        Allocation(node, wrong, tmp_path / "b.mcap")


def test_a_failing_rule_stops_the_robot(node, tmp_path):
    run = RunSettings(MODEL, rule=Broken(), settings=SHORT)
    allocation = driven(node, run, tmp_path / "a.mcap", 100)
    assert (allocation.latest.v, allocation.latest.w) == (0.0, 0.0)
    assert allocation.latest.driver == "nobody"
    assert any("no idea; the robot is stopped" in line for line in node.log)
    assert allocation.finish().verified


def test_correction_moves_thresholds_to_their_target(node, tmp_path):
    run = RunSettings(
        tl.published_models()["2"],
        "C2",
        (0.0, 0.35),
        correction={"target": [0.05, 0.4], "c_b": 1e-3, "horizon": 50},
        settings=CoreSettings(window=2.0, period=0.1),
    )
    result = driven(node, run, tmp_path / "a.mcap", 300).finish()
    assert result.verified
    lower = result.decisions["lower"].to_numpy()
    upper = result.decisions["upper"].to_numpy()
    assert 0.0 < lower[-1] <= 0.05
    # Oracle: (2.40) step by step, from what was logged, once the window is full
    session, model = result.session, run.model
    corrector = tl.ThresholdCorrector(model, **run.correction)
    pair = (0.0, 0.35)
    for k in range(20, len(lower)):
        assert (lower[k], upper[k]) == pair
        p_r = min(max(session["p_r"][k], model.robot.p_min), model.robot.p_max)
        plan = corrector.step(session["r"][k], p_r, *pair, int(session["mode"][k]))
        pair = (pair[0] + plan.c_l, pair[1] + plan.c_u)


TOML = """
condition = "C3"
thresholds = [0.0, 0.4]
[model]
published = 2
[settings]
window = 20.0
[settings.watchdogs]
operator = { after = 0.3, action = "stop" }
[topics]
odometry = { topic = "/base/odom" }
[facts]
participant = 7
"""


def test_a_toml_file_states_a_run(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(TOML)
    run = read_toml(file)
    assert run.model == tl.published_models()["2"]
    assert run.settings.window == 20.0
    assert run.settings.watchdogs["operator"].action == "stop"
    assert run.settings.watchdogs["odometry"].after == 0.5
    assert run.topics["odometry"].topic == "/base/odom"
    assert run.topics["odometry"].fields == ("pose.pose.position.x", "pose.pose.position.y")
    assert RunSettings.of(run.tables()) == run
    pilot = tl.read_session("data/sessions/pilot.csv")
    tl.write_session(pilot, tmp_path / "pilot.csv")
    file.write_text(TOML.replace("published = 2", 'session = "pilot.csv"'))
    fitted = read_toml(file)
    assert fitted.model == tl.fit_tsc(pilot).model
    assert fitted.settings.model_sample_time == pilot.sample_time
    assert RunSettings.of(fitted.tables()) == fitted


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("[settings]", "[setings]", "setings"),
        ('topic = "/base/odom"', 'fields = ["x..", "y"]', "cannot read the field path 'x..'"),
        ("[model]", "[model", "run.toml"),
        ("[0.0, 0.4]", "[0.4, 0.0]", "run.toml: [the run] the lower threshold must be below"),
        ("[0.0, 0.4]", "[0.0, 0.4, 0.0]", "run.toml: [the run] threshold must be two numbers"),
        ("[0.0, 0.4]", "[5, 9]", "run.toml: [the run] the lower threshold must lie in"),
        ('{ topic = "/base/odom" }', '"/odom"', "[topics.odometry] must be a table, got '/odom'"),
        ("/base/odom", "/cmd_vel", "command: /cmd_vel is taken"),
        ('topic = "/base/odom"', "scale = [nan, 1]", "[topics.odometry] scale must be finite"),
        ("[topics]", "[topics.command]\nbest_effort = true\n[topics]", "command: best_effort"),
        ("[facts]", "[facts]\nnotes = 3", "run.toml: [the run] facts: 'notes'"),
        ("published = 2", "session = 3", "3: there is no file at this path"),
        ('"/base/odom"', "3", "[topics.odometry] topic must be of class str, got int"),
        ('topic = "/base/odom"', 'fields = "x"', "[topics.odometry] fields must be a list"),
    ],
)
def test_a_fault_in_the_file_is_named(tmp_path, monkeypatch, capsys, before, after, words):
    file = tmp_path / "run.toml"
    assert before in TOML
    file.write_text(TOML.replace(before, after))
    with pytest.raises(ValueError, match=re.escape(words)):
        read_toml(file)
    monkeypatch.setattr("sys.argv", ["trustlab.ros", str(file)])
    with pytest.raises(SystemExit):
        main()
    assert words in capsys.readouterr().err


def test_measures_join_those_of_a_virtual_study(node, tmp_path):
    runs = []
    for person in (1, 2, 3):
        for condition in ("C1", "C5"):
            run = RunSettings(MODEL, condition, settings=SHORT, facts={"participant": f"R{person}"})
            name = f"{person}{condition}.mcap"
            seed = 10 * person + (condition == "C5")
            runs.append(driven(node, run, tmp_path / name, 100, seed=seed).finish())
    table = measures_table(runs)
    assert table["position"].tolist() == [1, 2] * 3
    assert runs[0].measures["p_r"] == runs[0].session["p_r"].mean()
    study = tl.virtual_study(n=4, conditions=["C1", "C5"], laps=1, seed=1)
    assert set(table) <= set(study.measures)
    joined = study.joined(table)
    assert len(joined.measures) == 8 + 6
    assert joined.analysis("p_r").n == 7
    assert "recorded" in joined.table().attrs["origin"]
    assert tl.repeated_measures(table, "p_r", "condition", "participant").n == 3
    nobody = replace(runs[0], session=runs[0].session.with_metadata(participant=None))
    assert measures_table([nobody, nobody])["position"].tolist() == [1, 2]


@pytest.mark.parametrize("back", [0.3, 2.0, 3600.0, -3600.0])
def test_a_step_of_the_clock_stops_the_robot_for_a_period_and_no_longer(node, tmp_path, back):
    run = RunSettings(MODEL, "C1", settings=SHORT)
    allocation = driven(node, run, tmp_path / "a.mcap", 60)
    rng = np.random.default_rng(0)
    node.ahead = -round(back * 1e9)
    node.time += STEP
    node.tick()
    last = node.sent["/cmd_vel"][-1]
    assert (last.linear.x, last.angular.z) == (0.0, 0.0)
    for k in range(40):
        inputs(node, rng, 1.0 + 0.01 * k, stamp=node.time + node.ahead - 1_000_000)
        node.time += STEP
        node.tick()
    assert allocation.latest.driver == "operator"
    assert 99 <= len(allocation.core.rows) <= 101
    sent = np.array([m.linear.x for m in node.sent["/cmd_vel"]])
    assert np.abs(np.diff(sent)).max() <= max(SHORT.v_rate * SHORT.period, sent[59]) + 1e-12
    count = len(sent)
    for _ in range(30):  # and the watchdogs go on counting
        node.time += STEP
        node.tick()
    assert allocation.latest.driver == "nobody"
    assert node.sent["/cmd_vel"][-1].linear.x == 0.0
    assert len(node.sent["/cmd_vel"]) > count + 20
    result = allocation.finish()
    assert result.verified
    (note,) = [n for n in result.session.metadata.more["notes"] if "clock steps by" in n]
    assert f"steps by {-back:.3g} s" in note


def test_one_absurd_message_does_not_steer_the_allocation(node, monkeypatch, tmp_path):
    tsc = []
    for name, far, fast in (("a", 1e5, 1e5), ("b", 0.0, 0.5)):
        each = fake_ros.Node()
        monkeypatch.setattr("trustlab.ros.node.monotonic_ns", lambda each=each: each.time)
        run = RunSettings(MODEL, "C1", settings=CoreSettings(window=20.0))
        allocation = driven(each, run, tmp_path / f"{name}.mcap", 60)
        for k in range(40):
            each.time += STEP
            if k == 20:
                each.send("/operator/cmd_vel", TWIST, linear__x=fast)
                each.send("/odom", "nav_msgs/msg/Odometry", each.time - STEP // 2)
            inputs(each, np.random.default_rng(k), 1.0 + 0.01 * k + (far if k == 10 else 0.0))
        result = allocation.finish()
        tsc.append(result.session["tsc"])
    assert np.abs(tsc[0] - tsc[1]).max() < 0.06
    notes = read_run(tmp_path / "a.mcap").session.metadata.more["notes"]
    assert sum("odometry: jumps by 1e+05 m" in note for note in notes) == 2  # there and back
    assert sum("operator: 1e+05 m/s, 0 rad/s count within" in note for note in notes) == 1


def test_another_frame_and_another_sender_are_noted(node, tmp_path):
    allocation = driven(node, RunSettings(MODEL, "C1", settings=SHORT), tmp_path / "a.mcap", 10)
    kind = "nav_msgs/msg/Odometry"
    for _ in range(3):
        node.time += STEP
        node.send("/odom", kind, node.time, header__frame_id="moon")
        node.senders = 2
        node.tick()
    result = allocation.finish()
    assert result.verified
    notes = "; ".join(result.session.metadata.more["notes"])
    assert notes.count("odometry: in frame 'moon', before in ''") == 1
    assert notes.count("command: 2 publishers send it") == 1


def test_a_reference_in_another_frame_than_odometry_is_noted_once(node, tmp_path):
    kind = "geometry_msgs/msg/PoseStamped"
    reference = Topic("/reference", kind, ("pose.position.x", "pose.position.y"))
    run = RunSettings(MODEL, "C1", settings=SHORT, topics={"path_error": reference})
    allocation = Allocation(node, run, tmp_path / "a.mcap")
    for k in range(40):
        node.time += STEP
        for topic in ("/operator/cmd_vel", "/autonomy/cmd_vel"):
            node.send(topic, TWIST, linear__x=0.2)
        node.send("/reference", kind, node.time, header__frame_id="" if k < 20 else "map")
        node.send("/odom", "nav_msgs/msg/Odometry", node.time, header__frame_id="odom")
    result = allocation.finish()
    assert result.verified
    notes = [note for note in result.session.metadata.more["notes"] if "'odom'" in note]
    assert len(notes) == 1
    assert "path_error: in frame 'map', odometry in 'odom'" in notes[0]


def test_a_run_that_heard_nothing_leaves_its_messages_in_a_bag(node, tmp_path):
    allocation = Allocation(node, RunSettings(MODEL, "C1"), tmp_path / "a.mcap")
    node.send("/autonomy/cmd_vel", TWIST)
    with pytest.raises(SessionError, match=r"never heard: odometry, .*the messages are in"):
        allocation.finish()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert len(by_rosbags(tmp_path / "a.mcap", ["/autonomy/cmd_vel"])["/autonomy/cmd_vel"]) == 1
    with pytest.raises(SessionError, match="a session needs two samples"):
        read_run(tmp_path / "a.mcap")


CHANGES = {
    "a state dropped": lambda rows: rows.pop(_nth(rows, "/allocation/tsc", 30)),
    "a message dropped": lambda rows: rows.pop(_nth(rows, "/path_error", 30)),
    "two swapped": lambda rows: rows.insert(300, rows.pop(304)),
    "the participant": lambda rows: _edit(rows, '"participant": 3', '"participant": 4'),
    "a bound of the run": lambda rows: _edit(rows, '"v_max": 0.5', '"v_max": 0.6', RUN),
    # the lowest bit of the x of a command, and of a number
    "a command": lambda rows: _flip(rows, "/cmd_vel", lambda message: message.linear.x),
    "a state": lambda rows: _flip(rows, "/allocation/tsc", lambda message: message.data),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_bag_that_was_changed_is_not_verified(node, tmp_path, change):
    """Messages, their order, settings of the run and metadata; written again as it was, it is."""
    path = tmp_path / "a.mcap"
    facts = {"participant": 3, "synthetic": True}
    run = RunSettings(MODEL, "C3", (-0.2, 0.3), settings=SHORT, facts=facts)
    assert driven(node, run, path, 60).finish().verified
    _written_again(path, lambda rows: None)
    assert read_run(path).verified
    _written_again(path, CHANGES[change])
    assert not read_run(path).verified


def _nth(rows, topic, count):
    return [k for k, row in enumerate(rows) if row[0] == topic][count]


def _flip(rows, topic, number, pack="<d"):
    """Flip the lowest bit of a number in the thirtieth message on a topic."""
    k = _nth(rows, topic, 30)
    *about, data = rows[k]
    spoiled = bytearray(data)
    value = number(fake_ros.STORE.deserialize_cdr(data, about[1]))
    spoiled[spoiled.index(struct.pack(pack, value))] ^= 1
    rows[k] = (*about, bytes(spoiled))


def _edit(rows, before, after, where="/trustlab/metadata"):
    """Replace a part of the text on a topic."""
    for k, (topic, kind, stamp, data) in enumerate(rows):
        if topic == where and before in (text := fake_ros.STORE.deserialize_cdr(data, kind).data):
            message = fake_ros.STORE.types[kind](text.replace(before, after))
            rows[k] = (topic, kind, stamp, fake_ros.serialize(message))
            return
    raise AssertionError(before)


def _written_again(path, change):
    with AnyReader([path], default_typestore=fake_ros.STORE) as reader:
        rows = [(c.topic, c.msgtype, stamp, data) for c, stamp, data in reader.messages()]
    change(rows)
    path.unlink()
    folder = path.with_suffix("")
    with rosbag2.Writer(folder, version=8, storage_plugin=MCAP) as writer:
        connections = {}
        for topic, kind, stamp, data in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=fake_ros.STORE)
            writer.write(connections[topic], stamp, data)
    next(folder.glob("*.mcap")).rename(path)
    shutil.rmtree(folder)


def test_bags_of_other_kinds_are_named(node, tmp_path):
    path = tmp_path / "a.mcap"
    run = RunSettings(MODEL, "C3", (-0.2, 0.3), settings=SHORT)
    driven(node, run, path, 30).finish()
    for change in (
        lambda rows: rows.__setitem__(40, (*rows[40][:3], rows[40][3][:6])),  # half a message
        lambda rows: rows.__setitem__(slice(None), [row for row in rows if row[0] != "/cmd_vel"]),
    ):
        content = path.read_bytes()
        _written_again(path, change)
        with pytest.raises(SessionError, match="bag"):
            read_run(path)
        path.write_bytes(content)


def test_a_message_that_no_replay_could_read_is_refused_before_the_robot_moves(
    node, tmp_path, monkeypatch
):
    """One of the user's own workspace."""
    monkeypatch.setitem(sys.modules, "own_msgs.msg", SimpleNamespace(Stick=fake_ros.Kind(TWIST)))
    stick = Topic("/stick", "own_msgs/msg/Stick", ("linear.x", "angular.z"))
    run = RunSettings(MODEL, "C3", (-0.2, 0.3), settings=SHORT, topics={"operator": stick})
    with pytest.raises(ValueError, match="/stick: own_msgs/msg/Stick is no message of ROS 2"):
        Allocation(node, run, tmp_path / "a.mcap")
    assert (list(tmp_path.iterdir()), node.heard) == ([], {})
