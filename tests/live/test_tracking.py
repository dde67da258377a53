"""
A person flies after the target: messages as a page would send them, and the page itself in
Chromium.

Oracle: the loop of `TeleoperationLoop`, stepped here under the hands that were sent; the passivity
of the operator's port.
"""

import json
import math

import numpy as np
import pytest

import trustlab as tl
from trustlab.live.ground_robot import module_of
from trustlab.live.tracking import LiveTracking
from trustlab.teleoperation import Guidance
from trustlab.testbeds import uav_tracking

HOME = "https://tracking.test/"
PAGE = """<!doctype html><meta charset="utf-8"><div id="place"></div><script type="module">
import widget from "./widget.js";
const config = await (await fetch("./config.json")).json(), heard = [];
const model = {
  get: () => config,
  on: (type, act) => heard.push(act),
  send: async (said) => {
    const answer = JSON.parse(await window.kernel(JSON.stringify(said)));
    heard.forEach((act) => act(answer));
  },
};
widget.render({ model, el: document.getElementById("place") });
window.ready = true;
</script>"""
PAD = """window.rumbles = [];
window.pad = { connected: true, axes: [0.05, 0, 0, 0], buttons: [],
  vibrationActuator: { playEffect: async (kind, how) => { rumbles.push(how.strongMagnitude); } } };
navigator.getGamepads = () => [null, window.pad];"""


def flown(live, seconds, hand=lambda answer, time: (0.0, 0.0), begin=0.0):
    """Return the last answer to 30 messages a second by a hand that sees the answers."""
    answer = live.hear({"hand": [0.0, 0.0], "time": begin})
    for k in range(1, round(30 * seconds) + 1):
        answer = live.hear({"hand": list(hand(answer, k / 30)), "time": begin + k / 30})
    return answer


def following(answer, time):
    x, y = answer["target"]
    return max(-1.0, min(0.6 * x, 1.0)), max(-1.0, min(0.6 * y, 1.0))


@pytest.mark.parametrize("scheme", ["M", "MI", "TMIG", "OMI"])
def test_a_run_has_the_bits_of_a_stepped_loop(scheme):
    live = tl.LiveTracking(scheme, seed=4, duration=60.0, participant="p7")
    flown(live, 6.0, lambda answer, time: (0.5 * math.sin(time), -0.4))
    session = live.session
    again = tl.TeleoperationLoop(scheme, tl.Teleoperator(reach=1.0, noise=0.0), seed=4)
    for hand in session.data[["hand_x", "hand_y", "hand_z"]].to_numpy():
        again.step(hand=hand)
    expected = again.session.data
    assert np.array_equal(session.data[list(expected)], expected)
    assert live.verified
    assert not session.metadata.synthetic
    assert session.metadata.participant == "p7"
    assert session.metadata.more["robot"] == "simulated"
    assert "force feedback" not in json.dumps(session.metadata.as_dict())
    live.run.hands[300] = (1e-9, 0.0, 0.0)
    assert not live.verified, "another hand gives another log"


def test_each_sample_has_the_newest_hand_sent_before_it():
    live = tl.LiveTracking("M", seed=0)
    for time, x in ((5.0, 0.2), (5.035, 0.5), (5.081, -1.0), (5.1005, 0.0)):
        live.hear({"hand": [x, 0.0], "time": time})
    assert live.session.data["hand_x"].to_list() == pytest.approx(
        3 * [0.04] + 5 * [0.1] + 2 * [-0.2]
    )
    assert (live.session.data[["hand_y", "hand_z"]] == 0.0).all(axis=None)


def test_a_third_axis_at_zero_keeps_the_height():
    live = tl.LiveTracking("M", seed=0)
    flown(live, 5.0, following)
    assert np.ptp(live.session["robot_z"]) == 0.0


def test_a_hand_at_rest_earns_no_energy_and_gets_none():
    for guidance in ("at_operator", "through_channel"):
        live = tl.LiveTracking("M", guidance=guidance, seed=1)
        flown(live, 30.0)
        assert live.energy["energy_port"].min() >= -1e-9
        assert live.energy["energy_operator"].abs().max() <= 1e-2
    off = tl.LiveTracking("M", guidance=Guidance(guard="off"), seed=1)
    flown(off, 30.0)
    assert off.energy["energy_port"].min() < -1e-3, (
        "without its guard guidance moves the hand by energy of its own"
    )


def test_a_hand_that_follows_the_picture_tracks_better_than_one_at_rest():
    best, rest = tl.LiveTracking("M", seed=2), tl.LiveTracking("M", seed=2)
    flown(best, 40.0, following)
    flown(rest, 40.0)
    assert best.session["path_error"].mean() < 0.5 * rest.session["path_error"].mean()


def test_the_view_is_late_and_ends_where_the_picture_does():
    live = tl.LiveTracking("M", seed=0, task=tl.TrackingTask(view=0.2))
    seen = []
    flown(
        live, 5.0, lambda answer, time: seen.append((answer["t"], answer["target"])) or (0.0, 0.0)
    )
    data = live.session.data
    error = (
        data[["reference_x", "reference_y"]].to_numpy() - data[["robot_x", "robot_y"]].to_numpy()
    )
    for t, target in seen[20:]:
        then = error[round(100 * t) - 1 - 10]
        if np.abs(then).max() > 0.2:
            assert target is None
        else:
            assert target == pytest.approx(then, abs=1e-12)
    assert seen[20][1] is not None
    assert seen[-1][1] is None
    assert live.config["half"] == 0.2


def test_pauses_are_noted_and_do_not_count():
    live = tl.LiveTracking("TMIG", seed=0, duration=2.0)
    flown(live, 1.0)
    before = live.run.loop.t
    live.hear({"pause": "the page is hidden"})
    flown(live, 0.2, begin=9.0)
    live.hear({"hand": [0.0, 0.0], "time": 9.9})
    assert live.run.loop.t == pytest.approx(before + 0.2, abs=0.011)
    assert not live.session.metadata.more["finished"]
    answer = flown(live, 2.0, begin=1.0)
    assert live.session.duration == pytest.approx(1.99), "it ends when its time is over"
    notes = live.session.metadata.more["notes"]
    assert "the page is hidden" in notes[0]
    assert "nothing was heard" in notes[1]
    assert "began anew" in notes[2]
    assert answer["over"] == notes[-1]
    assert live.session.metadata.more["verified"] is True
    assert live.session.metadata.more["finished"] is True


class Interrupted:
    """NumPy, in which a step of another thread falls into every call."""

    def __init__(self, loop):
        self.loop = loop

    def __getattr__(self, name):
        if name in ("round", "empty", "arange"):
            self.loop._advance(self.loop.simulation.done + 1)
        return getattr(np, name)


def test_a_session_is_whole_while_another_thread_steps(monkeypatch):
    """A notebook's kernel hears in a thread of its own while a cell asks for the session."""
    live = tl.LiveTracking("M", seed=0)
    flown(live, 1.0)
    loop = live.run.loop
    before = loop.simulation.done
    with monkeypatch.context() as patched:
        patched.setattr(uav_tracking, "np", Interrupted(loop))
        session = loop.session
    assert loop.simulation.done > before
    assert len(session) == before
    assert session.data.equals(loop.session.data.iloc[:before])


def test_a_flight_is_flown_again_by_another_kernel():
    """The page sends what it has kept: the same bits, and the flight goes on."""
    sent = [{"hand": [math.sin(k / 9), 0.2], "time": k / 30} for k in range(90)]
    sent.insert(40, {"pause": "the page is hidden"})
    first = tl.LiveTracking("TMIG", seed=0)
    first.hear({"begin": [], "window": "a"})
    for message in sent:
        first.hear(message | {"window": "a"})
    again = tl.LiveTracking("TMIG", seed=0)
    assert again.config["key"] == first.config["key"]
    assert tl.LiveTracking("TMIG", seed=1).config["key"] != first.config["key"]
    answer = again.hear({"begin": sent, "window": "b"})
    assert answer["t"] == first.run.loop.t
    assert again.session.data.equals(first.session.data)
    assert "taken up again" in again.session.metadata.more["notes"][-1]
    for message in sent:
        again.hear(message | {"window": "b"})
    assert len(again.session) > 1.9 * len(first.session)
    assert again.verified
    before = len(again.session)
    again.hear({"begin": sent, "window": "c"})
    assert len(again.session) == before, "a kernel that knows the flight does not fly it again"


def test_the_window_that_began_last_flies():
    live = tl.LiveTracking("M", seed=0)
    for window in "ab":
        live.hear({"begin": [], "window": window})
    assert (
        "another window" in live.hear({"hand": [1.0, 0.0], "time": 0.0, "window": "a"})["refused"]
    )
    assert live.run.heard is None


def test_a_run_can_be_stopped():
    live = tl.LiveTracking("M", seed=0)
    flown(live, 1.0)
    assert "stopped" in live.hear({"end": "stopped by the person"})["over"]
    rows = len(live.session)
    flown(live, 1.0, begin=1.5)
    assert len(live.session) == rows


def test_a_run_that_diverges_is_kept_up_to_there():
    tug = tl.Scheme("tug", lambda state: (2.0 if state.t > 0.5 else 1.0, state.beta_max))
    live = tl.LiveTracking(tug, seed=0)
    answer = flown(live, 1.0)
    assert "scheme of this loop returned alpha" in answer["over"]
    assert set(answer) == {"over"}
    assert live.session.duration == pytest.approx(0.5, abs=0.011)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scheme": "TMGI"}, "did you mean"),
        ({"scheme": "MMI"}, "allocates by hand"),
        ({"study": "mane"}, "study"),
        ({"guidance": "none"}, "guidance"),
        ({"delay": -1.0}, "delay"),
        ({"duration": 1e9}, "duration must lie in"),
        ({"participant": ""}, "participant"),
        ({"task": "eight"}, "TrackingTask"),
        ({"vibration": 1}, "vibration"),
    ],
)
def test_arguments_are_checked(arguments, message):
    with pytest.raises(ValueError, match=message):
        LiveTracking(**arguments)


@pytest.mark.parametrize(
    "said",
    [
        {"hand": [2.0, 0.0], "time": 0.0},
        {"hand": [0.0], "time": 0.0},
        {"hand": [0.0, 0.0], "time": "now"},
    ],
)
def test_messages_are_checked(said):
    with pytest.raises(ValueError, match=r"hand|time"):
        tl.LiveTracking("M").hear(said)


def test_the_comm_handler_hears_and_answers(monkeypatch):
    live, sent = tl.LiveTracking("M", seed=0), []
    monkeypatch.setattr(live, "send", sent.append)
    for k in range(3):
        live._handle_custom_msg({"id": k, "hand": [0.1, 0.0], "time": 0.1 * k}, [])
    assert [answer["id"] for answer in sent] == [0, 1, 2]
    assert sent[-1]["t"] == pytest.approx(0.2, abs=0.011)
    json.dumps(sent)


def test_a_session_needs_two_samples():
    with pytest.raises(ValueError, match="at least two samples"):
        tl.LiveTracking("M").session  # noqa: B018


def serving(kind, body):
    return lambda route: route.fulfill(content_type=kind, body=body)


def opened(browser, live, heard, script=""):
    """Return a page with the widget, its kernel being this process, and the page's errors."""
    page, faults = browser.new_page(), []
    page.on("pageerror", lambda error: faults.append(str(error)))
    files = {
        "": ("text/html", PAGE),
        "widget.js": ("text/javascript", module_of("page.js", "rows.js", "pad.js", "tracking.js")),
        "config.json": ("application/json", json.dumps(live.config)),
    }
    for name, (kind, body) in files.items():
        page.route(HOME + name, serving(kind, body))

    def kernel(text):
        said = json.loads(text)
        heard.append(said)
        return json.dumps({"id": said["id"]} | live.hear(said))

    page.expose_function("kernel", kernel)
    page.add_init_script(script)
    page.goto(HOME)
    page.wait_for_function("window.ready")
    return page, faults


def test_a_stick_is_the_hand_and_its_pad_gives_the_vibration_cue(browser):
    for vibration in (True, False):
        live, heard = tl.LiveTracking("M", seed=0, vibration=vibration), []
        page, faults = opened(browser, live, heard, PAD)
        page.click("text=Start")
        page.wait_for_timeout(200)
        assert heard[-1]["hand"] == [0, 0], "a stick at rest, with its play"
        page.evaluate("pad.axes = [0.5, 0.25, 0, 0]")
        page.wait_for_timeout(600)
        assert heard[-1]["hand"] == [0.5, -0.25]
        rumbles = page.evaluate("rumbles")
        assert bool(rumbles) == vibration
        assert all(0.0 <= share <= 1.0 for share in rumbles)
        assert not vibration or max(rumbles) > 0.0
        assert ("vibration cue" in live.session.metadata.more["cues"]) == vibration
        assert faults == []
        page.close()


def test_the_page_sends_the_pointer_and_draws_the_answers(browser):
    live, heard = tl.LiveTracking("M", seed=0, duration=60.0), []
    page, faults = opened(browser, live, heard)
    page.click("text=Start")
    box = page.locator("canvas.pad").bounding_box()
    for share in np.linspace(0.5, 0.5 + 0.35 * 0.8, 20):
        page.mouse.move(
            box["x"] + share * box["width"], box["y"] + (0.5 - 0.35 * 0.5) * box["height"]
        )
        page.wait_for_timeout(50)
    page.wait_for_timeout(300)
    drawn = page.evaluate("document.querySelector('.tl-track').drawn")
    ink = """(name) => {
        const c = document.querySelector(name);
        const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
      return d.filter((x, i) => i % 4 === 3 && x > 0).length; }"""
    assert drawn["frames"] > 10
    assert drawn["now"]["t"] > 0.5
    assert page.evaluate(ink, "canvas.picture") > 500
    assert page.evaluate(ink, "canvas.pad") > 500
    assert "visual cue" in page.inner_text(".tl-track .hint")
    hands = [said["hand"] for said in heard if "hand" in said]
    assert hands[-1] == pytest.approx([0.8, 0.5], abs=0.02)
    page.evaluate(
        "Object.defineProperty(document, 'hidden', { value: true, configurable: true }); "
        "document.dispatchEvent(new Event('visibilitychange'))"
    )
    page.wait_for_timeout(150)
    before = live.run.loop.t
    page.wait_for_timeout(300)
    assert live.run.loop.t == before, "a hidden page pauses the robot"
    page.evaluate("Object.defineProperty(document, 'hidden', { value: false, configurable: true })")
    page.mouse.move(10, box["y"] + 2 * box["height"])
    page.wait_for_timeout(300)
    assert heard[-1]["hand"] == [0, 0], "a hand that has left the square lets go"
    page.click("text=Stop")
    page.wait_for_timeout(200)
    notes = live.session.metadata.more["notes"]
    assert "the page is hidden" in notes[0]
    assert "stopped by the person" in notes[-1]
    assert live.session["hand_x"].max() == pytest.approx(0.16, abs=0.005)
    assert live.verified
    assert faults == []
    page.close()
