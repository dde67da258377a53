"""
Logs that others recorded and published, each with its source, checksum and recipe.

They are fetched by hand into the folder public_logs of data/external (or of TRUSTLAB_DATA) and never committed; a log that
is not there is skipped. Oracle: the same columns by way of each format's own library, or of pandas.
"""

import hashlib

import numpy as np
import pandas as pd
import pytest

from trustlab.sessions import external_data, read_session, read_sessions
from trustlab.sessions.recipe import Recipe

PX4 = """
kind = "bag"
[resampling]
method = "linear"
sample_time = 0.1
[columns]
mode = { topic = "vehicle_control_mode", field = "flag_control_manual_enabled", hold = true }
robot_z = { topic = "vehicle_local_position", field = "z", unit = "m" }
v_command = { topic = "manual_control_setpoint", field = "x", unit = "m/s", resample = "previous" }
"""
EEG = """
kind = "bag"
[splitting]
gap = 1.0
[resampling]
method = "linear"
sample_time = 0.01
[columns]
p_r = { topic = "BioSemi", field = "channel[0]" }
"""
DEMO = """
kind = "table"
[time]
column = "time"
unit = "s"
[columns]
p_r = { column = "sine_a" }
p_h = { column = "sine_b" }
mode = { column = "status_flags", map = { 0x00 = 0, 0x02 = 0, 0x11 = 1, 0x31 = 1 } }
"""
JOINTS = """
kind = "bag"
[time]
stamp = "header"
[resampling]
method = "previous"
sample_time = 0.01
[columns]
p_r = { topic = "/fake_joints_state", field = 'position[name="joint_3"]' }
"""
MOTOR = """
kind = "table"
[time]
column = "t"
unit = "s"
repeated = "first"
[resampling]
method = "linear"
sample_time = 0.001
[columns]
v_command = { column = "velocity", unit = "m/s" }
p_r = { column = "motor_speed", scale = 0.001 }
"""
LOGS = {
    "fake_joint_state.bag": (
        "https://github.com/facontidavide/PlotJuggler, datasamples/fake_joint_state.bag at ddcbd05b",
        "8468b520caf307e5835a52a1701e55ef4c20a17526f62ad14b5b95a1ddae6413",
        JOINTS,
    ),
    "motor_data.csv": (
        "https://github.com/facontidavide/PlotJuggler, datasamples/motor_data.csv at ddcbd05b",
        "fc261901c81fa9b634a1e27b18af3626a6947ee4b29783ed77df975bd4478b61",
        MOTOR,
    ),
    "sample_log_small.ulg": (
        "https://github.com/PX4/pyulog, test/sample_log_small.ulg at 3cf1779",
        "68d1020f688109f027dba08d2950247cc0ae34aaefdcf37e4a7d60838f3e1aa3",
        PX4,
    ),
    "clock_resets.xdf": (
        "https://github.com/xdf-modules/example-files, clock_resets.xdf at 76a6be7",
        "88536b24df4ed09082a00b04c31f65fd2447fa7acb8b929ec264ff8fac29ccec",
        EEG,
    ),
    "annotations_demo.csv": (
        "https://github.com/facontidavide/PlotJuggler, datasamples/annotations_demo.csv at 5510257",
        "e01381af39a0ee7bf0b6f94d29cf3ee4ab9b9cd82d1a1a5518128c34615247e9",
        DEMO,
    ),
}


def public(name):
    """Return the path of a log and its recipe; skip where it is absent, fail where it is another file."""
    source, digest, text = LOGS[name]
    folder = external_data("public_logs")
    if folder is None or not (folder / name).is_file():
        pytest.skip(f"{name} is not there; it comes from {source}")
    assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    return folder / name, Recipe.from_toml(text)


def test_a_flight_logged_by_px4():
    path, recipe = public("sample_log_small.ulg")
    session = read_session(path, recipe=recipe)
    from pyulog import ULog

    own = {data.name: data.data for data in ULog(str(path)).data_list if data.multi_id == 0}
    start = session.metadata.more["start_time"]
    position = own["vehicle_local_position"]
    expected = np.interp(session.t + start, position["timestamp"] / 1e6, position["z"])
    np.testing.assert_allclose(session["robot_z"], expected, atol=1e-6)
    assert set(session["mode"]) == {1.0}
    assert session["v_command"].min() == own["manual_control_setpoint"]["x"].min()
    with pytest.raises(ValueError, match=r"'vehicle_local_positon'.*did you mean 'vehicle_local_position'"):
        read_session(path, recipe=Recipe.from_toml(PX4.replace("_position", "_positon")))


def test_an_electroencephalogram_whose_clock_was_reset(tmp_path):
    path, _ = public("clock_resets.xdf")
    import pyxdf

    own = next(
        each for each in pyxdf.load_xdf(str(path), dejitter_timestamps=False)[0] if len(each["time_series"]) > 999
    )
    (tmp_path / path.name).symlink_to(path)
    text = EEG.replace('kind = "bag"', 'kind = "bag"\n[files]\npattern = "clock_resets.xdf"')
    sessions = read_sessions(tmp_path, recipe=Recipe.from_toml(text))
    gaps = np.flatnonzero(np.diff(own["time_stamps"]) > 1.0)
    assert len(sessions) == gaps.size + 1
    first = sessions[0]
    times = own["time_stamps"] - first.metadata.more["start_time"]
    np.testing.assert_allclose(first["p_r"], np.interp(first.t, times, own["time_series"][:, 0]), atol=1e-6)
    assert first.metadata.more["clocks"].startswith("brought together")


def test_an_export_in_the_manner_of_plotjuggler():
    path, recipe = public("annotations_demo.csv")
    session, frame = read_session(path, recipe=recipe), pd.read_csv(path)
    np.testing.assert_array_equal(session["p_r"], frame["sine_a"])
    np.testing.assert_array_equal(session["mode"], [int(flag, 16) & 1 for flag in frame["status_flags"]])


def test_a_bag_of_joints_selected_by_name():
    path, recipe = public("fake_joint_state.bag")
    session = read_session(path, recipe=recipe)
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        own = [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages()]
    stamps = np.array([message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in own])
    times = (stamps - stamps[0]) / 1e9
    positions = np.array([message.position[message.name.index("joint_3")] for message in own])
    held = positions[np.searchsorted(times, session.t + 1e-8, side="right") - 1]
    np.testing.assert_array_equal(session["p_r"], held)
    assert session.metadata.more["start_time"] == stamps[0] / 1e9


def test_a_motor_logged_at_a_kilohertz():
    path, recipe = public("motor_data.csv")
    session, frame = read_session(path, recipe=recipe), pd.read_csv(path).drop_duplicates("t")
    np.testing.assert_allclose(session["v_command"], np.interp(session.t, frame["t"], frame["velocity"]), atol=1e-9)
    np.testing.assert_allclose(
        session["p_r"], 0.001 * np.interp(session.t, frame["t"], frame["motor_speed"]), atol=1e-9
    )
