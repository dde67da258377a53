"""
The widgets, without and within Chromium; their kernel is this process.

Oracle: the trial's log, and the task stepped by its commands.
"""

import json
from functools import partial
from types import FunctionType
from unittest.mock import Mock

import numpy as np
import pytest

import trustlab as tl
from tests.cases import refused
from trustlab.live.study.pages import read_words
from trustlab.live.task import PERIOD
from trustlab.live.tasks.team import LeadingSettings
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

drive = partial(tl.LiveGroundRobot, "C1", MODEL)
flight = partial(tl.LiveTracking, "MMI", duration=4.0)
team = partial(tl.LiveTeam, "by_hand", LeadingSettings(duration=4.0), seed=4)


@pytest.fixture
def log(tmp_path):
    return tmp_path / "a.jsonl"


def heard(live, **message):
    """What the kernel answers to a message of the page."""
    live.send = Mock()
    live._answer(live, message, None)
    return live.send.call_args.args[0]


def begin(live, window="a"):
    return heard(live, begin=True, window=window)


def commanded(live, command, count, k=0, window="a"):
    """What the kernel answers to a command that is given so often."""
    return heard(live, window=window, k=k, commands=[command] * count, seen=k)


RUNS = [(drive, [0.3, 0.2, 1]), (flight, [0.5, -0.2, 0.8]), (team, [0.5, 0.5, 2])]


@pytest.mark.parametrize(("make", "command"), RUNS)
def test_a_run_goes_on_after_a_restart_of_the_kernel(log, make, command):
    live = make(log=log)
    assert not live.verified
    with refused("two samples"):
        live.session  # noqa: B018
    begun = begin(live)
    assert (begun["k"], begun["config"]["words"]) == (0, read_words())
    assert commanded(live, command, 20)["k"] == 20
    assert make(log=log).trial is live.trial, "the cell, run again"
    live.trial.log.close()
    LiveWidget.trials.clear()
    again = make(log=log)
    assert again.trial.rows == live.trial.rows
    assert begin(again, "b")["k"] == 20
    assert commanded(again, command, 10, 20, "b")["k"] == 30
    assert again.verified
    about = again.session.metadata
    assert (about.participant, about.synthetic, about.more["verified"]) == ("me", False, True)
    assert heard(again, end=True)["done"]
    assert again.trial.record.end == "stopped by the person"
    with refused("holds another run, or one that is over"):
        make(log=log)


def test_logs_lie_under_the_users_state_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    make = partial(tl.LiveTeam, "by_hand", seed=1)
    first = make()
    begin(first)
    assert first.path.startswith(f"{tmp_path}/trustlab/live/by_hand-")
    assert make().path == first.path
    assert len({first.path, make(seed=2).path, make(participant="you").path}) == 3
    heard(first, end=True)
    assert make().path == first.path.replace("-1.jsonl", "-2.jsonl")
    monkeypatch.setenv("XDG_STATE_HOME", first.path)
    for log in (None, tmp_path / f"{'long' * 99}.jsonl"):
        with refused(r"cannot write .*\.jsonl: .*give a folder"):
            make(log=log)


def test_what_goes_wrong_is_answered(log, full_disk):
    live = team(log=log)
    begin(live)
    assert commanded(live, [2.0, 0.0, 1], 1) == {"refused": "pointer_x cannot be 2.0"}
    with full_disk():
        answer = commanded(live, [0.5, 0.0, 1], 1)
    assert answer == {"trouble": "The log cannot be written: No space left on device."}
    assert commanded(live, [0.5, 0.0, 1], 1)["k"] == 1


class Late:
    """A delay of one's own; what it is called by Python holds where it lies in memory."""

    def __call__(self, t):
        return 0.2


def by_half(state):
    return state.alpha_min, state.beta_max


def test_a_flight_has_parts_of_ones_own_and_is_recognized(tmp_path, monkeypatch):
    """As after a restart of the kernel, which makes functions and objects anew."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))

    def make(scheme=by_half, delay=None, **more):
        scheme, task = tl.Scheme("mine", scheme), tl.TrackingTask(view=0.4)
        return tl.LiveTracking(scheme, delay=delay or Late(), task=task, duration=2.0, **more)

    live = make(FunctionType(by_half.__code__, {}, "by_half"))
    assert make().path == live.path
    assert " at 0x" not in json.dumps(live.trial.settings["parts"])
    begin(live)
    assert commanded(live, [0.4, 0.1, -1.0], 40)["done"]
    session = live.session
    assert live.verified
    assert (session["alpha"] == tl.teleoperation.STUDIES["main"].scattering.alpha_min).all()
    assert list(live.energy) == [name for name in session if name.startswith("energy_")]
    assert session.metadata.more["robot"] == "simulated"
    with refused("holds another run"):
        make(delay=0.1, log=live.path)
    with refused("delay must be"):
        tl.LiveTracking(delay="0.1")


class InTurn:
    """Robots lead in turn; oracle: the clock."""

    title = "in turn"

    def leader(self, now):
        return int(now.t // 6.0) % 3


def test_conditions_and_policies_of_ones_own_allocate_and_lead(log):
    slow = tl.LiveCondition("slow", "tsc", forced=True, notice=10.0)
    make = partial(tl.LiveGroundRobot, slow, MODEL, log=log)
    with refused(r"slow needs thresholds=\(TSC_l, TSC_u\)"):
        make()
    drive = make((0.0, 0.35))
    assert drive.trial.settings["switching"]["notice"] == 10.0
    begin(drive)
    commanded(drive, [0.3, 0.2, 1], 20)
    assert (drive.session.metadata.condition, drive.verified) == ("slow", True)
    settings, log = LeadingSettings(robots=3.0, duration=20.0, least_delay=0.5), f"{log}.b"
    live = tl.LiveTeam(InTurn(), settings, log=log)
    assert begin(live)["config"]["late"] == 0.5
    assert commanded(live, [0.0, 0.0, 3], 400)["done"]
    assert live.session["leader"][[0, 150, 300]].tolist() == [1, 2, 3]
    assert (live.session.metadata.more["policy"], live.verified) == ("in turn", True)
    with refused("holds another run"):
        tl.LiveTeam("by_hand", settings, log=log)
    lost = type("Lost", (InTurn,), {"leader": lambda self, now: 7})()
    with refused(r"leader policy 'in turn', at t = 0 s: .* got 7"):
        tl.LiveTeam(lost, settings, log=f"{log}.c")


# in Chromium
# --------------------------------------------------------------------------------------------------


class Notebook:
    """A page with the widget; `away` is a kernel that does not answer."""

    def __init__(self, browser, live):
        self.live, self.away = live, False
        self.page, self.faults = browser.new_page(), []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        given = json.dumps({"words": read_words(), "path": live.path})
        self.files = {
            "": ("text/html", PAGE),
            "widget.js": ("text/javascript", module_of(*MODULES)),
            "given.json": ("application/json", given),
        }
        self.page.route(f"{HOME}**", self.serve)
        self.page.expose_function("kernel", self.kernel)
        self.page.goto(HOME)

    def serve(self, route):
        kind, body = self.files[route.request.url.removeprefix(HOME)]
        route.fulfill(content_type=kind, body=body)

    def kernel(self, text):
        return "" if self.away else json.dumps(heard(self.live, **json.loads(text)))

    @property
    def rows(self):
        return len(self.live.trial.rows)

    def says(self, words):
        return words in self.page.inner_text("body")

    def start(self, click):
        click("text=Start driving")
        self.page.wait_for_function("document.querySelector('canvas')")

    def until(self, ready):
        for _ in range(400):
            if ready():
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"waited 20 s; {self.rows} rows, {self.faults}")


def test_keys_steer_and_a_double_click_on_start_ends_nothing_and_stop_asks_first(browser, log):
    one = Notebook(browser, drive(log=log))
    page, trial = one.page, one.live.trial
    one.start(page.dblclick)
    assert page.evaluate("document.activeElement.className").startswith("tl-drive")
    page.keyboard.press("Space")
    page.keyboard.down("ArrowUp")
    one.until(lambda: one.rows > 15)
    assert np.array(trial.record.commands)[:, 0].max() > 0.3
    assert one.says("Nobody can switch in the first 100 s")
    assert one.says(one.live.path)
    answers = ["dismiss", "accept"]
    page.on("dialog", lambda dialog: getattr(dialog, answers.pop(0))())
    page.click("text=Stop")
    there = one.rows
    one.until(lambda: one.rows > there + 10)
    assert not trial.done
    page.click("text=Stop")
    one.until(lambda: trial.done and one.says("is over"))
    assert one.faults == []
    page.close()


def test_a_kernel_that_is_away_is_waited_for(browser, log):
    one = Notebook(browser, flight(log=log))
    one.start(one.page.click)
    one.until(lambda: one.rows > 20)
    one.away = True
    one.page.wait_for_timeout(1500)
    there = one.rows
    one.page.wait_for_timeout(800)
    assert one.rows == there
    assert one.says("Waiting")
    one.away = False
    one.until(lambda: one.rows == round(4.0 / PERIOD))
    record = one.live.trial.record
    assert record.end == "complete"
    assert max(pause["seconds"] for pause in record.pauses) > 1.0
    assert one.live.verified
    assert one.faults == []
    one.page.close()
