"""
A log only grows, and a trial is a fold over its log: whatever moment a writer dies at, what was
acknowledged is there and nothing else is, and no line can be changed unseen.

Oracles: the entries and commands that were sent, the answers that came back, a run stepped here.
"""

import os
import resource
import signal
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import example, given, settings as budget, strategies as st

from tests.cases import refused
from tests.live.cases import commands_for, configured, stepped
from trustlab.live import trial as trials
from trustlab.live.log import Log, LogError, read_log
from trustlab.live.task import task_named
from trustlab.live.trial import Trial, made_by, read_record

# --- the log --------------------------------------------------------------------------------------


ENTRIES = st.lists(
    st.one_of(
        st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
        st.lists(st.floats(allow_nan=False, allow_infinity=False)),
    ),
    max_size=6,
)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.jsonl"


def logged(folders, entries):
    """Return a log that holds these entries, and its bytes."""
    path = folders.mktemp("a") / "rows.jsonl"
    log = Log(path, "a")
    log.append(entries)
    log.close()
    return path, path.read_bytes()


@given(entries=ENTRIES, cut=st.integers(min_value=0))
def test_a_file_cut_anywhere_gives_its_whole_lines(entries, cut, tmp_path_factory):
    path, data = logged(tmp_path_factory, entries)
    cut = min(cut, len(data))
    path.write_bytes(data[:cut])
    whole = data[:cut].count(b"\n")
    reading = read_log(path, "a")  # reading changes nothing
    assert reading.entries == entries[:whole]
    torn = cut - (data[:cut].rfind(b"\n") + 1)
    assert bool(reading.fault) == bool(torn)
    log = Log(path, "a")
    assert log.torn == torn
    log.append(["after"])
    reading = read_log(path, "a")
    assert (reading.entries, reading.fault) == ([*entries[:whole], "after"], "")


@example(entries=[[-1.0], [2.0], [3.0]], place=22, bit=5)  # a minus becomes a carriage return
@given(entries=ENTRIES.filter(bool), place=st.integers(min_value=0), bit=st.integers(0, 7))
def test_every_bit_that_is_changed_is_found(entries, place, bit, tmp_path_factory):
    path, data = logged(tmp_path_factory, entries)
    changed = bytearray(data)
    changed[place % len(data)] ^= 1 << bit
    path.write_bytes(changed)
    assert read_log(path, "a").fault.startswith("rows.jsonl")
    with suppress(LogError):
        Log(path, "a").close()
    # Nothing but a last line without its end is cut off.
    assert path.stat().st_size >= data[:-1].rfind(b"\n") + 1


def test_a_disk_that_is_full_takes_half_a_line_back(path):
    """A limit on a file's size, as a real disk sets it: the write stops in the middle of a line."""
    log = Log(path, "a")
    log.append([[0]])
    size = path.stat().st_size
    limit = resource.RLIMIT_FSIZE
    before = resource.getrlimit(limit)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(limit, (size + 30, before[1]))
        with pytest.raises(OSError):
            log.append([[k, 0.25] for k in range(20)])
    finally:
        resource.setrlimit(limit, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert path.stat().st_size == size
    log.append([[1]])
    assert read_log(path, "a").entries == [[0], [1]]


def test_a_log_has_one_writer_and_is_moved_away_only_where_nothing_else_tells_of_it(path):
    log = Log(path)
    with refused("is being written; end that first"):
        Log(path)
    log.close()
    path.write_text("x\n")
    for origin, remedy in (("", "from a copy, or move it away"), ("of a study", "from a copy")):
        with refused(f"restore it {remedy}$"):
            Log(path, origin)


def test_the_name_of_a_new_log_is_on_the_disk(path, monkeypatch):
    synced = []
    monkeypatch.setattr("trustlab.live.log.sync_folder", synced.append)
    path.touch()  # by who was killed before the folder was written
    for _ in range(2):
        log = Log(path)
        log.append([0])
        log.close()
    assert synced == [path.parent]


# --- the trial ------------------------------------------------------------------------------------


def begun(path, name="team"):
    """A trial that has begun in window a."""
    trial = Trial(path, task_named(name), configured(name), participant="me")
    trial.take({"begin": True, "window": "a"})
    return trial


@pytest.fixture
def team(path):
    return begun(path)


def sent(trial, first, end, window="a", seen=0, commands=None):
    """What a trial answers to random commands, of the numbers from first to end."""
    commands = commands or commands_for(trial.settings)[max(first, 0) : end]
    return trial.take({"k": first, "commands": commands, "seen": seen, "window": window})


def opened_again(trial):
    """The trial after its writer was killed, begun in window b."""
    trial.log.close()
    again = Trial(trial.log.path, trial.task, {})
    again.take({"begin": True, "window": "b"})
    return again


@pytest.mark.parametrize("name", ["ground_robot", "teleoperation", "team"])
def test_rows_are_those_of_the_task_and_a_restart_is_a_replay(path, name):
    trial = begun(path, name)
    for k in range(0, 30, 3):
        assert sent(trial, k, k + 3)["k"] == k + 3
    expected = stepped(trial.settings, trial.record.commands).tolist()
    assert (len(expected), trial.rows) == (30, expected)
    again = opened_again(trial)
    assert (again.rows, again.settings) == (expected, trial.settings)
    assert sent(again, 30, None, "b")["done"]
    assert again.fault == ""
    record, _, fault = read_record(path)
    assert fault == record.fault(trial.task) == ""
    assert record.rows == again.rows
    assert len(again.session(participant="me")) == len(record.rows)
    assert record.pauses[-1]["why"] == "begun again"


def test_a_command_is_on_the_disk_before_it_is_done_and_its_row_with_the_next(team, monkeypatch):
    path, done, step = team.log.path, [], team.run.step

    def noted(*command):
        *_, last = read_log(path).entries
        assert list(command) in last["commands"]
        done.append(step(*command))
        return done[-1]

    monkeypatch.setattr(team.run, "step", noted)
    for k in range(5):
        sent(team, k, k + 1)
        record, _, _ = read_record(path)
        assert record.rows == done[:k]
        assert record.commands == commands_for(team.settings)[: k + 1]


@budget(max_examples=25, deadline=None)
@given(st.data())
def test_a_kill_at_any_byte_loses_nothing_that_was_acknowledged(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("t") / "a.jsonl"
    trial, k = begun(path), 0
    sizes = [(path.stat().st_size, 0)]
    while k < 12:
        k = sent(trial, k, k + data.draw(st.integers(1, 4)))["k"]
        sizes.append((path.stat().st_size, k))
    trial.log.close()
    first, last = sizes[0][0], path.stat().st_size
    cut = first + round(data.draw(st.floats(0.0, 1.0)) * (last - first))
    os.truncate(path, cut)
    again = opened_again(trial)
    assert len(again.rows) == max(acknowledged for size, acknowledged in sizes if size <= cut)
    sent(again, len(again.rows), None, "b")
    assert again.rows == stepped(again.settings, commands_for(again.settings)).tolist()
    assert again.fault == ""


def test_commands_that_come_twice_are_done_once_and_a_gap_waits(team):
    for first, end, there in ((0, 10, 10), (4, 15, 15), (20, 25, 15), (-1, 2, 15)):
        assert sent(team, first, end)["k"] == there
    commands = commands_for(team.settings)
    assert team.record.commands == commands[:15]
    beyond = commands[15:] + commands
    assert sent(team, 15, None, commands=beyond)["done"], "what lies beyond the end is left out"
    assert len(team.rows) == team.settings["samples"]
    assert sent(team, 80, None, commands=commands[:3])["k"] == 80


def test_an_own_part_that_fails_ends_the_drive_and_leaves_the_log(path, team, monkeypatch):
    step = team.run.step

    def fails(*command):
        if len(team.rows) == 3:
            raise RuntimeError("no leader")
        return step(*command)

    monkeypatch.setattr(team.run, "step", fails)
    with pytest.raises(RuntimeError, match="no leader"):
        sent(team, 0, 5)
    assert sent(team, 3, 8)["done"]
    assert (len(team.record.commands), len(team.record.rows)) == (5, 3)
    assert team.record.end == "stopped: no leader"

    def begin(settings):
        raise RuntimeError("no policy")

    path = path.with_name("other.jsonl")
    with pytest.raises(RuntimeError, match="no policy") as kept:  # with its traceback, as notebooks
        Trial(path, replace(team.task, begin=begin), team.settings)
    assert kept.tb is not None
    assert not Trial(path, team.task, team.settings).done


def test_the_window_that_began_last_drives(team):
    sent(team, 0, 5)
    assert team.take({"begin": True, "window": "b"})["k"] == 5
    assert sent(team, 5, 6) == team.take({"note": "x", "window": "a"}) == {"other_window": True}
    assert sent(team, 5, 9, "b")["k"] == 9
    assert len(team.record.pauses) == 1


def test_messages_that_no_page_sends_are_refused(team):
    with refused("a command is"):
        sent(team, 0, None, commands=[[0.5, 0.5, 1], None])
    for k, commands, seen in ((0.0, [], 0), (0, {}, 0), (0, [], None)):
        with refused("a message has"):
            team.take({"k": k, "commands": commands, "seen": seen, "window": "a"})
    assert team.rows == []
    assert sent(team, 0, 1)["k"] == 1


def test_pauses_and_what_was_seen_come_from_the_log(path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(trials.time, "monotonic", lambda: now[0])
    trial = begun(path)
    for k in range(10):
        now[0] += 0.05
        sent(trial, k, k + 1, seen=max(k - 3, 0))
    now[0] += 2.0
    sent(trial, 10, 12, seen=7)
    trial.take({"note": "the page is hidden", "window": "a"})
    now[0] += 0.3
    sent(trial, 12, 13, seen=9)
    more = trial.session().metadata.more
    pauses = [tuple(pause.values()) for pause in more["pauses"]]
    assert pauses == [(10, 2.0, "nothing was heard"), (12, 0.3, "the page is hidden")]
    assert more["period_median"] == pytest.approx(0.05, abs=2e-3)
    assert more["delay"] == pytest.approx(0.15)


def test_a_clock_set_back_loses_nothing_and_makes_no_pause_of_less_than_nothing(team, monkeypatch):
    sent(team, 0, 20)
    real = trials.time.time
    monkeypatch.setattr(trials.time, "time", lambda: real() - 3600.0)
    again = opened_again(team)
    assert sent(again, 20, None, "b")["done"]
    assert again.fault == ""
    assert again.record.pauses == [{"row": 20, "seconds": 0.0, "why": "begun again"}]


def test_a_kernel_that_is_changed_leaves_the_rows_and_verifies_nothing(team, monkeypatch):
    assert sent(team, 0, None)["done"]
    before = team.session()
    assert before.metadata.more["verified"]
    monkeypatch.setattr("trustlab.live.tasks.team.PULL", 0.13)
    after = team.session()
    assert after.data.equals(before.data)
    said = after.metadata.more
    assert (said["verified"], said["not_verified"][:12]) == (False, "row 0 is not")


def test_another_version_neither_verifies_nor_continues(team, monkeypatch):
    sent(team, 0, 5)
    other = made_by() | {"sources": "0" * 16}
    monkeypatch.setattr(trials, "made_by", lambda: other)
    assert team.record.fault(team.task).startswith(f"made by trustlab {other['version']} (sour")
    with refused("continued by the version that began it alone"):
        opened_again(team)


def test_a_row_that_was_not_computed_is_found(team):
    """But not another processor's last digits."""
    sent(team, 0, 40)
    sent(team, 40, 41)
    record, *_ = read_record(team.log.path)
    leader = record.settings["columns"].index("leader")
    found = "row 7 is not what its commands lead to"
    for column, by, fault in (
        (0, 1e-15, found),
        (10, 1e-6, found),
        (leader, 1.0, found),
        (10, 1e-12, ""),
    ):
        true = record.rows[7][column]
        record.rows[7][column] += by
        assert record.fault(team.task) == fault, column
        record.rows[7][column] = true
    record.rows += [record.rows[-1]] * 10
    assert record.fault(team.task) == "row 41 has no command"


@pytest.mark.parametrize(("text", "fault"), [("", "does not hold a drive"), ("x\n", "line 1")])
def test_a_file_that_is_no_run_is_named(path, text, fault):
    path.write_text(text)
    assert fault in read_record(path)[2]
