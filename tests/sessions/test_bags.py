"""ROS bags as a lab records them, written by rosbags. Oracle: the numbers written."""

import math

import numpy as np
import pytest

from tests.sessions.logs import (
    NUMBER,
    START,
    TEXT,
    Bag,
    bag_of_numbers,
    bag_recipe,
    stamped,
)
from trustlab.sessions import RecipeError, SessionError, read_session, read_sessions

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
        np.testing.assert_allclose(session[column], values, rtol=1e-12, atol=1e-9, err_msg=column)
    np.testing.assert_allclose(session["u_h_x"], t, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.cos(session["yaw"] - (3.0 + 0.2 * t)), 1.0)
    assert np.abs(session["yaw"]).max() <= np.pi
    more = session.metadata.more
    assert more["start_time"] == pytest.approx(START / 1e9, abs=1e-6)
    assert more["resampled"] == "linear at 0.1 s; longest gap in the log 0.1 s"


def test_header_stamps(tmp_path):
    path = lab_bag(tmp_path / "lab.mcap").write()
    text = COLUMNS + RESAMPLED + '[time]\ntopics = { "/odom" = "header" }\n'
    session = read_session(path, bag_recipe(text))
    # Stamps stand 5 ms before receipt, and the overlap starts with /odom.
    assert session.metadata.more["start_time"] == pytest.approx((START - 5e6) / 1e9, abs=1e-6)
    np.testing.assert_allclose(session["robot_x"], session.t, atol=1e-9)
    np.testing.assert_allclose(session["reference_x"], session.t - 0.005, atol=1e-9)


def test_topics_with_the_same_stamps_need_no_resampling(tmp_path):
    path, recipe = lab_bag(tmp_path / "lab.mcap").write(), bag_recipe(COLUMNS)
    session = read_session(path, recipe, columns=["reference_x", "w_command"])
    np.testing.assert_allclose(session.t, np.arange(25) * 0.1, atol=1e-12)
    assert "resampled" not in session.metadata.more
    words = r"'/reference' and '/odom' have stamps of their own.*\[resampling\]"
    with pytest.raises(RecipeError, match=words):
        read_session(path, recipe, columns=["reference_x", "robot_x"])
    called = read_session(path, recipe, resample="nearest", sample_time=0.5)
    assert called["mode"].tolist() == [1, 1, 0, 1, 1]


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("stamp", [25.0, 29.9, 30.0, 30.1])
def test_a_message_that_holds_into_the_end_of_a_gap(tmp_path, name, stamp):
    """Modes are held, at 0 to 20 s and 30 to 40 s of measurements."""
    (tmp_path / "logs").mkdir()
    bag = Bag(tmp_path / "logs" / name)
    for t in [*range(21), *range(30, 41)]:
        bag.add("/p", t, NUMBER, data=0.01 * t)
    for t, mode in ((0.0, 0.0), (10.0, 1.0), (stamp, 0.0)):
        bag.add("/mode", t, NUMBER, data=mode)
    bag.write()
    recipe = bag_recipe(f"""[files]
pattern = "{name}"
[splitting]
gap = 5.0
[resampling]
method = "previous"
sample_time = 1.0
[columns]
p_r = {{ topic = "/p", field = "data" }}
mode = {{ topic = "/mode", field = "data", hold = true }}""")
    before, after = read_sessions(tmp_path / "logs", recipe)
    np.testing.assert_allclose(before.t, np.arange(21), atol=1e-9)
    assert before["mode"].tolist() == [0.0] * 10 + [1.0] * 11
    # The topics overlap from the later of their first samples on.
    np.testing.assert_allclose(after.t, np.arange(30, 41), atol=1e-9)
    np.testing.assert_allclose(after["p_r"], 0.01 * np.arange(30, 41), atol=1e-12)
    assert after["mode"].tolist() == [float(stamp > 30.0)] + [0.0] * 10


TF = """[columns.robot_x]
topic = "/tf"
field = 'transforms[child_frame_id="turtle1"].transform.translation.x'
unit = "m"
"""


@pytest.fixture
def turtles(tmp_path):
    """/tf as two robots publish it: in turn, and once together."""
    bag = Bag(tmp_path / "turtles")
    for k in range(20):
        own = {"child_frame_id": "turtle1", "transform": {"translation": {"x": 0.1 * k}}}
        other = {"child_frame_id": "turtle2", "transform": {"translation": {"x": -1.0}}}
        frames = [other, own] if k == 6 else [own] if k % 2 == 0 else [other]
        bag.add("/tf", k / 10, "tf2_msgs/msg/TFMessage", transforms=frames)
    return bag.write()


def test_one_robot_of_two_on_tf(turtles):
    session = read_session(turtles, bag_recipe(TF))
    assert session["robot_x"].tolist() == [0.1 * k for k in range(0, 20, 2)]
    np.testing.assert_allclose(session.t, 0.2 * np.arange(10), atol=1e-9)
    notes = [text for name, text in session.metadata.more.items() if name.startswith("selected")]
    assert notes == ["10 of 20 messages have the entry"]
    first = bag_recipe(TF.replace('[child_frame_id="turtle1"]', "[0]"))
    with pytest.raises(SessionError, match=r"message 1 .*frame 'turtle2' here, and of 'turtle1'"):
        read_session(turtles, first)


def test_a_path_that_sqlite_would_misread_is_named_and_the_bag_not_called_damaged(turtles):
    elsewhere = turtles.parent / "why?"
    elsewhere.mkdir()
    with pytest.raises(SessionError, match=r"cannot be read where its path has . or #; rename"):
        read_session(turtles.rename(elsewhere / "turtles"), bag_recipe(TF))


ERROR = '[columns]\npath_error = { topic = "/e", field = "data", unit = "m" }\n'


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
    path = bag_of_numbers(tmp_path / name, times, values=values)
    with pytest.raises(SessionError, match=words):
        read_session(path, bag_recipe(ERROR))


def test_topics_that_cannot_be_used(tmp_path):
    bag = Bag(tmp_path / "lab.mcap")
    for k in range(3):
        bag.add("/e", k / 10, NUMBER, data=1.0)
        bag.add("/f", 0.5 + k / 10, NUMBER, data=1.0)
    bag.add("/two", 0.0, NUMBER)
    bag.add("/two", 0.1, TEXT)
    path = bag.write()
    late = ERROR + 'p_r = { topic = "/f", field = "data" }\n' + RESAMPLED
    with pytest.raises(SessionError, match=r"do not overlap: '/e' ends 0\.3 s before '/f' starts"):
        read_session(path, bag_recipe(late))
    with pytest.raises(SessionError, match="'/two' has messages of two types"):
        read_session(path, bag_recipe(ERROR.replace("/e", "/two")))


def test_missing_pages_of_a_database_would_read_as_zeros(tmp_path, monkeypatch):
    values = np.arange(1.0, 361.0)
    path = bag_of_numbers(tmp_path / "a", np.arange(360), values=values)
    file = next(path.glob("*.db3"))
    data = file.read_bytes()
    for size in (0, 50, len(data) // 2, len(data) - 7):
        file.write_bytes(data[:size])
        with pytest.raises(SessionError, match="damaged or truncated"):
            read_session(path, bag_recipe(ERROR))
    # Negative control: without the check of its size, a number is another one.
    monkeypatch.setattr("trustlab.sessions.bags._check_database", lambda file: None)
    assert (read_session(path, bag_recipe(ERROR))["path_error"] != values).sum() == 1


@pytest.mark.parametrize("resampled", [True, False])
@pytest.mark.parametrize("stray", [5.0, 5.04])
def test_a_stray_message_on_each_topic_makes_no_part(tmp_path, resampled, stray):
    """It made the whole log unreadable."""
    bag = Bag(tmp_path / "a.mcap")
    for topic, between in (("/e", 5.0), ("/p", stray if resampled else 5.0)):
        for t in [*np.arange(20) / 10, between, *(9 + np.arange(20) / 10)]:
            bag.add(topic, t, NUMBER, data=0.5)
    bag.write()
    text = f'[files]\npattern = "a.mcap"\n{RESAMPLED if resampled else ""}[splitting]\ngap = 1.0\n'
    recipe = bag_recipe(text + ERROR + 'p_r = { topic = "/p", field = "data" }\n')
    sessions = read_sessions(tmp_path, recipe)
    assert [len(session) for session in sessions] == [20, 20]
    assert sessions[0].metadata.more["split"].endswith("1 too short")


@pytest.mark.parametrize(("late", "cut"), [(-2.0, None), (0.04, None), (2.0, True)])
def test_means_that_began_before_the_other_topics_are_noted(tmp_path, late, cut):
    """The fit took the first of them for one over a single sample."""
    bag = Bag(tmp_path / "a.mcap")
    for t in np.arange(100) / 10:
        bag.add("/p", t, NUMBER, data=0.5)
        bag.add("/e", t + late, NUMBER, data=0.5)
    text = f"performance_window = 5\n{RESAMPLED}{ERROR}"
    recipe = bag_recipe(text + 'p_r = { topic = "/p", field = "data" }\n')
    session = read_session(bag.write(), recipe)
    assert session.metadata.more.get("performance_cut") is cut


@pytest.mark.parametrize("other", ["", ", hold = true"])
def test_a_column_holds_its_last_value_only_where_its_own_rule_says(tmp_path, other):
    """The speed of a topic went on where the mode of the same topic was held."""
    bag = Bag(tmp_path / "a.mcap")
    for t in np.arange(31) / 10:
        bag.add("/p", t, NUMBER, data=0.5)
        if t < 1.05:
            bag.add("/base", t, "geometry_msgs/msg/Twist", linear={"x": t}, angular={"z": 1.0})
    columns = f"""robot_x = {{ topic = "/base", field = "linear.x", unit = "m"{other} }}
mode = {{ topic = "/base", field = "angular.z", hold = true }}
p_r = {{ topic = "/p", field = "data" }}
"""
    session = read_session(bag.write(), bag_recipe(RESAMPLED + "[columns]\n" + columns))
    assert session.t[-1] == pytest.approx(3.0 if other else 1.0)


@pytest.mark.parametrize("norm", [0.991, 1.0, 1.009])
def test_a_heading_is_that_of_the_quaternion_whatever_its_norm(tmp_path, norm):
    """Oracle: the quaternion of a turn; it was wrong by up to a degree."""
    angles = np.linspace(-3.1, 3.1, 20)
    bag = Bag(tmp_path / "a.mcap")
    for k, angle in enumerate(angles):
        quaternion = {name: norm * value for name, value in turn(angle).items()}
        bag.add("/q", k / 10, "geometry_msgs/msg/Pose", orientation=quaternion)
    text = '[columns]\nyaw = { topic = "/q", field = "yaw(orientation)" }\n'
    np.testing.assert_allclose(read_session(bag.write(), bag_recipe(text))["yaw"], angles)


@pytest.mark.parametrize(
    ("pausing", "told"), [("ep", ["/e", "/p"]), ("p", ["/p"]), ("m", []), ("", [])]
)
def test_a_gap_that_resampling_bridges_in_a_topic_is_told(tmp_path, recwarn, pausing, told):
    """Only that of a table or of a single topic was."""
    bag = Bag(tmp_path / "a.mcap")
    for t in np.arange(100) / 10:
        for topic in "epm":
            if not (topic in pausing and 3.0 < t < 6.0):
                bag.add(f"/{topic}", t, NUMBER, data=0.5)
    text = """p_r = { topic = "/p", field = "data" }
mode = { topic = "/m", field = "data", above = 0.1, hold = true }
"""
    read_session(bag.write(), bag_recipe(RESAMPLED + ERROR + text))
    assert len(recwarn) == len(told)
    for each, topic in zip(recwarn, told, strict=True):
        words = f"a.mcap {topic}: resampling bridges a gap of 3 s at t = 3 s; if the log"
        assert words in str(each.message)
