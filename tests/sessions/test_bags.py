"""ROS bags as a lab records them, written by rosbags. Oracle: the numbers written."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.cases import refused
from tests.sessions.logs import NUMBER, START, TEXT, Bag, bag_recipe, stamped
from trustlab.sessions import read_session, read_sessions

KINDS = ["lab.bag", "lab.mcap", "lab"]
COLUMNS = """
[columns]
mode = { topic = "/drive_mode", field = "data", map = { MANUAL = 1, AUTO = 0 }, hold = true }
robot_x = { topic = "/odom", field = "pose.pose.position.x", unit = "m" }
robot_y = { topic = "/odom", field = "pose.pose.position.y", unit = "m" }
yaw = { topic = "/odom", field = "yaw(pose.pose.orientation)" }
reference_x = { topic = "/reference", field = "pose.position.x", unit = "cm" }
reference_y = { topic = "/reference", field = "pose.position.y", unit = "cm" }
w_command = { topic = "/cmd_vel", field = "angular.z", unit = "deg/s" }
u_h_x = { topic = "/joy", field = "axes[1]" }
suggested_mode = { topic = "/joy", field = "buttons[2]" }
beta = { topic = "/on", field = "data" }
path_error = { distance = ["robot", "reference"], axes = ["x", "y"] }
step_distance = { travelled = "robot", axes = ["x", "y"] }
"""
ERROR = '[columns]\npath_error = { topic = "/e", field = "data", unit = "m" }\n'
P_R = 'p_r = { topic = "/p", field = "data" }\n'
RESAMPLED = "[resampling]\nmethod = 'linear'\nsample_time = 0.1\n"


def turn(yaw):
    return {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}


def lab_bag(path):
    """
    Return a bag of 2 s: odometry at 50 Hz, stamped 5 ms before receipt, everything else at 10 Hz.
    """
    bag = Bag(path)
    for k in range(101):
        t = 0.02 * k
        pose = {"pose": {"position": {"x": t}, "orientation": turn(3.0 + 0.2 * t)}}
        header = stamped(START + round((t - 0.005) * 1e9))
        bag.add("/odom", t, "nav_msgs/msg/Odometry", header=header, pose=pose)
    for k in range(25):
        t = -0.1 + 0.1 * k
        header = stamped(START + round(t * 1e9))
        pose = {"position": {"x": 100 * t, "y": 30.0}}
        bag.add("/reference", t, "geometry_msgs/msg/PoseStamped", header=header, pose=pose)
        bag.add("/cmd_vel", t, "geometry_msgs/msg/Twist", angular={"z": 180.0 * t})
        sticks = {"axes": np.float32([0, t, 1]), "buttons": np.int32([0, 0, t > 0.95])}
        bag.add("/joy", t, "sensor_msgs/msg/Joy", **sticks)
        bag.add("/on", t, "std_msgs/msg/Bool", data=True)
    for t, text in [(-1.0, "MANUAL"), (0.55, "AUTO"), (1.25, "MANUAL")]:
        bag.add("/drive_mode", t, TEXT, data=text)
    return bag


@pytest.mark.parametrize("name", KINDS)
def test_a_lab_bag(tmp_path, name):
    session = read_session(lab_bag(tmp_path / name).write(), bag_recipe(COLUMNS + RESAMPLED))
    t = np.arange(21) * 0.1
    expected = {
        "t": t,
        "robot_x": t,
        "robot_y": 0.0,
        "reference_x": t,
        "path_error": 0.3,
        "step_distance": 0.1,
        "w_command": np.pi * t,
        "beta": 1.0,
        "suggested_mode": t > 0.95,
        # The last message holds until the other topics end.
        "mode": (t < 0.55) | (t > 1.25),
    }
    for column, values in expected.items():
        assert_allclose(session[column], values, rtol=1e-12, atol=1e-9, err_msg=column)
    assert_allclose(session["u_h_x"], t, rtol=1e-6, atol=1e-6)
    assert_allclose(np.cos(session["yaw"] - (3.0 + 0.2 * t)), 1.0)
    assert np.abs(session["yaw"]).max() <= np.pi
    more = session.metadata.more
    assert more["start_time"] == pytest.approx(START / 1e9, abs=1e-6)
    assert more["resampled"] == "linear at 0.1 s; longest gap in the log 0.1 s"


def test_stamps_of_headers_and_topics_that_share_theirs(tmp_path):
    path, recipe = lab_bag(tmp_path / "lab.mcap").write(), bag_recipe(COLUMNS)
    text = COLUMNS + RESAMPLED + '[time]\ntopics = { "/odom" = "header" }\n'
    session = read_session(path, bag_recipe(text))
    # Stamps stand 5 ms before receipt, and the overlap starts with /odom.
    assert session.metadata.more["start_time"] == pytest.approx((START - 5e6) / 1e9, abs=1e-6)
    assert_allclose(session["robot_x"], session.t, atol=1e-9)
    assert_allclose(session["reference_x"], session.t - 0.005, atol=1e-9)
    # Those that share theirs need no resampling.
    session = read_session(path, recipe, columns=["reference_x", "w_command"])
    assert_allclose(session.t, np.arange(25) * 0.1, atol=1e-12)
    assert "resampled" not in session.metadata.more
    with refused(r"'/reference' and '/odom' have stamps of their own.*\[resampling\]"):
        read_session(path, recipe, columns=["reference_x", "robot_x"])
    called = read_session(path, recipe, resample="nearest", sample_time=0.5)
    assert called["mode"].tolist() == [1, 1, 0, 1, 1]


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("stamp", [25.0, 29.9, 30.0, 30.1])
def test_a_message_that_holds_into_the_end_of_a_gap(tmp_path, name, stamp):
    """Modes are held, at 0 to 20 s and 30 to 40 s of measurements."""
    t = np.r_[:21, 30:41]
    bag = Bag(tmp_path / name).numbers("/p", t, 0.01 * t)
    bag.numbers("/mode", [0.0, 10.0, stamp], [0.0, 1.0, 0.0]).write()
    recipe = bag_recipe(f"""[splitting]
gap = 5.0
[resampling]
method = "previous"
sample_time = 1.0
[columns]
{P_R}mode = {{ topic = "/mode", field = "data", hold = true }}""")
    before, after = read_sessions(tmp_path, recipe)
    assert_allclose(before.t, np.arange(21), atol=1e-9)
    assert before["mode"].tolist() == [0.0] * 10 + [1.0] * 11
    # The topics overlap from the later of their first samples on.
    assert_allclose(after.t, np.arange(30, 41), atol=1e-9)
    assert_allclose(after["p_r"], 0.01 * after.t, atol=1e-12)
    assert after["mode"].tolist() == [float(stamp > 30.0)] + [0.0] * 10


TF = """[columns.robot_x]
topic = "/tf"
field = 'transforms[child_frame_id="turtle1"].transform.translation.x'
unit = "m"
"""


def test_one_robot_of_two_on_tf(tmp_path):
    """As two robots publish it: in turn, and once together."""
    bag = Bag(tmp_path / "turtles")
    for k in range(20):
        own = {"child_frame_id": "turtle1", "transform": {"translation": {"x": 0.1 * k}}}
        other = {"child_frame_id": "turtle2", "transform": {"translation": {"x": -1.0}}}
        frames = [other, own] if k == 6 else [own] if k % 2 == 0 else [other]
        bag.add("/tf", k / 10, "tf2_msgs/msg/TFMessage", transforms=frames)
    path = bag.write()
    session = read_session(path, bag_recipe(TF))
    assert session["robot_x"].tolist() == [0.1 * k for k in range(0, 20, 2)]
    assert_allclose(session.t, 0.2 * np.arange(10), atol=1e-9)
    notes = [text for name, text in session.metadata.more.items() if name.startswith("selected")]
    assert notes == ["10 of 20 messages have the entry"]
    with refused(r"message 1 .*frame 'turtle2' here, and of 'turtle1'"):
        read_session(path, bag_recipe(TF.replace('[child_frame_id="turtle1"]', "[0]")))
    # SQLite would misread the path.
    with refused(r"cannot be read where its path has . or #; rename"):
        read_session(path.rename(tmp_path / "why?"), bag_recipe(TF))


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(
    ("values", "times", "words"),
    [
        ([0, 1, math.nan, -1], None, r"'/e', message 2 \(from 0\).*'path_error', t = 0\.2 s: nan"),
        ([0, 1, 2, 3, 4], [0, 0.1, 0.2, 0.3, 0.5], "message 4 .*irregular.*resample="),
        ([0], None, "at least two samples"),
    ],
)
def test_faults_name_topic_and_message(tmp_path, name, values, times, words):
    times = np.arange(len(values)) / 10 if times is None else times
    path = Bag(tmp_path / name).numbers("/e", times, values).write()
    with refused(words):
        read_session(path, bag_recipe(ERROR))


def test_topics_that_cannot_be_used(tmp_path):
    times = np.arange(3) / 10
    bag = Bag(tmp_path / "lab.mcap").numbers("/e", times).numbers("/p", 0.5 + times)
    bag.add("/two", 0.0, NUMBER)
    bag.add("/two", 0.1, TEXT)
    path = bag.write()
    with refused(r"do not overlap: '/e' ends 0\.3 s before '/p' starts"):
        read_session(path, bag_recipe(ERROR + P_R + RESAMPLED))
    with refused("'/two' has messages of two types"):
        read_session(path, bag_recipe(ERROR.replace("/e", "/two")))


def test_missing_pages_of_a_database_would_read_as_zeros(tmp_path, monkeypatch):
    values = np.arange(1.0, 361.0)
    path = Bag(tmp_path / "a").numbers("/e", np.arange(360), values).write()
    file = next(path.glob("*.db3"))
    data = file.read_bytes()
    for size in (0, 50, len(data) // 2, len(data) - 7):
        file.write_bytes(data[:size])
        with refused("damaged or truncated"):
            read_session(path, bag_recipe(ERROR))
    # Negative control: without the check of its size, a number is another one.
    monkeypatch.setattr("trustlab.sessions.bags._check_database", lambda file: None)
    assert (read_session(path, bag_recipe(ERROR))["path_error"] != values).sum() == 1


@pytest.mark.parametrize(
    ("resampled", "stray"),
    [(RESAMPLED, [5.0]), (RESAMPLED, [5.04]), (RESAMPLED, [5.0, 5.05]), ("", [5.0])],
)
def test_stray_messages_on_each_topic_make_no_part(tmp_path, resampled, stray):
    """They made the whole log unreadable, as parts shorter than a sample time did."""
    bag = Bag(tmp_path / "a.mcap")
    for topic, between in (("/e", [5.0]), ("/p", stray)):
        bag.numbers(topic, np.r_[np.arange(20) / 10, between, 9 + np.arange(20) / 10])
    bag.write()
    recipe = bag_recipe(f"{resampled}[splitting]\ngap = 1.0\n{ERROR}{P_R}")
    sessions = read_sessions(tmp_path, recipe)
    assert [len(session) for session in sessions] == [20, 20]
    assert sessions[0].metadata.more["split"].endswith("1 too short")


@pytest.mark.parametrize(("late", "cut"), [(-2.0, None), (0.04, None), (2.0, True)])
def test_means_that_began_before_the_other_topics_are_noted(tmp_path, late, cut):
    """The fit took the first of them for one over a single sample."""
    t = np.arange(100) / 10
    path = Bag(tmp_path / "a.mcap").numbers("/p", t).numbers("/e", t + late).write()
    text = f"performance_window = 5\n{RESAMPLED}{ERROR}{P_R}"
    session = read_session(path, bag_recipe(text))
    assert session.metadata.more.get("performance_cut") is cut


@pytest.mark.parametrize("other", ["", ", hold = true"])
def test_a_column_holds_its_last_value_only_where_its_own_rule_says(tmp_path, other):
    """The speed of a topic went on where the mode of the same topic was held."""
    bag = Bag(tmp_path / "a.mcap").numbers("/p", np.arange(31) / 10)
    for t in np.arange(11) / 10:
        bag.add("/base", t, "geometry_msgs/msg/Twist", linear={"x": t}, angular={"z": 1.0})
    columns = f"""robot_x = {{ topic = "/base", field = "linear.x", unit = "m"{other} }}
mode = {{ topic = "/base", field = "angular.z", hold = true }}
"""
    session = read_session(bag.write(), bag_recipe(f"{RESAMPLED}[columns]\n{P_R}{columns}"))
    assert session.t[-1] == pytest.approx(3.0 if other else 1.0)


def test_a_heading_is_that_of_the_quaternion_whatever_its_norm(tmp_path):
    """Oracle: the quaternion of a turn; it was wrong by up to a degree."""
    angles = np.linspace(-3.1, 3.1, 21)
    bag = Bag(tmp_path / "a.mcap")
    for k, angle in enumerate(angles):
        quaternion = {name: [0.991, 1.0, 1.009][k % 3] * x for name, x in turn(angle).items()}
        bag.add("/q", k / 10, "geometry_msgs/msg/Pose", orientation=quaternion)
    text = '[columns]\nyaw = { topic = "/q", field = "yaw(orientation)" }\n'
    assert_allclose(read_session(bag.write(), bag_recipe(text))["yaw"], angles)


@pytest.mark.parametrize(
    ("pausing", "told"), [("ep", ["/e", "/p"]), ("p", ["/p"]), ("m", []), ("", [])]
)
def test_a_gap_that_resampling_bridges_in_a_topic_is_told(tmp_path, recwarn, pausing, told):
    """
    More than ten of the log's steps, and of the new ones; only that of a table or of a single topic
    was.
    """
    bag, t = Bag(tmp_path / "a.mcap"), np.arange(100) / 10
    for topic in "epm":
        bag.numbers(f"/{topic}", t[(t <= 3.0) | (t >= (4.3 if topic in pausing else 3.9))])
    text = 'mode = { topic = "/m", field = "data", above = 0.1, hold = true }\n'
    read_session(bag.write(), bag_recipe(RESAMPLED + ERROR + P_R + text))
    assert len(recwarn) == len(told)
    for each, topic in zip(recwarn, told, strict=True):
        words = f"a.mcap {topic}: resampling bridges a gap of 1.3 s at t = 3 s; if the log"
        assert words in str(each.message)
