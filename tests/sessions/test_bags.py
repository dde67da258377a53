"""
ROS 1 and ROS 2 bags of a lab, written here with the public message definitions. Oracle: the numbers
written.
"""

import math
import shutil

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from trustlab.sessions.metadata import metadata_to_json

from trustlab.sessions import RecipeError, SessionError, read_session, read_sessions, write_session
from trustlab.sessions.recipe import Recipe

START = 1_700_000_000_123_456_789  # [ns]
KINDS = ["lab.bag", "lab.mcap", "lab"]


class Bag:
    """Write messages of any topic to a bag of any kind."""

    def __init__(self, path):
        self.path = path
        self.ros1 = path.suffix == ".bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        self.entries = []

    def make(self, kind, **fields):
        kind = {"Odometry": "nav_msgs/msg/Odometry", "Joy": "sensor_msgs/msg/Joy"}.get(kind, kind)
        for package in ("", "builtin_interfaces/msg/", "std_msgs/msg/", "geometry_msgs/msg/"):
            if package + kind in self.store.types:
                return self.store.types[package + kind](**fields)
        raise KeyError(kind)

    def header(self, stamp):
        extra = {"seq": 0} if self.ros1 else {}
        time = self.make("Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        return self.make("Header", stamp=time, frame_id="map", **extra)

    def xyz(self, x, y=0.0, z=0.0, kind="Point"):
        return self.make(kind, x=float(x), y=float(y), z=float(z))

    def turn(self, yaw):
        return self.make("Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))

    def pose(self, x, y, yaw=0.0):
        return self.make("Pose", position=self.xyz(x, y), orientation=self.turn(yaw))

    def twist(self, v, w):
        return self.make(
            "Twist", linear=self.xyz(v, kind="Vector3"), angular=self.xyz(0, 0, w, kind="Vector3")
        )

    def odometry(self, stamp, x, y, yaw, v=0.0):
        covariance = np.zeros(36)
        pose = self.make("PoseWithCovariance", pose=self.pose(x, y, yaw), covariance=covariance)
        twist = self.make("TwistWithCovariance", twist=self.twist(v, 0.0), covariance=covariance)
        return self.make(
            "Odometry", header=self.header(stamp), child_frame_id="base", pose=pose, twist=twist
        )

    def add(self, topic, seconds, message):
        self.entries.append((topic, START + round(seconds * 1e9), message))

    def write(self):
        if self.path.suffix == ".mcap":
            folder = self.path.with_suffix(".folder")
            self._write(Writer2(folder, version=8, storage_plugin=StoragePlugin.MCAP))
            next(folder.glob("*.mcap")).rename(self.path)
            shutil.rmtree(folder)
        else:
            self._write(Writer1(self.path) if self.ros1 else Writer2(self.path, version=8))
        return self.path

    def _write(self, writer):
        connections = {}
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        with writer:
            for topic, stamp, message in self.entries:
                kind = message.__msgtype__
                if (topic, kind) not in connections:
                    connections[topic, kind] = writer.add_connection(
                        topic, kind, typestore=self.store
                    )
                writer.write(connections[topic, kind], stamp, serialize(message, kind))


COLUMNS = """
kind = "bag"
[columns]
mode = { topic = "/drive_mode", field = "data", map = { MANUAL = 1, AUTO = 0 }, hold = true }
robot_x = { topic = "/odom", field = "pose.pose.position.x", unit = "m" }
robot_y = { topic = "/odom", field = "pose.pose.position.y", unit = "m" }
velocity_x = { topic = "/odom", field = "twist.twist.linear.x", unit = "m/s" }
yaw = { topic = "/odom", field = "yaw(pose.pose.orientation)" }
reference_x = { topic = "/reference", field = "pose.position.x", unit = "cm" }
reference_y = { topic = "/reference", field = "pose.position.y", unit = "cm" }
w_command = { topic = "/cmd_vel", field = "angular.z", unit = "deg/s" }
u_h_x = { topic = "/joy", field = "axes[1]" }
suggested_mode = { topic = "/joy", field = "buttons[2]" }
r = { topic = "/load", field = "data" }
beta = { topic = "/on", field = "data" }
path_error = { distance = ["robot", "reference"], axes = ["x", "y"] }
step_distance = { travelled = "robot", axes = ["x", "y"] }
"""
RESAMPLED = "[resampling]\nmethod = 'linear'\nsample_time = 0.1\n"


def lab_bag(path):
    """
    Return a bag of 2 s: odometry at 50 Hz, its stamps 5 ms before receipt, everything else at rates
    of its own.
    """
    bag = Bag(path)
    for k in range(101):
        t = 0.02 * k
        bag.add(
            "/odom", t, bag.odometry(START + round((t - 0.005) * 1e9), t, 0.0, 3.0 + 0.2 * t, v=1.0)
        )
    for k in range(25):
        t = -0.1 + 0.1 * k
        bag.add(
            "/reference",
            t,
            bag.make("PoseStamped", header=bag.header(START), pose=bag.pose(100 * t, 30.0)),
        )
        bag.add("/cmd_vel", t, bag.twist(0.0, 180.0 * t))
        axes = np.array([0.0, t, 1.0], dtype=np.float32)
        buttons = np.array([0, 0, int(t > 0.95)], dtype=np.int32)
        bag.add("/joy", t, bag.make("Joy", header=bag.header(START), axes=axes, buttons=buttons))
        bag.add("/load", t, bag.make("Float64", data=0.25 + t / 10))
        bag.add("/on", t, bag.make("Bool", data=True))
    for t, text in [(-1.0, "MANUAL"), (0.55, "AUTO"), (1.25, "MANUAL")]:
        bag.add("/drive_mode", t, bag.make("String", data=text))
    return bag


@pytest.mark.parametrize("name", KINDS)
def test_a_lab_bag(tmp_path, name):
    session = read_session(
        lab_bag(tmp_path / name).write(), recipe=Recipe.from_toml(COLUMNS + RESAMPLED)
    )
    t = np.arange(21) * 0.1
    close = {"rtol": 1e-12, "atol": 1e-9}
    np.testing.assert_allclose(session.t, t, **close)
    np.testing.assert_allclose(session["robot_x"], t, **close)
    np.testing.assert_allclose(session["velocity_x"], 1.0)
    np.testing.assert_allclose(np.cos(session["yaw"] - (3.0 + 0.2 * t)), 1.0)
    assert np.abs(session["yaw"]).max() <= np.pi
    np.testing.assert_allclose(session["reference_x"], t, **close)
    np.testing.assert_allclose(session["path_error"], 0.3, **close)
    np.testing.assert_allclose(session["step_distance"], np.full(21, 0.1), **close)
    np.testing.assert_allclose(session["w_command"], np.pi * t, **close)
    np.testing.assert_allclose(session["u_h_x"], t, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(session["r"], 0.25 + t / 10, **close)
    np.testing.assert_array_equal(session["beta"], 1.0)
    # States are held, and the last message of the mode holds to the end.
    np.testing.assert_array_equal(session["mode"], np.where((t > 0.55) & (t < 1.25), 0.0, 1.0))
    np.testing.assert_array_equal(session["suggested_mode"], t > 0.95)
    more = session.metadata.more
    assert more["start_time"] == pytest.approx(START / 1e9, abs=1e-6)
    assert more["resampled"] == "linear at 0.1 s; longest gap in the log 0.1 s"


def test_all_kinds_of_bag_agree(tmp_path):
    recipe = Recipe.from_toml(COLUMNS + RESAMPLED)
    first, *others = [
        read_session(lab_bag(tmp_path / name).write(), recipe=recipe) for name in KINDS
    ]
    assert first == others[0] == others[1]


def test_header_stamps(tmp_path):
    text = COLUMNS + RESAMPLED + '[time]\nstamp = "receive"\ntopics = { "/odom" = "header" }\n'
    session = read_session(lab_bag(tmp_path / "lab.mcap").write(), recipe=Recipe.from_toml(text))
    # Stamps stand 5 ms before receipt: at the same clock the robot is 5 ms further. The overlap
    # starts with /odom.
    assert session.metadata.more["start_time"] == pytest.approx((START - 5_000_000) / 1e9, abs=1e-6)
    np.testing.assert_allclose(session["robot_x"], session.t, atol=1e-9)
    np.testing.assert_allclose(session["reference_x"], session.t - 0.005, atol=1e-9)
    recipe = Recipe.from_toml(COLUMNS + RESAMPLED + '[time]\nstamp = "header"\n')
    with pytest.raises(
        RecipeError, match=r"'/drive_mode', message 0 .*std_msgs/msg/String has no header stamp"
    ):
        read_session(tmp_path / "lab.mcap", recipe=recipe)


def test_topics_with_the_same_stamps_need_no_resampling(tmp_path):
    path = lab_bag(tmp_path / "lab.mcap").write()
    recipe = Recipe.from_toml(COLUMNS)
    session = read_session(path, recipe=recipe, columns=["reference_x", "w_command"])
    assert len(session) == 25
    np.testing.assert_allclose(session.t, np.arange(25) * 0.1, atol=1e-12)
    assert "resampled" not in session.metadata.more
    with pytest.raises(
        RecipeError, match=r"'/reference' and '/odom' have stamps of their own.*\[resampling\]"
    ):
        read_session(path, recipe=recipe, columns=["reference_x", "robot_x"])
    with pytest.raises(RecipeError, match="stamps of their own"):
        read_session(path, recipe=recipe)
    called = read_session(path, recipe=recipe, resample="nearest", sample_time=0.5)
    np.testing.assert_array_equal(called["mode"], [1, 1, 0, 1, 1])


def fails(path, recipe, *fragments, error=SessionError, **options):
    if isinstance(recipe, str):
        recipe = Recipe.from_toml(recipe)
    with pytest.raises(error) as caught:
        read_session(path, recipe=recipe, **options)
    for fragment in [path.name, *fragments]:
        assert fragment in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "fragments"),
    [
        (
            '"/odom", field = "twist',
            '"/odm", field = "twist',
            ["'/odm'", "velocity_x", "did you mean '/odom'"],
        ),
        (
            "twist.twist.linear.x",
            "twist.linear.x",
            ["'/odom'", "nav_msgs/msg/Odometry", "has no field 'linear'"],
        ),
        (
            "twist.twist.linear.x",
            "twist.twist.linear.xx",
            ["nav_msgs/msg/Odometry", "did you mean 'x'"],
        ),
        ("twist.twist.linear.x", "twist.twist.linear", ["not a number", "name one number"]),
        ("twist.twist.linear.x", "twist.twist.linear.x[0]", ["[0] needs a list"]),
        ("twist.twist.linear.x", "child_frame_id", ["str", "give it a map"]),
        ("axes[1]", "axes[3]", ["'/joy', message 0", "3 entries", "[3]"]),
        ("axes[1]", "axes", ["not a number"]),
        ("yaw(pose.pose.orientation)", "yaw(pose.pose.position)", ["needs a quaternion"]),
        (
            "MANUAL = 1",
            "MANAUL = 1",
            ["'/drive_mode', message 0", "'MANUAL'", "not in the recipe's map"],
        ),
        (
            "hold = true",
            "hold = true, resample = 'linear'",
            ["mode", "hold keeps the previous value"],
        ),
    ],
)
def test_a_recipe_that_does_not_fit(tmp_path, old, new, fragments):
    assert old in COLUMNS
    path = lab_bag(tmp_path / "lab.mcap").write()
    with pytest.raises(SessionError) as caught:
        read_session(path, recipe=Recipe.from_toml(COLUMNS.replace(old, new) + RESAMPLED))
    for fragment in fragments:
        assert fragment in str(caught.value)


ONE = 'kind = "bag"\n[columns]\n'
ERROR = ONE + 'path_error = { topic = "/e", field = "data", unit = "m" }\n'


def errors(path, values, times=None):
    bag = Bag(path)
    for k, value in enumerate(values):
        bag.add(
            "/e", 0.1 * k if times is None else times[k], bag.make("Float64", data=float(value))
        )
    return bag


@pytest.mark.parametrize("name", KINDS)
def test_faults_of_the_messages(tmp_path, name):
    path = errors(tmp_path / name, [0.0, 1.0, math.nan, -1.0]).write()
    fails(path, ERROR, "'/e', message 2", "'path_error'", "t = 0.2 s", "nan is missing")
    fails(path, ERROR, "'/e', message 2", resample="nearest", sample_time=0.3)
    path = errors(tmp_path / f"b{name}", [0.0, 1.0, -2.0]).write()
    fails(path, ERROR, "'/e', message 2", "-2.0 lies outside")
    path = errors(tmp_path / f"c{name}", [0, 1, 2, 3, 4], [0, 0.1, 0.2, 0.3, 0.5]).write()
    fails(path, ERROR, "message 4", "irregular", "resample=")
    path = errors(tmp_path / f"d{name}", [0, 1, 2], [0, 0.1, 0.1]).write()
    fails(path, ERROR, "'/e', message 2", "time repeats", "other stamp")
    path = errors(tmp_path / f"e{name}", [0.0]).write()
    fails(path, ERROR, "at least two samples")


def test_stamps_that_run_backwards(tmp_path):
    bag = Bag(tmp_path / "a.mcap")
    for k, stamp in enumerate([0, 2, 1, 3]):
        bag.add("/odom", k, bag.odometry(START + stamp * 10**9, k, 0, 0))
    text = (
        ONE + 'robot_x = { topic = "/odom", field = "pose.pose.position.x", unit = "m" '
        '}\n[time]\nstamp = "header"\n'
    )
    fails(bag.write(), text, "'/odom', message 2", "runs backwards")


def test_a_quaternion_that_is_none(tmp_path):
    bag = Bag(tmp_path / "a.mcap")
    odometry = bag.odometry(START, 0, 0, 0)
    odometry.pose.pose.orientation.w = 0.0
    bag.add("/odom", 0.0, odometry)
    fails(
        bag.write(),
        ONE + 'yaw = { topic = "/odom", field = "yaw(pose.pose.orientation)" }',
        "message 0",
        "norm 0",
    )


@pytest.mark.parametrize("name", KINDS)
def test_topics_that_cannot_be_used(tmp_path, name):
    bag = errors(tmp_path / name, [0.0, 1.0, 2.0])
    bag.add("/f", 0.5, bag.make("Float64", data=0.0))
    bag.add("/f", 0.9, bag.make("Float64", data=0.0))
    bag.add("/two", 0.0, bag.make("Float64", data=0.0))
    bag.add("/two", 0.1, bag.make("String", data=""))
    path = bag.write()
    late = ERROR + 'r = { topic = "/f", field = "data" }\n' + RESAMPLED
    fails(path, late, "do not overlap", "'/e' ends 0.3 s before '/f' starts")
    fails(path, ERROR.replace("/e", "/two"), "'/two' has messages of two types")
    with pytest.raises(SessionError, match=r"needs a recipe \(topics: /e, /f, /two\)"):
        read_session(path)


def test_columns_of_which_none_comes_from_a_topic(tmp_path):
    recipe = Recipe.from_toml(ERROR + "beta = { value = 0.5 }\n")
    path = errors(tmp_path / "a.mcap", [0.0, 1.0, 2.0]).write()
    assert read_session(path, recipe=recipe, columns=["beta", "path_error"]).columns == [
        "beta",
        "path_error",
    ]
    with pytest.raises(SessionError, match="none of the columns to read comes from a topic"):
        read_session(path, recipe=recipe, columns=["beta"])


def test_a_topic_without_messages(tmp_path):
    path = tmp_path / "empty"
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(path, version=8) as writer:
        writer.add_connection("/e", "std_msgs/msg/Float64", typestore=store)
    fails(path, ERROR, "'/e' has no messages")


@pytest.mark.parametrize("name", ["own.bag", "own.mcap", "own", "own.csv", "own.parquet"])
def test_truncated(tmp_path, name):
    session = read_session(
        errors(tmp_path / "a.mcap", range(400)).write(), recipe=Recipe.from_toml(ERROR)
    )
    path = write_session(session, tmp_path / name)
    file = next(path.glob("*.db3")) if path.is_dir() else path
    data = file.read_bytes()
    for share in (0.0, 0.3, 0.6, 0.95, 0.9999):
        file.write_bytes(data[: int(share * len(data))])
        with pytest.raises(SessionError, match=r"own.*(empty|damaged|truncated|cut short)"):
            read_session(path)
    file.write_bytes(data)
    assert read_session(path) == session


def test_missing_pages_of_a_database_would_read_as_zeros(tmp_path, monkeypatch):
    # Negative control: without the check of its size, a truncated database gives zeros for what is
    # missing.
    session = read_session(
        errors(tmp_path / "a.mcap", range(1, 401)).write(), recipe=Recipe.from_toml(ERROR)
    )
    file = next(write_session(session, tmp_path / "own").glob("*.db3"))
    data = file.read_bytes()
    monkeypatch.setattr("trustlab.sessions.readers.bags._check_sqlite_size", lambda *args: None)
    monkeypatch.setattr("trustlab.sessions.readers.assembly._check_digests", lambda log: None)
    file.write_bytes(data[:-7])
    with pytest.raises(SessionError, match=r"column t: time runs backwards \(34.9 s, then 0.0 s\)"):
        read_session(tmp_path / "own")
    monkeypatch.undo()
    with pytest.raises(SessionError, match="truncated"):
        read_session(tmp_path / "own")


def test_what_is_missing_from_a_bag_of_ours_is_noticed(tmp_path, monkeypatch):
    # Negative control: with a count in the metadata that agrees, the same bag is read.
    session = read_session(
        errors(tmp_path / "a.mcap", range(40)).write(), recipe=Recipe.from_toml(ERROR)
    )
    to_json = "trustlab.sessions.writers.metadata_to_json"
    monkeypatch.setattr(
        to_json, lambda metadata, own, samples: metadata_to_json(metadata, own, samples=2 * samples)
    )
    path = write_session(session, tmp_path / "half.mcap")
    with pytest.raises(
        SessionError, match=r"'/trustlab/t' has 40 messages where the metadata say 80"
    ):
        read_session(path)
    monkeypatch.setattr(
        "trustlab.sessions.readers.bags.metadata_from_json",
        lambda text: (None, {"samples": 40, "digests": {}}),
    )
    assert len(read_session(path)) == 40


def test_a_count_that_the_index_denies(tmp_path):
    path = errors(tmp_path / "a", [0.0, 1.0, 2.0]).write()
    yaml = path / "metadata.yaml"
    yaml.write_text(yaml.read_text().replace("message_count: 3", "message_count: 4"))
    fails(path, ERROR, "'/e'", "counts 4 messages, but 3 are there")


def test_the_example_recipe_reads_folders_of_bags(tmp_path):
    for name in ("anna_run10", "anna_run2", "ben_run1.mcap", "ben_run3.bag"):
        bag = lab_bag(tmp_path / name)
        bag.entries = [entry for entry in bag.entries if entry[0] not in ("/reference",)]
        for k in range(25):
            t = -0.1 + 0.1 * k
            pose = bag.make(
                "PoseStamped", header=bag.header(START + round(t * 1e9)), pose=bag.pose(t, 0.3)
            )
            bag.add("/reference", t, pose)
        bag.write()
    (tmp_path / "cleo_run1.mcap").write_bytes(b"x")
    with pytest.raises(SessionError, match="not a bag"):
        read_sessions(tmp_path, recipe="ros_ground_robot")
    (tmp_path / "cleo_run1.mcap").unlink()
    sessions = read_sessions(tmp_path, recipe="ros_ground_robot")
    assert [(s.metadata.participant, s.metadata.more["trial"]) for s in sessions] == [
        ("anna", 2),
        ("anna", 10),
        ("ben", 1),
        ("ben", 3),
    ]
    assert sessions[0].sample_time == 0.1
    np.testing.assert_allclose(sessions[0]["path_error"], np.hypot(0.005, 0.3), atol=1e-2)
