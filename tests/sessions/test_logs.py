"""
Logs as labs have them: selected entries, blanks, repeats, odd times, gaps, joins, other formats.
"""

import contextlib
import gzip
import importlib.util
import queue
import sqlite3
from fractions import Fraction
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pandas as pd
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy import io

import trustlab as tl
from trustlab.sessions import (
    Metadata,
    RecipeError,
    Session,
    SessionError,
    join_sessions,
    read_frame,
    read_session,
)
from trustlab.sessions.patterns import FieldPath
from trustlab.sessions.recipe import Recipe

SPEC = importlib.util.spec_from_file_location("fuzz", Path(__file__).with_name("fuzz.py"))
fuzz = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(fuzz)

STORE = get_typestore(Stores.ROS2_HUMBLE)
SECOND = 10**9


def recipe(text, kind="table"):
    return Recipe.from_toml(f'kind = "{kind}"\n{text}')


def time(stamp):
    return STORE.types["builtin_interfaces/msg/Time"](sec=stamp // SECOND, nanosec=stamp % SECOND)


def header(stamp=0):
    return STORE.types["std_msgs/msg/Header"](stamp=time(stamp), frame_id="world")


def write_bag(path, messages, kinds, store=STORE):
    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in kinds.items()
        }
        for topic, stamp, message in messages:
            writer.write(topics[topic], stamp, store.serialize_cdr(message, kinds[topic]))
    return path


def frame_of(name, x):
    vector, turn = (
        STORE.types["geometry_msgs/msg/Vector3"],
        STORE.types["geometry_msgs/msg/Quaternion"],
    )
    transform = STORE.types["geometry_msgs/msg/Transform"](
        translation=vector(x=x, y=0.0, z=0.0), rotation=turn(x=0.0, y=0.0, z=0.0, w=1.0)
    )
    return STORE.types["geometry_msgs/msg/TransformStamped"](
        header=header(), child_frame_id=name, transform=transform
    )


TF = """
[columns.robot_x]
topic = "/tf"
field = 'transforms[child_frame_id="turtle1"].transform.translation.x'
unit = "m"
"""


@pytest.fixture
def turtles(tmp_path):
    """/tf as two robots publish it: in turn, and now and then together."""
    message = STORE.types["tf2_msgs/msg/TFMessage"]
    messages = []
    for k in range(20):
        frames = [frame_of("turtle1", 0.1 * k)] if k % 2 == 0 else [frame_of("turtle2", -1.0)]
        frames = [frame_of("turtle2", -1.0), frame_of("turtle1", 0.1 * k)] if k == 6 else frames
        messages.append(("/tf", k * SECOND // 10, message(transforms=frames)))
    return write_bag(tmp_path / "turtles", messages, {"/tf": "tf2_msgs/msg/TFMessage"})


def test_one_robot_of_two_on_tf(turtles):
    session = read_session(turtles, recipe=recipe(TF, "bag"))
    np.testing.assert_array_equal(session["robot_x"], 0.1 * np.arange(0, 20, 2))
    np.testing.assert_allclose(session.t, 0.2 * np.arange(10), atol=1e-9)
    (note,) = [
        value for name, value in session.metadata.more.items() if name.startswith("selected")
    ]
    assert note == "10 of 20 messages have the entry"
    for old, new, said in [
        ("turtle1", "turtle3", 'none of its 20 messages has an entry [child_frame_id="turtle3"]'),
        (
            '[child_frame_id="turtle1"]',
            "[0]",
            "of frame 'turtle2' here, and of 'turtle1' before; select one",
        ),
        ("child_frame_id", "child", "called 'child'"),
        (
            'transforms[child_frame_id="turtle1"]',
            'transform[child_frame_id="turtle1"]',
            "it has: transforms)",
        ),
    ]:
        with pytest.raises(SessionError) as caught:
            read_session(turtles, recipe=recipe(TF.replace(old, new), "bag"))
        assert said in str(caught.value)
        assert "__" not in str(caught.value)


def test_a_joint_by_its_name(tmp_path):
    joints = STORE.types["sensor_msgs/msg/JointState"]
    none = np.zeros(0)
    messages = []
    for k in range(4):
        names = ["wheel_left", "wheel_right"] if k % 2 else ["wheel_right", "wheel_left"]
        position = np.array([k, -k] if k % 2 else [-k, k], dtype=float)
        message = joints(header=header(), name=names, position=position, velocity=none, effort=none)
        messages.append(("/joints", k * SECOND, message))
    path = write_bag(tmp_path / "joints", messages, {"/joints": "sensor_msgs/msg/JointState"})
    text = "[columns]\np_r = { topic = '/joints', field = 'position[name=\"wheel_left\"]' }"
    np.testing.assert_array_equal(
        read_session(path, recipe=recipe(text, "bag"))["p_r"], [0.0, 1.0, 2.0, 3.0]
    )


@pytest.mark.parametrize(
    "text", ["a[b=c]", 'a[b="c"', "a..b", "[0]", "a[-1]", '[b="c"]', "a b", ""]
)
def test_field_paths_that_cannot_be_read(text):
    with pytest.raises(ValueError, match="cannot read the field path"):
        FieldPath(text)


def test_definitions_beside_a_bag_without(tmp_path):
    own = get_typestore(Stores.ROS2_HUMBLE)
    definition = "std_msgs/Header header\nfloat64 grip\n"
    own.register(get_types_from_msg(definition, "lab_msgs/msg/Hand"))
    hand = own.types["lab_msgs/msg/Hand"]
    messages = [("/hand", k * SECOND, hand(header=header(), grip=0.25 * k)) for k in range(3)]
    path = write_bag(tmp_path / "bag", messages, {"/hand": "lab_msgs/msg/Hand"}, own)
    # As ROS 2 before Iron wrote it: the database says the types' names only.
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("DELETE FROM message_definitions")
    text = 'kind = "bag"\n[columns]\np_r = { topic = "/hand", field = "grip" }\n'
    (tmp_path / "lab.toml").write_text(text)
    with pytest.raises(
        SessionError, match=r"no definition of lab_msgs/msg/Hand; put its \.msg files"
    ):
        read_session(path, recipe=tmp_path / "lab.toml")
    (tmp_path / "lab.toml").write_text(text + '[messages]\nfolder = "msgs"\n')
    with pytest.raises(RecipeError, match=r"no \.msg files"):
        read_session(path, recipe=tmp_path / "lab.toml")
    (tmp_path / "msgs" / "lab_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "msgs" / "lab_msgs" / "msg" / "Hand.msg").write_text(definition)
    assert read_session(path, recipe=tmp_path / "lab.toml")["p_r"].tolist() == [0.0, 0.25, 0.5]


BLANKS = """
[time]
unit = "s"
[columns]
p_r = { column = "slow", blank = "hold" }
p_h = { column = "even", blank = "linear" }
robot_x = { column = "fast", unit = "m" }
"""
ROWS = "t,slow,even,fast\n0,,,0\n1,5,1,1\n2,,,2\n3,,3,3\n4,7,,4\n5,,5,5\n6,,,6\n"


@pytest.mark.parametrize("suffix", [".csv", ".parquet", "frame"])
def test_blanks_of_columns_at_different_rates(tmp_path, suffix):
    """Oracle: filled by hand."""
    path = tmp_path / f"run{suffix}"
    path.write_text(ROWS)
    frame = pd.read_csv(path)
    if suffix == ".parquet":
        frame.to_parquet(path)
    read = (
        read_frame(frame, recipe(BLANKS))
        if suffix == "frame"
        else read_session(path, recipe=recipe(BLANKS))
    )
    assert read.t.tolist() == [1, 2, 3, 4, 5]
    assert read["p_r"].tolist() == [5, 5, 5, 7, 7]
    assert read["p_h"].tolist() == [1, 2, 3, 4, 5]
    more = read.metadata.more
    assert more["blanks of p_r"] == "5 of 7 cells, filled by 'hold'"
    assert more["blanks of p_h"] == "4 of 7 cells, filled by 'linear'"
    assert more["rows cut"].startswith("1 at the start and 1 at the end")
    bare = recipe(BLANKS.replace(', blank = "hold"', ""))
    with pytest.raises(SessionError, match=r"(is empty|is missing)"):
        read_frame(frame, bare) if suffix == "frame" else read_session(path, recipe=bare)


def test_a_fault_among_blanks_is_still_named(tmp_path):
    (tmp_path / "run.csv").write_text(ROWS.replace("4,7,", "4,x,"))
    with pytest.raises(SessionError, match=r"line 6, column 'slow' \(p_r\): 'x' is not a number"):
        read_session(tmp_path / "run.csv", recipe=recipe(BLANKS))


@pytest.mark.parametrize(
    ("rule", "expected"), [("first", [1, 2, 5]), ("last", [1, 4, 5]), ("mean", [1, 3, 5])]
)
def test_repeated_times(tmp_path, rule, expected):
    text = (
        '[time]\nunit = "s"\nrepeated = "{}"\n[columns]\np_r = {{ column = "a" }}\nmode '
        '= {{ column = "m" }}'
    )
    (tmp_path / "run.csv").write_text("t,a,m\n0,1,0\n1,2,0\n1,3,0\n1,4,1\n2,5,1\n")
    session = read_session(tmp_path / "run.csv", recipe=recipe(text.format(rule)))
    assert session["p_r"].tolist() == expected
    assert session["mode"].tolist() == [
        0,
        0 if rule == "first" else 1,
        1,
    ]  # a mean of states would be none
    assert session.metadata.more["repeated times"] == f"2 of 5 samples merged by '{rule}'"
    with pytest.raises(SessionError, match="line 4, column t: time repeats"):
        read_session(
            tmp_path / "run.csv", recipe=recipe(text.replace('repeated = "{}"\n', "").format())
        )


@pytest.mark.parametrize(
    ("unit", "times", "t"),
    [
        (
            "iso",
            ["2026-03-01T12:00:00.5", "2026-03-01 12:00:01", "2026-03-01T13:00:01.500+01:00"],
            [0, 0.5, 1.0],
        ),
        ("clock", ["23:59:58", "23:59:58.5", "23:59:59.0"], [0, 0.5, 1.0]),
    ],
)
def test_dates_and_clock_times(tmp_path, unit, times, t):
    text = f'[time]\nunit = "{unit}"\nfrom_zero = true\n[columns]\np_r = {{ column = "a" }}'
    frame = pd.DataFrame({"t": times, "a": [1.0, 2.0, 3.0]})
    frame.to_csv(tmp_path / "run.csv", index=False)
    for session in (
        read_session(tmp_path / "run.csv", recipe=recipe(text)),
        read_frame(frame, recipe(text)),
    ):
        np.testing.assert_allclose(session.t, t, atol=1e-6)
    if unit == "iso":
        assert session.metadata.more["start_time"] == pd.Timestamp(times[0]).timestamp()
    frame.replace(times[1], "soon").to_csv(tmp_path / "run.csv", index=False)
    with pytest.raises(SessionError, match=r"line 3, column 't': 'soon' is not a time"):
        read_session(tmp_path / "run.csv", recipe=recipe(text))


@pytest.mark.parametrize("zone", ["", "Z", "+01:00"])
def test_dates_keep_their_digits(tmp_path, zone):
    """
    Oracle: fractions of integers, exact to the rounding of one float; seconds since 1970 keep 2e-7
    s.
    """
    text = '[time]\nunit = "iso"\nfrom_zero = true\n[columns]\np_r = { column = "a" }'
    nanoseconds = [999_999_999 + 123_456_789 * k for k in range(400)]  # every step has nine digits
    times = [f"2026-03-01T12:00:{ns // 10**9:02}.{ns % 10**9:09}" for ns in nanoseconds]
    frame = pd.DataFrame({"t": [f"{time}{zone}" for time in times], "a": 1.0})
    frame.to_csv(tmp_path / "run.csv", index=False)
    frame.to_parquet(tmp_path / "run.parquet")
    expected = [float(Fraction(ns - nanoseconds[0], 10**9)) for ns in nanoseconds]
    for name in ("run.csv", "run.parquet"):
        session = read_session(tmp_path / name, recipe=recipe(text))
        assert session.t.tolist() == expected
        assert session.metadata.more["start_time"] == pd.Timestamp(frame["t"][0]).timestamp()
    frame = frame.iloc[:6].copy()
    frame["t"] = [
        f"2026-03-01T12:00:00{end}{zone}" for end in ("", ".1", ".2", ".3", ".4000", ".500000")
    ]
    assert read_frame(frame, recipe(text)).t.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    since_1970 = read_frame(frame, recipe(text.replace("true", "false"))).t
    assert since_1970.tolist() == [pd.Timestamp(time).timestamp() for time in frame["t"]]


def test_cells_of_several_numbers_and_an_analogue_channel(tmp_path):
    text = """
    [time]
    unit = "s"
    [columns]
    robot_x = { column = "pos", item = 0, unit = "m" }
    robot_z = { column = "pos", item = 2, unit = "cm" }
    mode = { column = "pedal", above = 2.5 }
    """
    (tmp_path / "run.csv").write_text(
        't,pos,pedal\n0,"(1, 2, 300)",0.1\n1,"[1.5; 2; 400]",2.6\n2,2 2 500,5\n'
    )
    session = read_session(tmp_path / "run.csv", recipe=recipe(text))
    assert session["robot_x"].tolist() == [1, 1.5, 2]
    assert session["robot_z"].tolist() == [3, 4, 5]
    assert session["mode"].tolist() == [0, 1, 1]
    assert session.metadata.more["mode above 2.5"] == "2 of 3 samples"
    (tmp_path / "run.csv").write_text('t,pos,pedal\n0,"(1, 2, 300)",0.1\n1,"(1, 2)",2.6\n')
    with pytest.raises(
        SessionError, match=r"line 3, column 'pos' \(robot_z\): '\(1, 2\)' has no number 2"
    ):
        read_session(tmp_path / "run.csv", recipe=recipe(text))


def test_a_log_split_at_its_gaps(tmp_path):
    text = '[files]\npattern = "run{trial:int}.csv"\n[time]\nunit = "s"\n[splitting]\ngap = 2.0\n'
    text += '[columns]\np_r = { column = "a" }\n[metadata]\ntrial = { from = "trial" }'
    t = [0, 1, 2, 10, 11, 20, 30, 31, 32]
    (tmp_path / "run1.csv").write_text(
        "t,a\n" + "".join(f"{each},{k}\n" for k, each in enumerate(t))
    )
    (tmp_path / "run2.csv").write_text("t,a\n0,1\n1,2\n")
    sessions = tl.read_sessions(tmp_path, recipe=recipe(text))
    assert [each.t.tolist() for each in sessions] == [[0, 1, 2], [10, 11], [30, 31, 32], [0, 1]]
    assert (
        sessions[1].metadata.more["split"]
        == "part 1 (from 0) of 3, between gaps of more than 2 s; 1 too short"
    )
    with pytest.raises(SessionError, match="into 3 sessions; read_sessions"):
        read_session(tmp_path / "run1.csv", recipe=recipe(text))
    assert len(read_session(tmp_path / "run2.csv", recipe=recipe(text))) == 2


def test_what_is_good_and_what_is_not(tmp_path):
    for k in range(4):
        (tmp_path / f"p{k}.csv").write_text("t,p_r\n0,1\n1,x\n" if k == 2 else "t,p_r\n0,1\n1,2\n")
    sessions = tl.read_sessions(tmp_path, on_error="collect")
    assert len(sessions) == 3
    assert sessions.faults["file"].tolist() == [str(tmp_path / "p2.csv")]
    assert "line 3, column 'p_r': 'x'" in sessions.faults["error"][0]
    with pytest.raises(SessionError, match="line 3"):
        tl.read_sessions(tmp_path)
    with pytest.raises(ValueError, match="on_error must be one of"):
        tl.read_sessions(tmp_path, on_error="ignore")


def test_files_of_one_run_joined_by_time():
    """Oracle: NumPy's interpolation."""
    slow, fast = np.arange(11) * 1.0, 0.5 + np.arange(80) * 0.1
    one = Session(pd.DataFrame({"p_r": slow**2}, index=slow), Metadata(participant=3, source="a"))
    other = Session(
        pd.DataFrame({"robot_x": np.sin(fast)}, index=fast), Metadata(participant=3, source="b")
    )
    joined = join_sessions([one, other], resample="linear", sample_time=0.25)
    assert (joined.t[0], joined.t[-1]) == (0.5, 8.25)
    np.testing.assert_allclose(joined["p_r"], np.interp(joined.t, slow, slow**2), rtol=1e-12)
    np.testing.assert_allclose(
        joined["robot_x"], np.interp(joined.t, fast, np.sin(fast)), rtol=1e-12
    )
    assert joined.metadata.participant == 3
    assert joined.metadata.more["joined"] == ["a", "b"]
    same = join_sessions(
        [one, Session(pd.DataFrame({"p_h": slow}, index=slow), Metadata(participant=3))]
    )
    assert same.columns == ["p_r", "p_h"]
    for sessions, said in [
        ([one, other], "times of their own"),
        ([one, one], "column 'p_r' is in two"),
        ([one, other.with_metadata(participant=4)], "'participant' are 3 in one session and 4"),
    ]:
        with pytest.raises(SessionError, match=said):
            join_sessions(sessions)


def test_frames():
    frame = pd.DataFrame({"p_r": [1.0, 2.0]}, index=pd.Index([0.0, 0.5], name="t"))
    assert tl.read_frame(frame)["p_r"].tolist() == [1, 2]
    assert len(tl.read_frame(frame, resample="linear", sample_time=0.1)) == 6
    with pytest.raises(SessionError, match=r"data frame: row 1 \(from 0\), column 'p_r'"):
        tl.read_frame(frame.assign(p_r=[1.0, np.nan]))
    with pytest.raises(SessionError, match="data frame"):
        tl.read_frame(frame.assign(p_r=["a", 1.0]))
    with pytest.raises(ValueError, match="frame must be of class DataFrame"):
        tl.read_frame([1, 2])


@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "a.feather", "frame", "joined"])
def test_the_columns_of_a_session_are_its_own(tmp_path, name):
    frame = pd.DataFrame({"t": [0.0, 0.5, 1.0], "p_r": [1.0, 2.0, 3.0], "mode": [1, 0, 1]})
    if name == "joined":
        source = read_frame(frame)
        session = join_sessions([source])
        source.data.iloc[1, 0] = 7.0
    elif name == "frame":
        session = read_frame(frame)
        frame.loc[1, "p_r"] = 7.0
        frame.loc[1, "t"] = 0.6
    else:
        write = {
            "a.csv": partial(frame.to_csv, index=False),
            "a.parquet": frame.to_parquet,
            "a.feather": frame.to_feather,
        }
        write[name](tmp_path / name)
        session = read_session(tmp_path / name)
        with (tmp_path / name).open("r+b") as file:
            file.write(bytes((tmp_path / name).stat().st_size))
    assert session.t.tolist() == [0.0, 0.5, 1.0]
    assert session["p_r"].tolist() == [1.0, 2.0, 3.0]
    assert session.data.dtypes.unique().tolist() == [float]
    session.data.iloc[0, 0] = 4.0
    assert session["p_r"][0] == 4.0


def test_the_way_from_other_files_to_a_session(tmp_path):
    (tmp_path / "run.sas7bdat").write_bytes(b"x")
    with pytest.raises(
        SessionError, match=r"frame = pandas.read_….*session = trustlab.read_frame\(frame\)"
    ):
        read_session(tmp_path / "run.sas7bdat")


TABLE = pd.DataFrame(
    {"t": np.arange(30) * 0.1, "p_r": np.sin(np.arange(30.0)), "mode": np.arange(30) % 2}
)


@pytest.mark.parametrize("name", ["a.tsv", "a.txt", "a.csv.gz", "a.feather", "a.mat", "a.h5"])
def test_other_tables(tmp_path, name):
    path = tmp_path / name
    if name == "a.tsv":
        TABLE.to_csv(path, sep="\t", index=False)
    elif name == "a.feather":
        TABLE.to_feather(path)
    elif name == "a.mat":
        io.savemat(path, {column: TABLE[column].to_numpy() for column in TABLE})
    elif name == "a.h5":
        with h5py.File(path, "w") as file:
            for column in TABLE:
                file[column] = TABLE[column].to_numpy()
    else:
        data = TABLE.to_csv(index=False).encode()
        path.write_bytes(gzip.compress(data) if name.endswith("gz") else data)
    columns = None if not name.endswith((".mat", ".h5")) else ["p_r", "mode"]
    session = read_session(path, columns=columns)
    for column in TABLE:
        np.testing.assert_array_equal(session[column], TABLE[column])


def test_matrices_and_groups(tmp_path):
    matrix = np.column_stack([TABLE["t"], TABLE["p_r"]])
    io.savemat(tmp_path / "a.mat", {"log": {"data": matrix}})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("log/data", data=matrix, compression="gzip")
        file["log/other"] = np.zeros(3)
    for path, name in ((tmp_path / "a.mat", "log.data"), (tmp_path / "a.h5", "log/data")):
        text = (
            f'[time]\ncolumn = "{name}[0]"\nunit = "s"\n[columns]\np_r = {{ column = "{name}[1]" }}'
        )
        np.testing.assert_array_equal(read_session(path, recipe=recipe(text))["p_r"], TABLE["p_r"])
    text = '[time]\ncolumn = "log/data[0]"\nunit = "s"\n[columns]\np_r = { column = "log/other" }'
    with pytest.raises(
        SessionError, match=r"differ in their number of values: log/data\[0\] 30, log/other 3"
    ):
        read_session(tmp_path / "a.h5", recipe=recipe(text))
    for name in ("a.mat", "a.h5", "a.ulg", "a.xdf"):
        (tmp_path / name).write_bytes(b"\x89HDF\r\n\x1a\nULog" + bytes(200))
        with pytest.raises(SessionError, match="damaged"):
            read_session(tmp_path / name)


def test_px4_and_the_lab_streaming_layer(tmp_path):
    t, values = TABLE["t"].to_numpy(), TABLE["p_r"].to_numpy()
    for path, recipe in ((tmp_path / "a.ulg", fuzz.POSE), (tmp_path / "a.xdf", fuzz.ARM)):
        (fuzz.write_ulog if path.suffix == ".ulg" else fuzz.write_xdf)(path, t, values)
        session = read_session(path, recipe=recipe)
        np.testing.assert_allclose(
            session["p_r"], values, rtol=1e-7
        )  # ULog has single precision here
        np.testing.assert_allclose(session.t, t, atol=1e-6)
        with pytest.raises(SessionError, match="needs a recipe"):
            read_session(path)
    assert "brought together" in session.metadata.more["clocks"]


@pytest.mark.parametrize(
    "name", ["rules", "tf", "feather", "tsv", "csv.gz", "mat", "h5", "ulg", "xdf", *fuzz.READS]
)
def test_damaged_logs_and_recipes_at_random(name):
    """
    Whatever is damaged, only our errors come out; some logs are read. tests/sessions/fuzz.py
    searches further.
    """
    failures = queue.Queue()
    good = fuzz.fuzz(name, first=0, logs=40 if name in fuzz.READS else 25, failures=failures)
    assert list(failures.queue) == []
    assert good >= 2 or name not in fuzz.READS


def test_an_error_that_is_not_ours_is_noticed(monkeypatch):
    # Negative control.
    failures = queue.Queue()
    monkeypatch.setattr(
        "trustlab.sessions.readers.bags.damage_named", lambda *_: contextlib.nullcontext()
    )
    fuzz.fuzz("ulg", first=0, logs=25, failures=failures)
    assert not failures.empty()


def test_an_answer_that_is_no_session_is_noticed(monkeypatch):
    # Negative control.
    failures = queue.Queue()
    backwards = SimpleNamespace(data=pd.DataFrame({"r": [0.5, 0.5]}), t=np.array([1.0, 0.0]))
    monkeypatch.setattr(fuzz, "read_frame", lambda *_, **__: backwards)
    fuzz.fuzz("frame", first=0, logs=3, failures=failures)
    assert failures.qsize() == 3


@pytest.mark.parametrize("start", [0.0, 1396293889.454, 1.7e9 + 0.001])
@pytest.mark.parametrize("sample_time", [0.01, 0.05])
@pytest.mark.parametrize("from_zero", ["true", "false"])
def test_samples_stay_their_own_when_times_are_dates(start, sample_time, from_zero):
    """Oracle: times on the grid, so that "previous" returns the samples as they are."""
    k = np.arange(500)
    frame = pd.DataFrame({"t": np.round(start + sample_time * k, 3), "p_r": k})
    text = (
        f'[time]\nunit = "s"\nfrom_zero = {from_zero}\n[resampling]\nmethod = '
        f'"previous"\nsample_time = {sample_time}\n'
    )
    session = read_frame(frame, recipe(text + '[columns]\np_r = { column = "p_r" }'))
    np.testing.assert_array_equal(session["p_r"], k)


@pytest.mark.parametrize(
    ("cells", "decimal", "found"),
    [
        (["(1,5; 2,5; 3)", "(1,5; -3,5; 3)"], ",", [2.5, -3.5]),
        (["1,5 2,5 3", "1,5 3,5 3"], ",", [2.5, 3.5]),
        (["(0.00, -0.44, 3)", "(1.00, 2.44, 3)"], ",", [-0.44, 2.44]),
        (["{1.5, 2.5}", "{1.5,3.5}"], ".", [2.5, 3.5]),
        (["[ 1.  nan  3.]", "[ 1.  4.  3.]"], ".", None),
        (["(1,,3)", "(1,2,3)"], ".", None),
        (["x: 1.5, y: 2.5", "x: 1.5, y: 2.5"], ".", None),
        (["(1,2,3)", "(1,2,3)"], ",", None),
    ],
)
def test_the_second_number_of_a_cell_or_none(tmp_path, cells, decimal, found):
    text = f'[table]\ndelimiter = "|"\ndecimal = "{decimal}"\n[time]\nunit = "s"\n'
    text += '[columns]\nrobot_x = { column = "pos", item = 1, unit = "m" }'
    (tmp_path / "run.csv").write_text(
        "t|pos\n" + "".join(f"{k}|{cell}\n" for k, cell in enumerate(cells))
    )
    if found is None:
        with pytest.raises(
            SessionError, match=r"line 2, column 'pos' \(robot_x\): .* has no number 1 \(from 0\)"
        ):
            read_session(tmp_path / "run.csv", recipe=recipe(text))
    else:
        assert read_session(tmp_path / "run.csv", recipe=recipe(text))["robot_x"].tolist() == found


@pytest.mark.parametrize("word", ["", "NaN", "NA", "N/A", "null", "None", "-"])
@pytest.mark.parametrize(
    "row", ["", "\n"]
)  # with an empty line at the end, the file is read row by row
def test_words_for_blanks(tmp_path, word, row):
    (tmp_path / "run.csv").write_text(f"t,a,m\n0,1,AUTO\n1,{word},{word}\n2,3,NONE\n{row}")
    text = '[time]\nunit = "s"\n[columns]\np_r = { column = "a", blank = "linear" }\n'
    text += 'mode = { column = "m", blank = "hold", map = { AUTO = 0, NONE = 1 } }'
    session = read_session(tmp_path / "run.csv", recipe=recipe(text))
    assert session["p_r"].tolist() == [1, 2, 3]
    assert session["mode"].tolist() == [0, 0, 1]
    assert session.metadata.more["blanks of mode"] == "1 of 3 cells, filled by 'hold'"
    with pytest.raises(SessionError, match=r"line 3, column 'a' \(p_r\)"):
        read_session(tmp_path / "run.csv", recipe=recipe(text.replace(', blank = "linear"', "")))


@pytest.mark.parametrize("name", ["mode", "suggested_mode", "yaw"])
def test_states_and_angles_are_not_interpolated_over_blanks(name):
    unit = ', unit = "deg"' if name == "yaw" else ""
    rule = f'[time]\nunit = "s"\n[columns]\n{name} = {{ column = "a", blank = "linear"{unit} }}'
    with pytest.raises(
        RecipeError, match=rf'{name} has no value between two others; fill it with blank = "hold"'
    ):
        recipe(rule)
    frame = pd.DataFrame({"t": [0, 1, 2], "a": [1.0, np.nan, 0.0]})
    held = read_frame(frame, recipe(rule.replace("linear", "hold")))[name]
    assert held[1] == held[0] > held[2]


def test_clock_times_after_midnight(tmp_path):
    (tmp_path / "run.csv").write_text("t;a\n23:59:59,5;1\n00:00:00,0;2\n00:00:00,5;3\n")
    text = (
        '[table]\ndelimiter = ";"\ndecimal = ","\n[time]\nunit = "clock"\nfrom_zero = '
        'true\n[columns]\np_r = { column = "a" }'
    )
    session = read_session(tmp_path / "run.csv", recipe=recipe(text))
    assert session.t.tolist() == [0.0, 0.5, 1.0]
    assert session.metadata.more["midnights"] == "1 passed; times count on"
    (tmp_path / "run.csv").write_text("t;a\n13:59:59,5;1\n12:00:00,0;2\n")
    with pytest.raises(SessionError, match="line 3, column t: time runs backwards"):
        read_session(tmp_path / "run.csv", recipe=recipe(text))


def test_columns_separated_by_spaces_and_a_compressed_tsv(tmp_path):
    (tmp_path / "run.txt").write_text("  t    p_r\n 0.0   1\n 0.5  20\n 1.0 300\n")
    with pytest.raises(SessionError, match=r'one column only.*read it with delimiter=" "'):
        read_session(tmp_path / "run.txt")
    assert read_session(tmp_path / "run.txt", delimiter=" ")["p_r"].tolist() == [1, 20, 300]
    (tmp_path / "run.txt").write_text("t a b\n0 1 2\n1  2\n2 3 4\n")
    text = (
        '[table]\ndelimiter = " "\n[time]\nunit = "s"\n[columns]\np_r = { column = "a", '
        'blank = "hold" }'
    )
    with pytest.raises(SessionError, match="line 3: has 2 cells, but the header names 3"):
        read_session(tmp_path / "run.txt", recipe=recipe(text))
    (tmp_path / "run.tsv.gz").write_bytes(gzip.compress(b"t\tp_r\n0\t1\n1\t2\n"))
    assert read_session(tmp_path / "run.tsv.gz")["p_r"].tolist() == [1, 2]
