"""
One physics: WebAssembly and numba give the same bits. Oracle: wasmtime, which shares no code with
numba's machine code.
"""

import json
import struct

import numpy as np
import pytest

import trustlab as tl
from trustlab.live import build
from trustlab.live.hand import HumanHand, scripted_drive
from trustlab.live.noise import HASHED
from trustlab.live.runs import Drive, commands_of, drive_config, driven, replay
from trustlab.live.tasks.flown import fly_there
from trustlab.models.digest import digest
from trustlab.models.portable import cos_sin
from trustlab.testbeds import GroundRobot, run_condition
from trustlab.testbeds.ground_robot.kernel import COLUMNS

wasmtime = pytest.importorskip("wasmtime")

MODEL = tl.published_models()["2"]
CONDITIONS = {
    "C1": {},
    "C2": {"thresholds": (0.0, 0.35)},
    "C3": {"thresholds": (0.0, 0.35)},
    "C4": {},
    "C5": {},
}


def wobbling(count, seed):
    """Commands of a hand that sees nothing, and wants another mode now and then."""
    rng = np.random.default_rng(seed)
    t = np.arange(count)
    v, w = 0.35 + 0.2 * np.sin(0.013 * t), 0.15 + 0.8 * np.sin(0.05 * t + 0.3)
    return np.column_stack([v, w, np.repeat(rng.integers(0, 2, count // 50 + 1), 50)[:count]])


class Module:
    """
    The WebAssembly file in wasmtime, with a drive's records packed into its memory by their layout.
    """

    def __init__(self, config):
        engine = wasmtime.Engine()
        self.store = wasmtime.Store(engine)
        module = wasmtime.Module(engine, build.WASM.read_bytes())
        assert module.imports == [], "no function of any library"
        self.exports = wasmtime.Instance(self.store, module, []).exports(self.store)
        self.memory, self.config = self.exports["memory"], config
        self.top = self.exports["__heap_base"].value(self.store) + 64
        self.memory.grow(self.store, (16 * config["samples"] + 200_000) // 65_536 + 1)
        put, pack = self.put, self.pack
        path, posts = np.array(config["path"]), np.array(config["posts"])
        self.status = put(bytes(32))
        course = [put(path.tobytes()), len(path), put(posts.tobytes()), len(posts)]
        world = [pack("task", config["task"]), pack("robot", config["robot"]), *course]
        source = pack("source", {"seed": config["seed"], "drawn": 0})
        room = [put(bytes(8 * config["samples"])) for _ in "rh"] + [put(bytes(32 * len(posts)))]
        records = [put(bytes(config["records"][name]["size"])) for name in ("state", "forcing")]
        self.row = put(bytes(config["records"]["row"]["size"]))
        self.arguments = [*world, source, *room, *records, self.row]
        self.call("begin", *world, *records)

    def put(self, data):
        self.top = (self.top + 15) & ~15
        place, self.top = self.top, self.top + len(data)
        self.memory.write(self.store, data, place)
        return place

    def pack(self, name, values):
        data = bytearray(self.config["records"][name]["size"])
        for field, (offset, kind) in self.config["records"][name]["fields"].items():
            struct.pack_into("<q" if kind == "i" else "<d", data, offset, values[field])
        return self.put(bytes(data))

    def call(self, name, *arguments):
        assert self.exports[name](self.store, self.status, self.status + 16, *arguments) == 0
        return struct.unpack("<i", self.memory.read(self.store, self.status, self.status + 4))[0]

    def rows(self, commands):
        size = self.config["records"]["row"]["size"]
        self.memory.grow(self.store, (size + 24) * len(commands) // 65_536 + 1)
        given, first = (
            self.put(np.ascontiguousarray(commands).tobytes()),
            self.put(bytes(size * len(commands))),
        )
        count = self.call("many", len(commands), given, *self.arguments[:-1], first)
        data = self.memory.read(self.store, first, first + size * count)
        return np.frombuffer(data).reshape(count, len(COLUMNS))

    def stepped(self, commands):
        """The same as a browser makes it, one call a row."""
        rows = np.empty((len(commands), len(COLUMNS)))
        for k, command in enumerate(commands.tolist()):
            self.call("tick", k, *command, *self.arguments)
            rows[k] = np.frombuffer(
                self.memory.read(self.store, self.row, self.row + 8 * len(COLUMNS))
            )
        return rows


def configured(condition, seconds, seed, **more):
    return drive_config(
        condition, MODEL, seconds=seconds, seed=seed, **CONDITIONS[condition], **more
    )


@pytest.mark.parametrize("condition", CONDITIONS)
def test_every_row_is_the_same_in_webassembly(condition):
    """
    36,000 rows in all: 12 minutes under each condition, by a hand that follows suggestions and then
    sees nothing more.
    """
    config = configured(condition, 720.0, seed=11)
    seen, _ = scripted_drive(configured(condition, 160.0, seed=11), HumanHand(config, 1))
    commands = np.concatenate([commands_of(seen), wobbling(5600, 5)])
    made, _ = driven(config, commands)
    there = Module(json.loads(json.dumps(config))).rows(commands)
    assert made.shape == there.shape == (7200, len(COLUMNS))
    assert made.tobytes() == there.tobytes()
    assert len(np.unique(made[:, COLUMNS.index("mode")])) == 2, "both modes are driven"
    assert np.ptp(made[:, COLUMNS.index("p_r")]) > 0.1


def test_step_by_step_as_in_a_browser():
    config, commands = configured("C4", 130.0, seed=2), wobbling(1300, 3)
    assert Module(config).stepped(commands).tobytes() == driven(config, commands)[0].tobytes()


def test_another_seed_is_seen():
    commands = wobbling(3000, 5)
    one, other = (driven(configured("C1", 300.0, seed), commands)[0] for seed in (1, 2))
    assert not np.array_equal(one, other)
    assert replay(configured("C1", 300.0, 2), one) is not True


def test_file_and_sources_belong_together():
    stamp = json.loads(build.STAMP.read_text())
    assert stamp["file"] == digest(build.WASM.read_bytes())
    assert stamp["sources"] == build.sources_digest(), (
        "the tick's sources have changed since: run `make kernel` and commit its files"
    )


def test_the_digest_sees_functions_constants_and_calls():
    found = {}
    build.sources(cos_sin, found)
    assert list(found) == ["trustlab.models.portable.cos_sin"]
    from trustlab.live.tick import tick

    build.sources(tick, found := {})
    names = {name.rsplit(".", 1)[-1] for name in found}
    assert {
        "roll",
        "scan",
        "cos_sin",
        "suggest",
        "performance_suggestion",
        "next_utilization",
        "TSC",
    } <= names
    assert "PERFORMANCE_TOLERANCE" in " ".join(found.values())
    build.sources(fly_there, found := {})
    names = {name.rsplit(".", 1)[-1] for name in found}
    assert {"teleoperate", "read_wave", "midpoint_velocity", "optimal_share", "FLOOR"} <= names


def test_replay_finds_the_first_row_that_differs():
    config = configured("C3", 200.0, seed=4)
    rows, _ = driven(config, wobbling(2000, 1))
    assert replay(config, rows) is True
    assert replay(config, rows[:700]) is True
    for column in ("robot_x", "p_r", "r", "suggested_mode"):
        forged = rows.copy()
        forged[1234, COLUMNS.index(column)] = np.nextafter(forged[1234, COLUMNS.index(column)], 9.0)
        assert replay(config, forged) == 1234
    forged = rows.copy()
    forged[1234, COLUMNS.index("v_command")] += 0.01
    assert replay(config, forged) in (1234, 1235)


def test_steps_in_python_are_those_of_the_loop():
    config = configured("C2", 30.0, seed=9)
    commands = wobbling(300, 2)
    drive = Drive(config)
    for command in commands:
        drive.step(*command)
    assert drive.rows.tobytes() == driven(config, commands)[0].tobytes()


def test_the_live_robot_is_the_testbeds_robot():
    """
    Given the commands and modes of a simulated run without noise of sensing, the live tick drives
    the same way.
    """
    quiet = {"range_noise": 0.0, "bearing_noise": 0.0, "heading_noise": 0.0, "detection": 1.0}
    robot = tl.testbeds.Pioneer(**quiet)
    run = run_condition("C1", participant=2, seed=3, testbed=GroundRobot(laps=2, robot=robot))
    data = run.session.data
    config = drive_config("training", MODEL, laps=2, robot=robot)
    rows, lap_times = driven(config, data[["v_command", "w_command", "mode"]].to_numpy())
    assert len(data["mode"].unique()) == 2
    for name in ("robot_x", "robot_y", "yaw", "path_error", "p_r", "p_h", "tsc"):
        np.testing.assert_array_equal(rows[:, COLUMNS.index(name)], data[name], name)
    assert lap_times.tolist() == run.lap_times.tolist()


def test_the_source_counts_what_it_has_drawn():
    drive = Drive(configured("C1", 10.0, seed=3))
    for command in wobbling(100, 1):
        drive.step(*command)
    assert drive.world.source["seed"] == 3
    assert drive.world.source["drawn"] > 300
    assert HASHED.itemsize == 16


def test_commands_of_rows():
    rows, _ = driven(configured("C1", 20.0, seed=3), wobbling(200, 1))
    assert commands_of(rows)[:, 0].max() <= 0.5
    assert set(commands_of(rows)[:, 2]) <= {0.0, 1.0}
