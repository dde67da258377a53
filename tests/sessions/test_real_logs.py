"""
Real logs, where they are: the shared-control study of Pan et al. (2024), logs that others
published; and the synthetic ones that come with the package.

Oracles: headers and measures of the study's own; each format's own library, or pandas; what is
known of the robots; the script that makes the synthetic sessions.
"""

import hashlib
import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rosbags.highlevel import AnyReader

import trustlab as tl
from trustlab.sessions import (
    SessionError,
    external_data,
    read_session,
    read_sessions,
    tracking_error,
)
from trustlab.sessions.recipe import Recipe

# --- Pan et al. (2024) ----------------------------------------------------------------------------


DATA = external_data("autonomy_cl_trust")
NEEDED = pytest.mark.skipif(
    DATA is None,
    reason="needs the sessions of AutonomyCLTrust (docs/reports.md): TRUSTLAB_DATA=folder",
)


@pytest.fixture(scope="module")
def sessions():
    return read_sessions(DATA, recipe="autonomy_cl_trust")


@NEEDED
def test_what_there_is(sessions):
    assert [(s.metadata.participant, s.metadata.more["trial"]) for s in sessions] == [
        (participant, trial) for participant in range(1, 9) for trial in range(1, 31)
    ]
    for session in sessions:
        more = session.metadata.more
        assert session.metadata.condition == more["autonomy"]
        assert more["training"] == (more["trial"] <= 5)
        assert more["block"] == (more["trial"] - 1) // 5
        assert session.sample_time == pytest.approx(0.024)
        np.testing.assert_array_equal(session["mode"], round(1 - more["autonomy"], 1))
        # Column 10 is the distance in y and z.
        distance = np.hypot(
            session["robot_y"] - session["reference_y"], session["robot_z"] - session["reference_z"]
        )
        np.testing.assert_allclose(session["path_error"], distance, atol=1e-12)


@NEEDED
def test_the_robot_followed_the_mixture(sessions):
    # The recipe's reading of columns 0-8 and of alpha_id: robot = share · human + (1 − share) ·
    # reference.
    for session in sessions:
        for axis in "yz":
            share = session["mode"]
            mixture = share * session[f"human_{axis}"] + (1 - share) * session[f"reference_{axis}"]
            np.testing.assert_allclose(session[f"robot_{axis}"], mixture, atol=1e-9)


@NEEDED
def test_tracking_errors_are_the_published_ones(sessions):
    published = pd.read_csv(DATA / "measures" / "traj_err_all_levels.csv")
    both = tracking_error(sessions).merge(
        published.rename(columns={"pid": "participant"}), on=["participant", "autonomy"]
    )
    assert len(both) == 40
    np.testing.assert_allclose(both["traj_err_x"], both["traj_err_y"], rtol=0, atol=1e-9)


@NEEDED
def test_a_participant_who_was_replaced_is_not_known(tmp_path):
    shutil.copytree(DATA / "raw" / "part1", tmp_path / "part8")
    (tmp_path / "part8").chmod(0o755)
    (tmp_path / "part8" / "part1_header.csv").rename(tmp_path / "part8" / "part8_header.csv")
    with pytest.raises(SessionError, match=r"part8.*'participant' \(from folder\): '8' is not in"):
        read_sessions(tmp_path, recipe="autonomy_cl_trust")


# --- public logs ----------------------------------------------------------------------------------


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


# --- synthetic sessions ---------------------------------------------------------------------------


FOLDER = Path(__file__).parents[2] / "data" / "sessions"


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    spec = importlib.util.spec_from_file_location("make_sessions", FOLDER / "make_sessions.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    folder = tmp_path_factory.mktemp("sessions")
    module.main(folder)
    return folder


def test_committed_sessions_are_what_the_generator_makes(fresh):
    names = sorted(path.name for path in FOLDER.iterdir() if path.suffix in (".csv", ".parquet"))
    assert names == [*(f"participant_{k}.parquet" for k in range(1, 6)), "pilot.csv"]
    for name in names:
        kept, made = tl.read_session(FOLDER / name), tl.read_session(fresh / name)
        assert kept.with_metadata(source=None).metadata == made.with_metadata(source=None).metadata
        # Another platform's exp may differ in the last bit, which rounding to five decimals can
        # turn into one unit.
        np.testing.assert_allclose(kept.data, made.data, rtol=0, atol=1.1e-5)
        assert kept.metadata.synthetic
        assert kept.sample_time == 0.1
        assert np.count_nonzero(np.diff(kept["mode"])) >= 6


def test_the_pilot_is_the_file_of_the_repository_wherever_one_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = pd.read_csv(FOLDER / "pilot.csv", comment="#", index_col="t")
    session = tl.sessions.example("pilot")
    assert session.metadata.synthetic
    np.testing.assert_array_equal(session.data[["mode", "p_r", "p_h"]], file)
