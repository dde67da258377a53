"""
The widgets, without and within Chromium; their kernel is this process.

Oracle: the trial's log, and the task stepped by its commands.
"""

import json
from contextlib import ExitStack
from functools import partial
from types import FunctionType

import numpy as np
import pytest

import trustlab as tl
from trustlab.live.study.pages import read_words
from trustlab.live.task import PERIOD
from trustlab.live.tasks.team import LeadingSettings
from trustlab.live.trial import read_record
from trustlab.live.widget import MODULES, LiveWidget, module_of

HOME = "https://live.test/"
MODEL = tl.published_models()["2"]
PAGE = """<!doctype html><meta charset="utf-8"><div id="place"></div><script type="module">
import widget from "./widget.js";
const given = await (await fetch("./given.json")).json();
const heard = new Set();
const model = {
  get: (name) => given[name],
  on: (type, act) => heard.add(act),
  off: (type, act) => heard.delete(act),
  send: async (said) => {
    const answer = await window.kernel(JSON.stringify(said));
    if (answer) heard.forEach((act) => act(JSON.parse(answer)));
  },
};
widget.render({ model, el: document.getElementById("place") });
</script>"""


def a_drive(tmp_path, **more):
    options = {"model": MODEL, "log": tmp_path / "a.jsonl", **more}
    return tl.LiveGroundRobot("C1", **options)


def a_flight(tmp_path, **more):
    return tl.LiveTracking("MMI", seed=0, duration=4.0, log=tmp_path / "b.jsonl", **more)


def a_team(tmp_path, **more):
    settings = LeadingSettings(duration=4.0)
    return tl.LiveTeam("by_hand", settings, seed=4, log=tmp_path / "c.jsonl", **more)


def heard(live, **message):
    """What the kernel answers to a message of the page."""
    answers = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(type(live), "send", lambda _, answer: answers.append(answer))
        live._answer(live, message, None)
    return answers[0]


COMMANDS = {a_drive: [0.3, 0.2, 1], a_flight: [0.5, -0.2, 0.8], a_team: [0.5, 0.5, 2]}


@pytest.mark.parametrize("make", COMMANDS)
def test_a_run_goes_on_after_a_restart_of_the_kernel(tmp_path, make):
    live = make(tmp_path)
    assert not live.verified
    with pytest.raises(ValueError, match="two samples"):
        live.session  # noqa: B018
    begun = heard(live, begin=True, window="a")
    assert (begun["k"], begun["config"]["words"]) == (0, read_words())
    assert heard(live, window="a", k=0, commands=[COMMANDS[make]] * 20, seen=0)["k"] == 20
    assert make(tmp_path).trial is live.trial, "the cell, run again"
    live.trial.log.close()
    LiveWidget.trials.clear()
    again = make(tmp_path)
    assert again.trial is not live.trial
    assert again.trial.rows == live.trial.rows
    assert heard(again, begin=True, window="b")["k"] == 20
    assert heard(again, window="b", k=20, commands=[COMMANDS[make]] * 10, seen=18)["k"] == 30
    assert again.verified
    session = again.session
    assert session.metadata.participant == "me"
    assert session.metadata.more["verified"]
    assert session.metadata.more["pauses"][-1]["why"] == "begun again"
    assert not session.metadata.synthetic
    assert heard(again, end=True)["done"]
    assert again.trial.record.end == "stopped by the person"
    with pytest.raises(ValueError, match="holds another run, or one that is over"):
        make(tmp_path)


def test_logs_lie_under_the_users_state_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    first = tl.LiveTeam("by_hand", seed=1)
    heard(first, begin=True, window="a")
    assert first.path.startswith(f"{tmp_path}/trustlab/live/by_hand-")
    assert tl.LiveTeam("by_hand", seed=1).path == first.path
    assert tl.LiveTeam("by_hand", seed=2).path != first.path
    assert tl.LiveTeam("by_hand", seed=1, participant="you").path != first.path
    heard(first, end=True)
    assert tl.LiveTeam("by_hand", seed=1).path == first.path.replace("-1.jsonl", "-2.jsonl")
    monkeypatch.setenv("XDG_STATE_HOME", first.path)
    for log in (None, tmp_path / f"{'long' * 99}.jsonl"):
        with pytest.raises(ValueError, match=r"cannot write .*\.jsonl: .*give a folder"):
            tl.LiveTeam("by_hand", seed=1, log=log)


class Late:
    """A delay of one's own; what it is called by Python holds where it lies in memory."""

    def __call__(self, t):
        return 0.2


def by_half(state):
    return state.alpha_min, state.beta_max


def test_a_flight_with_parts_of_ones_own_is_recognized(tmp_path, monkeypatch):
    """As after a restart of the kernel, which makes functions and objects anew."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    path = tl.LiveTracking(tl.Scheme("mine", by_half), delay=Late()).path
    again = FunctionType(by_half.__code__, {}, "by_half")
    other = tl.LiveTracking(tl.Scheme("mine", again), delay=Late())
    assert other.path == path
    assert " at 0x" not in json.dumps(other.trial.settings["parts"])
    with pytest.raises(ValueError, match="delay must be"):
        tl.LiveTracking(delay="0.1")


def test_pictures_of_a_team_are_as_late_as_asked(tmp_path):
    settings = LeadingSettings(least_delay=0.5)
    live = tl.LiveTeam("by_hand", settings, log=tmp_path / "c.jsonl")
    assert live.trial.settings["late"] == 0.5


def test_what_goes_wrong_is_answered(tmp_path, full_disk):
    live = a_team(tmp_path)
    heard(live, begin=True, window="a")
    message = {"window": "a", "k": 0, "seen": 0}
    bad = heard(live, **message, commands=[[2.0, 0.0, 1]])
    assert bad == {"refused": "pointer_x cannot be 2.0"}
    with full_disk():
        answer = heard(live, **message, commands=[[0.5, 0.0, 1]])
    assert answer == {"trouble": "The log cannot be written: No space left on device."}
    assert heard(live, **message, commands=[[0.5, 0.0, 1]])["k"] == 1


def test_a_flight_has_parts_of_ones_own(tmp_path):
    scheme = tl.Scheme("mine", lambda state: (state.alpha_min, state.beta_max))
    task = tl.TrackingTask(view=0.4)
    options = {"scheme": scheme, "delay": 0.2, "task": task, "duration": 2.0, "seed": 3}
    live = tl.LiveTracking(**options, log=tmp_path / "own.jsonl")
    heard(live, begin=True, window="a")
    answer = heard(live, window="a", k=0, commands=[[0.4, 0.1, -1.0]] * 40, seen=0)
    assert answer["done"]
    session = live.session
    assert live.verified
    assert (session["alpha"] == tl.teleoperation.STUDIES["main"].scattering.alpha_min).all()
    assert list(live.energy) == [name for name in session if name.startswith("energy_")]
    assert session.metadata.more["robot"] == "simulated"
    with pytest.raises(ValueError, match="holds another run"):
        tl.LiveTracking(**options | {"delay": 0.1}, log=tmp_path / "own.jsonl")


class InTurn:
    """Robots lead in turn; oracle: the clock."""

    title = "in turn"

    def leader(self, now):
        return int(now.t // 6.0) % 3


def test_schemes_of_ones_own_allocate_and_lead(tmp_path):
    slow = tl.LiveCondition("slow", "tsc", forced=True, notice=10.0)
    with pytest.raises(ValueError, match=r"slow needs thresholds=\(TSC_l, TSC_u\)"):
        tl.LiveGroundRobot(slow, MODEL, log=tmp_path / "a.jsonl")
    drive = tl.LiveGroundRobot(slow, MODEL, (0.0, 0.35), log=tmp_path / "a.jsonl")
    assert drive.trial.settings["switching"]["notice"] == 10.0
    heard(drive, begin=True, window="a")
    heard(drive, window="a", k=0, commands=[[0.3, 0.2, 1]] * 20, seen=0)
    assert (drive.session.metadata.condition, drive.verified) == ("slow", True)
    settings = LeadingSettings(robots=3, duration=20.0)
    live = tl.LiveTeam(InTurn(), settings, log=tmp_path / "b.jsonl")
    heard(live, begin=True, window="a")
    assert heard(live, window="a", k=0, commands=[[0.0, 0.0, 3]] * 400, seen=0)["done"]
    assert live.session["leader"][[0, 150, 300]].tolist() == [1, 2, 3]
    assert live.session.metadata.more["policy"] == "in turn"
    assert live.verified
    with pytest.raises(ValueError, match="holds another run"):
        tl.LiveTeam("by_hand", settings, log=tmp_path / "b.jsonl")
    lost = type("Lost", (InTurn,), {"leader": lambda self, now: 7})()
    with pytest.raises(ValueError, match=r"leader policy 'in turn', at t = 0 s: .* got 7"):
        tl.LiveTeam(lost, settings, log=tmp_path / "c.jsonl")


# in Chromium
# --------------------------------------------------------------------------------------------------


class Notebook:
    """A page with the widget; `away` is a kernel that does not answer."""

    def __init__(self, context, live):
        self.live, self.away = live, False
        self.page, self.faults = context.new_page(), []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        given = json.dumps({"words": read_words(), "path": live.path})
        for name, kind, body in (
            ("", "text/html", PAGE),
            ("widget.js", "text/javascript", module_of(*MODULES)),
            ("given.json", "application/json", given),
        ):
            self.page.route(HOME + name, partial(serve, kind, body))
        self.page.expose_function("kernel", self.kernel)
        self.page.goto(HOME)

    def kernel(self, text):
        return "" if self.away else json.dumps(heard(self.live, **json.loads(text)))

    @property
    def rows(self):
        return len(self.live.trial.rows)

    def start(self):
        self.page.click("text=Start driving")
        self.page.wait_for_function("document.querySelector('canvas')")

    def until(self, ready):
        for _ in range(400):
            if ready():
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"waited 20 s; {self.rows} rows, {self.faults}")


def serve(kind, body, route):
    route.fulfill(content_type=kind, body=body)


@pytest.fixture
def notebook(browser):
    """A function that opens a page with a widget."""
    with ExitStack() as contexts:
        yield lambda live: Notebook(contexts.enter_context(browser.new_context()), live)


def test_keys_steer_and_a_double_click_on_start_ends_nothing(notebook, tmp_path):
    one = notebook(a_drive(tmp_path))
    one.page.dblclick("text=Start driving")
    one.page.wait_for_function("document.querySelector('canvas')")
    assert one.page.evaluate("document.activeElement.className").startswith("tl-drive")
    one.page.keyboard.press("Space")
    one.page.keyboard.down("ArrowUp")
    one.until(lambda: one.rows > 15)
    assert not one.live.trial.done
    speed = np.array(one.live.trial.record.commands)[:, 0]
    assert speed.max() > 0.3
    assert "Nobody can switch in the first 100 s" in one.page.inner_text(".suggestion")
    assert one.live.path in one.page.inner_text("body")
    assert one.faults == []


def test_stop_asks_first(notebook, tmp_path):
    one = notebook(a_team(tmp_path))
    one.start()
    answers = ["dismiss", "accept"]
    one.page.on("dialog", lambda dialog: getattr(dialog, answers.pop(0))())
    one.page.click("text=Stop")
    one.until(lambda: one.rows > 10)
    assert not one.live.trial.done
    one.page.click("text=Stop")
    one.until(lambda: one.live.trial.done)
    one.until(lambda: "is over" in one.page.inner_text("body"))
    assert one.faults == []


def test_a_kernel_that_is_away_is_waited_for(notebook, tmp_path):
    one = notebook(a_flight(tmp_path))
    one.start()
    one.until(lambda: one.rows > 20)
    one.away = True
    one.page.wait_for_timeout(1500)
    there = one.rows
    one.page.wait_for_timeout(800)
    assert one.rows == there
    assert "Waiting" in one.page.inner_text("body")
    one.away = False
    one.until(lambda: one.rows == round(4.0 / PERIOD))
    record, _, fault = read_record(tmp_path / "b.jsonl")
    assert (record.end, fault) == ("complete", "")
    assert max(pause["seconds"] for pause in record.pauses) > 1.0
    assert one.live.verified
    assert one.faults == []
