"""The node on a stand-in for rclpy with the test's clock; oracles: rosbags alone, the bounds."""

import math
import re
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import trustlab as tl
from tests.cases import refused
from tests.ros import fake_ros
from tests.ros.fake_ros import STEP, STORE
from tests.sessions.logs import Bag
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
SHORT = CoreSettings(window=2.0)
C1 = RunSettings(MODEL, "C1", settings=SHORT)
FACTS = {"participant": 3, "synthetic": True}
C3 = RunSettings(MODEL, "C3", (-0.2, 0.3), settings=SHORT, facts=FACTS)


class Always:
    """A rule that always says the same."""

    def step(self, tsc, p_r):
        return 0


class Half:
    """A rule that blends both commands in equal parts."""

    def step(self, tsc, p_r):
        return 0.5


class Broken:
    """A rule that fails once the robot has moved."""

    def step(self, tsc, p_r):
        if p_r > 0.1:
            raise RuntimeError("no idea")


@pytest.fixture
def node(monkeypatch):
    fake_ros.install(monkeypatch)
    node = fake_ros.Node()
    monkeypatch.setattr("trustlab.ros.node.monotonic_ns", lambda: node.time)
    return node


@pytest.fixture
def bag(tmp_path):
    return tmp_path / "a.mcap"


def inputs(node, rng, x, age=0.0):
    """One round of messages; odometry, so many steps old, is last as it brings about the step."""
    node.send("/operator/cmd_vel", linear__x=rng.uniform(0, 0.5), angular__z=rng.normal())
    node.send("/autonomy/cmd_vel", linear__x=rng.uniform(0, 0.3), angular__z=rng.normal())
    node.send("/path_error", data=abs(rng.normal(scale=0.3)))
    stamp = node.time + node.ahead - 1_000_000 - round(age * STEP)
    node.send("/odom", stamp, pose__pose__position__x=x)


def driven(node, run, path, steps=60, seed=0):
    allocation, rng = Allocation(node, run, path), np.random.default_rng(seed)
    for x in rng.uniform(0.0, 0.03, steps).cumsum():
        node.tick()
        inputs(node, rng, x)
    return allocation


def finished(allocation):
    result = allocation.finish()
    assert result.verified
    return result


def commands(messages):
    return np.array([(each.linear.x, each.angular.z) for each in messages])


def sent(node):
    return commands(node.sent["/cmd_vel"])


def notes(result):
    return "\n".join(result.session.metadata.more["notes"])


def rows_of(path):
    """Topic, time, type and content of each message of a bag, by rosbags alone."""
    with AnyReader([path], default_typestore=STORE) as reader:
        return [
            (c.topic, stamp, c.msgtype, reader.deserialize(data, c.msgtype))
            for c, stamp, data in reader.messages()
        ]


def of_topic(rows, topic):
    return [message for name, _, _, message in rows if name == topic]


def write(path, rows):
    bag = Bag(path)
    bag.entries = rows
    bag.write()


def test_a_recorder_ends_though_a_message_comes_behind_its_end(bag):
    """As of a callback that another thread runs while the node finishes."""
    recorder = Recorder(bag, print)
    append = recorder.log.append

    def meanwhile(entries):
        recorder.log.append = append
        recorder.queue.put(None)
        recorder.write("/a", 2, b"y")
        append(entries)

    recorder.log.append = meanwhile
    recorder.write("/a", 1, b"x")
    recorder.thread.join(5.0)
    assert not recorder.thread.is_alive()
    assert [entry[1] for entry in read_log(bag).entries] == [1, 2]


def test_a_run_leaves_a_bag_and_a_session_that_agree(node, bag):
    result = finished(driven(node, C3, bag, 200))
    assert sorted(path.suffix for path in bag.parent.iterdir()) == [".csv", ".mcap"]
    session = tl.read_session(bag)
    assert session == result.session == tl.read_session(bag.with_suffix(".csv"))
    assert len(session) == 200
    assert session.metadata.participant == 3
    assert session.metadata.more["interrupted"] is False
    rows = rows_of(bag)
    for name, column in (("/trustlab/tsc", "tsc"), ("/allocation/mode", "mode")):
        assert [each.data for each in of_topic(rows, name)] == session[column].tolist()
    assert set(session["mode"]) == {0.0, 1.0}
    assert len(of_topic(rows, "/odom")) == 200
    *done, last = sent(node).tolist()
    assert last == [0.0, 0.0]  # the last word of a run that ends
    assert commands(of_topic(rows, "/cmd_vel")).tolist() == done
    assert result.decisions[["v", "w"]].to_numpy().tolist() == done


# Faults by what is noted of them, and how old the odometry of each round of messages then is.
FAULTS = {
    "messages lost": [],
    "odometry: repeated": [0.0, 0.0],
    "odometry: out of order": [0.0, 2.0, *[0.5] * 60],
    "operator: not a finite value": [0.0],
    "odometry: late by": [14.0],
}


def test_no_fault_leads_outside_the_bounds_and_each_is_named(node, bag):
    allocation = Allocation(node, RunSettings(MODEL, rule=Always(), settings=SHORT), bag)
    rng = np.random.default_rng(1)
    faults = [*FAULTS, *[""] * 5]
    for k in range(600):
        node.tick()
        # none at all for longer than a watchdog waits, then one after another
        fault = faults[k // 15] if k < 150 else rng.choice(faults)
        for age in FAULTS.get(fault, [0.0]):
            inputs(node, rng, 0.01 * k, age)
        if "finite" in fault:
            value = rng.choice([math.nan, math.inf, -math.inf, 1e300])
            node.send("/operator/cmd_vel", linear__x=value)
            node.send("/path_error", data=value)
            node.send("/odom", node.time, pose__pose__position__x=value)
    result = finished(allocation)
    done = sent(node)[:-1]
    assert (np.abs(done) <= [SHORT.v_max, SHORT.w_max]).all()
    rates = np.abs(np.diff(done, axis=0)) / SHORT.period
    assert (rates <= [SHORT.v_rate + 1e-9, SHORT.w_rate + 1e-9]).all()
    assert notes(result).count("\n") < 700, "notes of one kind are counted"
    warned = "\n".join(node.log)
    for note in FAULTS:
        assert note in notes(result)
        assert note in warned


def test_a_rule_without_a_name_is_needed_again_for_a_replay(node, bag):
    run = replace(C1, condition=None, rule=Always())
    finished(driven(node, run, bag))
    with refused("needs one of these"):
        read_run(bag)
    named = replace(run, rule="tests.ros.test_node:Always")
    finished(driven(node, named, bag))
    with pytest.raises(SessionError, match="test_node:Always'; if you trust it, say own_rules"):
        read_run(bag)  # a stranger's bag calls nothing
    again = read_run(bag, own_rules=True)
    assert again.verified
    assert again.run == named


@pytest.mark.parametrize("cuts", [8, pytest.param(20, marks=pytest.mark.long)])
def test_cuts_leave_what_was_written_before(node, bag, cuts):
    allocation = driven(node, C3, bag, 50)
    whole = allocation.core.session()["tsc"]
    allocation.recorder.close()
    content = bag.with_suffix(".jsonl").read_bytes()
    left = bag.with_name("cut.jsonl")
    for cut in np.random.default_rng(0).integers(len(content) // 5, len(content), cuts):
        left.write_bytes(content[:cut])
        result = read_run(left)
        assert result.verified
        assert result.session.metadata.more["interrupted"] is True
        count = len(result.session)
        assert np.array_equal(result.session["tsc"], whole[:count])
        assert abs(count - 50 * cut / len(content)) < 5
        assert not left.exists()
    for length in (0, 5, 40):
        left.write_bytes(content[:length])
        with pytest.raises(SessionError, match="no run is recorded"):
            read_run(left)
    result.path.write_bytes(b"?" * 99)
    with pytest.raises(SessionError, match="not the whole bag of a run"):
        read_run(result.path)


def test_what_cannot_be_recovered_is_left_and_the_others_are(node, tmp_path, capsys):
    driven(node, C1, tmp_path / "b.mcap").recorder.close()
    tables = fake_ros.Kind("std_msgs/msg/String")(data="[]")
    Log(tmp_path / "a.jsonl").append([log_entry(RUN, 1, fake_ros.serialize(tables))])
    recover(tmp_path)
    with pytest.raises(SessionError, match=r"c\.jsonl: there is no file"):
        read_run(tmp_path / "c.jsonl")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.jsonl", "b.csv", "b.mcap"]
    assert "a.jsonl: left as it is" in capsys.readouterr().out


def test_a_full_disk_ends_the_log_and_not_the_run(node, bag, monkeypatch):
    allocation = driven(node, C1, bag, 50)

    def full(handle, data):
        raise OSError(28, "No space left on device")

    while not allocation.recorder.queue.empty():
        time.sleep(0.01)
    monkeypatch.setattr("trustlab.live.log.os.write", full)
    for k in range(20):
        node.tick()
        inputs(node, np.random.default_rng(k), 1.0 + 0.01 * k)
    assert len(sent(node)) == 70
    assert 2 <= len(allocation.finish().session) <= 51
    assert any("No space left on device" in line for line in node.log)


def test_the_operators_stop_is_sent_at_once_and_a_held_one_is_not_released(node, bag):
    allocation = driven(node, C1, bag)
    assert sent(node)[-1, 0] > 0.0
    # it ends by a release alone
    for button, down, stopped in (
        ("stop", True, True),
        ("release", True, True),
        ("release", False, True),
        ("stop", False, True),
        ("release", True, False),
    ):
        node.send(f"/operator/{button}", data=down)
        assert not sent(node)[-1].any()
        assert allocation.core.stopped == stopped
    node.send("/operator/manual", data=False)
    assert allocation.core.mode == 0
    finished(allocation)


def test_steps_follow_odometry_and_a_timer_where_there_is_none(node, bag):
    allocation = driven(node, C1, bag, 40)
    core, rng = allocation.core, np.random.default_rng(0)
    for _ in range(5):  # odometry five times as often as steps
        node.tick(STEP // 5)
        inputs(node, rng, 1.0)
    assert len(core.rows) == 41
    for _ in range(20):
        node.tick()
    assert allocation.latest.driver == "nobody"
    assert 57 <= len(core.rows) <= 61
    node.tick()
    inputs(node, rng, 1.0)
    assert len(core.rows) == 62  # those missing are made up for
    before = core.command[0]
    node.time += 60 * 10**9
    inputs(node, rng, 1.0)
    assert len(core.rows) == 63
    assert abs(core.command[0] - before) <= SHORT.v_rate * SHORT.period + 1e-12
    assert "gap: no sample for 60" in notes(finished(allocation))


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


def test_a_stick_a_reference_and_stamped_commands(node, bag):
    """The reference gets a frame of its own in the middle, which is noted once."""
    file = bag.with_suffix(".toml")
    file.write_text(STICK)
    allocation = Allocation(node, read_toml(file), bag)
    assert node.profiles["/reference"].reliability == "best effort"
    assert node.profiles["/odom"].reliability == "reliable"
    axes = np.array([0.1, 0.8], dtype=np.float32)
    buttons = np.zeros(4, dtype=np.int32)
    for k in range(60):
        node.tick()
        x, frame = 0.1 * k, "map" if k > 30 else ""
        node.send("/joy", axes=axes, buttons=buttons)
        node.send("/autonomy/cmd_vel", linear__x=0.2)
        node.send("/odom", node.time, pose__pose__position__x=x, header__frame_id="odom")
        reference = {"pose__position__x": x, "pose__position__y": 0.3, "header__frame_id": frame}
        node.send("/reference", node.time, **reference)
    assert allocation.latest.driver == "both"
    assert allocation.latest.v == pytest.approx(0.5 * 0.4 + 0.5 * 0.2)
    assert allocation.core.rows[-1][5] == pytest.approx(0.3)
    command = node.sent["/cmd_vel"][-1]
    assert command.twist.linear.x == allocation.latest.v
    assert command.header.stamp.sec == node.time // 10**9
    node.send("/joy", axes=axes[:1], buttons=buttons)
    buttons[3] = 1
    node.send("/joy", axes=axes, buttons=buttons)
    assert allocation.core.stopped
    result = finished(allocation)
    assert set(result.session["mode"]) == {0.5, 1.0}
    assert "operator: no number at axes[1]" in notes(result)
    assert notes(result).count("path_error: in frame 'map', odometry in 'odom'") == 1


def test_a_command_is_scaled_and_may_have_32_bits(node, bag):
    kind = "geometry_msgs/msg/Point32"
    command = Topic("/wheels", kind, ("x", "y"), scale=(1000.0, 3.0))
    result = finished(driven(node, replace(C1, topics={"command": command}), bag))
    wheels = of_topic(rows_of(bag), "/wheels")
    scaled = result.decisions[["v", "w"]].to_numpy() * [1000.0, 3.0]
    assert np.array_equal([(each.x, each.y) for each in wheels], scaled.astype(np.float32))
    assert scaled[-1, 0] > 100.0
    wrong = replace(command, fields=("linear.x", "y"))
    with refused(r"no number at linear\.x, y"):
        Allocation(node, replace(C1, topics={"command": wrong}), bag)


def test_a_failing_rule_stops_the_robot(node, bag):
    allocation = driven(node, replace(C1, condition=None, rule=Broken()), bag, 100)
    latest = allocation.latest
    assert (latest.v, latest.w, latest.driver) == (0.0, 0.0, "nobody")
    assert any("no idea; the robot is stopped" in line for line in node.log)
    finished(allocation)


def test_correction_moves_thresholds_to_their_target(node, bag):
    run = RunSettings(
        tl.published_models()["2"],
        "C2",
        (0.0, 0.35),
        correction={"target": [0.05, 0.4], "c_b": 1e-3, "horizon": 50},
        settings=CoreSettings(window=2.0, period=0.1),
    )
    result = finished(driven(node, run, bag, 300))
    thresholds = result.decisions[["lower", "upper"]].to_numpy().tolist()
    assert 0.0 < thresholds[-1][0] <= 0.05
    # Oracle: (2.40) step by step, from what was logged, once the window is full
    session, robot = result.session, run.model.robot
    corrector = tl.ThresholdCorrector(run.model, **run.correction)
    lower, upper = 0.0, 0.35
    for k in range(20, len(thresholds)):
        assert thresholds[k] == [lower, upper]
        p_r = min(max(session["p_r"][k], robot.p_min), robot.p_max)
        plan = corrector.step(session["r"][k], p_r, lower, upper, int(session["mode"][k]))
        lower, upper = lower + plan.c_l, upper + plan.c_u


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
    with refused(r"run.toml: No such file or directory$"):
        read_toml(file)
    file.write_text(TOML)
    run = read_toml(file)
    assert run.model == tl.published_models()["2"]
    assert run.settings.window == 20.0
    assert run.settings.watchdogs["operator"].action == "stop"
    assert run.settings.watchdogs["odometry"].after == 0.5
    odometry = run.topics["odometry"]
    assert odometry.topic == "/base/odom"
    assert odometry.fields == ("pose.pose.position.x", "pose.pose.position.y")
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
        ("[0.0, 0.4]", "[5, 9]", "run.toml: [the run] the lower threshold must lie in"),
        ('{ topic = "/base/odom" }', '"/odom"', "[topics.odometry] must be a table, got '/odom'"),
        ("/base/odom", "/cmd_vel", "command: /cmd_vel is taken"),
        ('topic = "/base/odom"', "scale = [nan, 1]", "[topics.odometry] scale must be finite"),
        ("[topics]", "[topics.command]\nbest_effort = true\n[topics]", "command: best_effort"),
        ('topic = "/base/odom"', 'fields = ["yaw(a)", "y"]', "'yaw(a)' is no plain field"),
        ('topic = "/base/odom"', "fields = ['a[k=\"b\"].x', 'y']", "is no plain field"),
        ("[facts]", "[facts]\nnotes = 3", "'notes' is written by the run itself; choose another"),
        ("[facts]", "[facts]\nday = 2026-11-29", "'day' would not read back the same"),
        ("published = 2", "session = 3", "3: there is no file at this path"),
        ('"/base/odom"', "3", "[topics.odometry] topic must be of class str, got int"),
        ('topic = "/base/odom"', 'fields = "x"', "[topics.odometry] fields must be a list"),
    ],
)
def test_a_fault_in_the_file_is_named(tmp_path, monkeypatch, capsys, before, after, words):
    file = tmp_path / "run.toml"
    file.write_text(TOML.replace(before, after))
    with refused(re.escape(words)):
        read_toml(file)
    monkeypatch.setattr("sys.argv", ["trustlab.ros", str(file)])
    with pytest.raises(SystemExit):
        main()
    assert words in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore:nobody switched:UserWarning")
def test_measures_join_those_of_a_virtual_study(node, bag):
    runs = []
    for k in range(6):
        run = replace(C1, condition=f"C{k % 2 * 4 + 1}", facts={"participant": f"R{k // 2}"})
        runs.append(driven(node, run, bag.with_stem(str(k)), seed=k).finish())
    table = measures_table(runs)
    assert table["position"].tolist() == [1, 2] * 3
    assert runs[0].measures["p_r"] == runs[0].session["p_r"].mean()
    study = tl.virtual_study(n=4, conditions=["C1", "C5"], laps=1, seed=1, n_jobs=1)
    assert set(table) <= set(study.measures)
    joined = study.joined(table)
    assert joined.analysis("p_r").n == 7
    assert "recorded" in joined.table().attrs["origin"]
    nobody = replace(runs[0], session=runs[0].session.with_metadata(participant=None))
    assert measures_table([nobody, nobody])["position"].tolist() == [1, 2]


@pytest.mark.parametrize("back", [0.3, 3600.0, -3600.0])
def test_a_step_of_the_clock_stops_the_robot_for_a_period_and_no_longer(node, bag, back):
    allocation = driven(node, C1, bag)
    rng = np.random.default_rng(0)
    node.ahead = -round(back * 1e9)
    node.tick()
    assert not sent(node)[-1].any()
    for k in range(40):
        inputs(node, rng, 1.0 + 0.01 * k)
        node.tick()
    assert allocation.latest.driver == "operator"
    assert 99 <= len(allocation.core.rows) <= 101
    v = sent(node)[:, 0]
    assert np.abs(np.diff(v)).max() <= max(SHORT.v_rate * SHORT.period, v[59]) + 1e-12
    for _ in range(30):  # and the watchdogs go on counting
        node.tick()
    assert allocation.latest.driver == "nobody"
    assert sent(node)[-1, 0] == 0.0
    assert len(sent(node)) > len(v) + 20
    result = finished(allocation)
    assert re.findall("clock steps by (.*) s", notes(result)) == [f"{-back:.3g}"]


def test_one_absurd_message_does_not_steer_the_allocation(node, monkeypatch, tmp_path):
    tsc = []
    for name, far, fast in (("b", 0.0, 0.5), ("a", 1e5, 1e5)):
        each = fake_ros.Node()
        monkeypatch.setattr("trustlab.ros.node.monotonic_ns", lambda each=each: each.time)
        run = replace(C1, settings=CoreSettings(window=20.0))
        allocation = driven(each, run, tmp_path / f"{name}.mcap")
        for k in range(40):
            each.tick()
            if k == 20:
                each.send("/operator/cmd_vel", linear__x=fast)
                each.send("/odom", each.time - STEP // 2)
            inputs(each, np.random.default_rng(k), 1.0 + 0.01 * k + (far if k == 10 else 0.0))
        result = allocation.finish()
        tsc.append(result.session["tsc"])
    assert np.abs(tsc[0] - tsc[1]).max() < 0.06
    assert notes(result).count("odometry: jumps by 1e+05 m") == 2  # there and back
    assert notes(result).count("operator: 1e+05 m/s, 0 rad/s count within") == 1


def test_another_frame_and_another_sender_are_noted(node, bag):
    allocation = driven(node, C1, bag)
    node.senders = 2
    for _ in range(3):
        node.tick()
        node.send("/odom", node.time, header__frame_id="moon")
    result = finished(allocation)
    assert notes(result).count("odometry: in frame 'moon', before in ''") == 1
    assert notes(result).count("command: 2 publishers send it") == 1


def test_a_run_that_heard_nothing_leaves_its_messages_in_a_bag(node, bag):
    allocation = Allocation(node, C1, bag)
    node.send("/autonomy/cmd_vel")
    with pytest.raises(SessionError, match=r"never heard: odometry, .*the messages are in"):
        allocation.finish()
    assert list(bag.parent.iterdir()) == [bag]
    assert len(of_topic(rows_of(bag), "/autonomy/cmd_vel")) == 1
    with pytest.raises(SessionError, match="a session needs two samples"):
        read_run(bag)


def later(message):
    message.linear.x = np.nextafter(message.linear.x, 1.0)


def edit(message, before, after):
    message.data = message.data.replace(before, after)


CHANGES = {
    "a message left out": lambda rows: rows.pop(304),
    "two swapped": lambda rows: rows.insert(300, rows.pop(304)),
    "the participant": lambda rows: edit(
        of_topic(rows, "/trustlab/metadata")[0], '"participant": 3', '"participant": 4'
    ),
    "a bound of the run": lambda rows: edit(rows[0][-1], '"v_max": 0.5', '"v_max": 0.6'),
    "the last bit of a command": lambda rows: later(of_topic(rows, "/cmd_vel")[30]),
}


def test_a_bag_that_was_changed_is_not_verified(node, bag):
    """Messages, their order, settings of the run and metadata; written again as it was, it is."""
    driven(node, C3, bag).finish()
    content = bag.read_bytes()
    write(bag, rows_of(bag))
    assert read_run(bag).verified
    # other commands, and other states, than those that were sent
    for change in ({"settings": replace(SHORT, v_rate=0.9)}, {"thresholds": (-0.2, 0.3001)}):
        assert not read_run(bag, replace(C3, **change)).verified
    for name, change in CHANGES.items():
        bag.write_bytes(content)
        rows = rows_of(bag)
        change(rows)
        write(bag, rows)
        assert not read_run(bag).verified, name


def test_bags_of_other_kinds_are_named(node, bag):
    driven(node, C3, bag, 30).finish()
    rows, kind = rows_of(bag), "std_msgs/msg/Bool"
    short = ("/odom", rows[-1][1], kind, fake_ros.Kind(kind)())
    other = ("/other", *rows[-1][1:])
    for changed in ([*rows, short], [*rows, other], [r for r in rows if r[0] != "/cmd_vel"]):
        write(bag, changed)
        with pytest.raises(SessionError, match="bag"):
            read_run(bag)


def test_a_message_that_no_replay_could_read_is_refused_before_the_robot_moves(
    node, bag, monkeypatch
):
    """One of the user's own workspace."""
    stick = fake_ros.Kind("geometry_msgs/msg/Twist")
    monkeypatch.setitem(sys.modules, "own_msgs.msg", SimpleNamespace(Stick=stick))
    operator = Topic("/stick", "own_msgs/msg/Stick", ("linear.x", "angular.z"))
    with refused("/stick: own_msgs/msg/Stick is no message of ROS 2"):
        Allocation(node, replace(C3, topics={"operator": operator}), bag)
    assert (list(bag.parent.iterdir()), node.heard) == ([], {})
