"""
Logs that others recorded and published, each with its source, licence, checksum and recipe.

They are fetched by hand into the folder public_logs of data/external (or of TRUSTLAB_DATA) and
never committed; a log that is not there is skipped. Oracle: the same columns by way of each
format's own library, or of pandas; and what is known of the robots: how a follower was programmed,
that distance is the integral of speed.
"""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from trustlab.sessions import external_data, read_session
from trustlab.sessions.recipe import Recipe

# ROS 1: an operator leads a turtle through turtlesim, and another follows it on /tf (the tutorial
# of tf, recorded in 2014).
TURTLES = """
kind = "bag"
[resampling]
method = "linear"
sample_time = 0.05
[columns]
mode = { value = 0 }
robot_x = { topic = "/turtle2/pose", field = "x", unit = "m" }
robot_y = { topic = "/turtle2/pose", field = "y", unit = "m" }
yaw = { topic = "/turtle2/pose", field = "theta", unit = "rad" }
v_command = { topic = "/turtle1/cmd_vel", field = "linear.x", unit = "m/s", hold = true }
w_command = { topic = "/turtle1/cmd_vel", field = "angular.z", unit = "rad/s", hold = true }
path_error = { distance = ["robot", "human"], axes = ["x", "y"] }
step_distance = { travelled = "robot", axes = ["x", "y"] }
[columns.human_x]
topic = "/tf"
field = 'transforms[child_frame_id="turtle1"].transform.translation.x'
unit = "m"
[columns.human_y]
topic = "/tf"
field = 'transforms[child_frame_id="turtle1"].transform.translation.y'
unit = "m"
"""
# By name: the SHA-256 and our recipe.
LOGS = {
    # https://github.com/facontidavide/PlotJuggler at ddcbd05b: datasamples/example.bag; MPL-2.0.
    "example.bag": (
        "6f8b495a7215a03099836955e1ffbf80f2abaff7f8bd65a1bdf9e52c809cef5d",
        TURTLES,
    ),
}


def public(name):
    """
    Return the path of a log and its recipe; skip where it is absent, fail where it is another file.
    """
    (digest, recipe), folder = LOGS[name], external_data("public_logs")
    if folder is None or not (folder / name).is_file():
        pytest.skip(f"needs public logs, listed with sources in {Path(__file__).name}")
    assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    return folder / name, Recipe.from_toml(recipe)


def test_a_turtle_that_follows_another():
    path, recipe = public("example.bag")
    session = read_session(path, recipe=recipe)
    times, heights = [], []
    with AnyReader([path]) as reader:
        for connection, stamp, data in reader.messages():
            if connection.topic == "/turtle2/pose":
                times.append(stamp / 1e9 - session.metadata.more["start_time"])
                heights.append(reader.deserialize(data, connection.msgtype).y)
    np.testing.assert_allclose(session["robot_y"], np.interp(session.t, times, heights), atol=1e-5)
    notes = session.metadata.more
    assert notes['selected /tf[child_frame_id="turtle1"]'] == "1344 of 2688 messages have the entry"
    # The window of turtlesim is 11.1 m wide.
    places = session.data[["robot_x", "robot_y", "human_x", "human_y"]].to_numpy()
    assert places.min() >= 0.0
    assert places.max() < 11.1
