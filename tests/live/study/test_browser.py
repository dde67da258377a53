"""
A whole study in Chromium, and what people and machines do to it: tabs close, networks and servers
go away.

Oracle: the commands that the page says were acknowledged, against the files on the disk. Scripted
hands drive; nobody takes part.
"""

import random
import re
import time
from statistics import median

import pytest

import trustlab as tl
from tests.live.cases import advance, record
from tests.live.study.test_crashes import Server, plant_torn_line
from trustlab.live.study.plan import read_tokens
from trustlab.live.study.server import StudyServer
from trustlab.live.task import LiveTask

Error = pytest.importorskip("playwright.sync_api", reason="playwright is not installed").Error
ATTACK = '<script>window.top.fired=1</script><img src=x onerror="window.top.fired=1">'
FILL = """(words) => {
  const groups = new Map();
  for (const input of document.querySelectorAll('input[type=radio]'))
    groups.set(input.name, [...(groups.get(input.name) ?? []), input]);
  let n = Math.floor(1000 * Math.random());
  for (const [, inputs] of groups) inputs[(7 * ++n) % inputs.length].click();
  for (const box of document.querySelectorAll('input[type=checkbox]')) box.click();
  for (const area of document.querySelectorAll('textarea')) area.value = words;
  document.querySelector('form button').click();
}"""


def opened(context, url):
    """A page of the study; what goes wrong in it fails the test that asks `faults`."""
    page = context.new_page()
    page.faults = []
    page.on("pageerror", lambda error: page.faults.append(str(error)))
    page.on(
        "console",
        lambda said: page.faults.append(said.text) if "Content Security" in said.text else None,
    )
    page.goto(url)
    return page


def until(page, script, seconds=60):
    """Poll: Playwright's own waiting needs eval, which the page's policy forbids."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            found = page.evaluate(script)
        except Error as error:  # the page was left for another just now
            if "context was destroyed" not in str(error):
                raise
            found = None
        if found:
            return found
        time.sleep(0.06)
    raise TimeoutError(f"{script}: {page.evaluate('document.body.innerText')[:300]}")


def next_page(page, after=-1):
    """Wait for a page of the study after that one; return its number and kind."""
    until(
        page,
        f"self.study && self.study.page !== null && self.study.page > {after} && "
        "!!document.querySelector('h1')",
    )
    return page.evaluate("[self.study.page, self.study.kind]")


def go_on(page, kind, words=""):
    """Answer a form, or start a drive."""
    if kind == "form":
        page.evaluate(FILL, words)
    else:
        page.click("main > button")


def driving(context, url, rows=8):
    """Go to the training drive, and drive so many rows."""
    page = opened(context, url)
    number, kind = next_page(page)
    if kind == "form":
        go_on(page, kind)
        number, kind = next_page(page, number)
    assert (number, kind) == (1, "drive")
    go_on(page, kind)
    until(page, f"self.study.rows > {rows}")
    return page


def on_disk(plan):
    return len(record(plan).commands)


def wait_for_commands(plan, at_least, seconds=20):
    end = time.monotonic() + seconds
    while on_disk(plan) < at_least and time.monotonic() < end:
        time.sleep(0.05)
    return on_disk(plan)


# the whole study
# --------------------------------------------------------------------------------------------------


def test_three_people_at_once_from_consent_to_report(make_plan, browser):
    course = tl.testbeds.Course(((0, 0), (4, 0), (4, 4), (0, 4)), radius=1.0)
    brief = {"training": 5.0, "identification": [(1, 5.0), (0, 5.0)], "course": course}
    plan = make_plan(rehearsal=True, **brief)
    with StudyServer(plan) as server:
        phone = browser.new_context(viewport={"width": 400, "height": 700})
        experimenter = opened(phone, server.experimenter)
        people = {code: opened(browser.new_context(), url) for code, url in server.links().items()}
        where = dict.fromkeys(people, -1)
        end = time.monotonic() + 240
        while people and time.monotonic() < end:
            for code, page in list(people.items()):
                number, kind = page.evaluate("[self.study?.page ?? -1, self.study?.kind]")
                if number > where[code] and page.evaluate("!!document.querySelector('h1')"):
                    where[code] = number
                    shown = page.inner_text("#where")
                    if kind == "end":
                        assert shown == code
                        assert page.faults == []
                        del people[code]
                    else:
                        assert shown == f"{code} · page {number + 1} of {len(plan.steps(code)) - 1}"
                        go_on(page, kind, f"{code}: {ATTACK}")
            time.sleep(0.15)
        assert not people, where
        until(experimenter, "document.querySelectorAll('tbody tr').length === 3")
        until(experimenter, "document.body.innerText.split('Thank you').length === 4")
        assert " of " not in experimenter.inner_text("tbody tr td:nth-child(3)")
        assert experimenter.query_selector_all("text=/^End$/") == [], "who is done cannot be ended"
        server.participants["P01"].experimenter_end({})
        assert experimenter.evaluate("document.body.scrollWidth <= innerWidth")
        assert experimenter.faults == []
    study = tl.read_live_study(plan.folder)
    measures = study.measures.sort_values(["participant", "position"])
    assert study.participants["complete"].all()
    assert not study.participants["ended"].any()
    assert measures["verified"].all()
    assert measures.groupby("participant")["condition"].agg(list).to_dict() == plan.orders
    answers = study.answers()
    assert len(answers) == 3 * (1 + 2 * (6 + 12 + 4))
    assert answers["text"].str.contains("<script>").sum() == 6
    check_report(study, browser)


def check_report(study, browser):
    """The report is complete in itself, and shows what people wrote as words."""
    path = study.report()
    page = browser.new_page(viewport={"width": 400, "height": 700})
    fetched = []
    page.route("**/*", lambda route: (fetched.append(route.request.url), route.continue_()))
    page.goto(path.as_uri())
    words = page.evaluate("document.body.innerText")
    assert ATTACK in words
    assert page.evaluate("window.fired === undefined && !document.querySelector('img[src=x]')")
    assert [url for url in fetched if not url.startswith(("data:", path.as_uri()))] == []
    assert "scripted hands, no person took part" in words
    assert "0 deleted" in words
    assert page.evaluate("document.body.scrollWidth <= innerWidth"), "tables scroll within"
    assert "Out[" not in words
    headings = ["Who took part", "Measures by condition", "Questionnaires", "Order effects"]
    for heading in [*headings, "What people wrote"]:
        assert heading in words
    assert re.search(r"p_r by condition: \[.*\(N = 3\)", words), words[1000:2500]
    assert str(study.plan.folder.parent) not in path.read_text()


K = "(self.study.run?.state().have ?? -1)"


def lead(page):
    """Point to a place of the hand's square, choose robot 2, and return what the page says."""
    until(page, f"{K} > 4")
    box = page.locator("canvas.pad").bounding_box()
    middle = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    half = 0.35 * box["width"]
    page.mouse.move(middle[0] + 0.9 * half, middle[1] - 0.5 * half)
    page.keyboard.press("2")
    until(page, f"{K} > 10")
    return page.inner_text("#drive")


def test_a_person_leads_a_team(tmp_path, browser):
    """Oracle: where the mouse was, and the replay of the commands that were logged."""
    settings = {"duration": 7.0, "training": 2.0, "goals": 2}
    plan = tl.LiveStudy(tmp_path / "s", ["by_hand", "suggested"], 2, task="team", **settings)
    said, number = [], -1
    with StudyServer(plan) as server:
        page = opened(browser.new_context(), server.links()["P01"])
        number, kind = next_page(page)
        while kind != "end":
            go_on(page, kind, "fine")
            if kind == "drive":
                said.append(lead(page))
                if len(said) == 2:
                    go_on_after_reload(page, number)  # behind the last command
                    lead(page)
                until(page, "!document.querySelector('#drive')")
            number, kind = next_page(page, number)
        assert page.faults == []
    for words in ("Goal 1 of 2", "Robot", "%"):
        assert words in said[0]
    study = tl.read_live_study(plan.folder)
    assert study.measures["verified"].tolist() == [True, True]
    assert study.measures["pauses"].max() >= 1, "the page was loaded again"
    assert study.measures["period_median"].tolist() == pytest.approx([0.05, 0.05], abs=0.02)
    for session in study.sessions():
        assert session["leader_choice"].max() == 2
        last = [session[f"pointer_{axis}"][-1] for axis in "xy"]
        assert last == pytest.approx([0.9, 0.5], abs=0.02)
    by_hand = next(s for s in study.sessions() if s.metadata.condition == "by_hand")
    assert by_hand["leader"][-1] == 2, "from the end of the dwell time on"


# what goes wrong
# --------------------------------------------------------------------------------------------------


def test_a_closed_tab_loses_nothing_and_another_browser_goes_on(served, browser):
    plan, url = served.plan, served.links["P01"]
    context = browser.new_context()
    page = driving(context, url)
    made = page.evaluate("self.study.rows")
    page.close()
    assert on_disk(plan) >= made
    again = driving(context, url, rows=made + 5)  # the same browser
    assert again.faults == []
    other = opened(browser.new_context(), url)  # another one: the same link, the same page
    assert next_page(other) == [1, "drive"]
    go_on(other, "drive")
    until(again, "document.body.innerText.includes('another window')")
    already = on_disk(plan)
    until(other, f"self.study.rows > {already + 5}")
    assert [pause["why"] for pause in record(plan).pauses].count("begun again") >= 1


def go_on_after_reload(page, number):
    page.reload()
    next_page(page, number - 1)
    go_on(page, "drive")


def test_a_reload_switches_no_mode(served, browser):
    """Oracle: the commands on the disk, before the reload and behind it."""
    page = driving(browser.new_context(), served.links["P01"])
    page.keyboard.press("Space")
    until(page, "document.querySelector('.mode').textContent === 'AUTONOMOUS'")
    go_on_after_reload(page, 1)
    before = on_disk(served.plan)
    assert wait_for_commands(served.plan, before + 10) >= before + 10
    assert {command[2] for command in record(served.plan).commands[before:]} == {0}


def test_a_reload_takes_back_no_share(tmp_path, browser):
    """Oracle: four turns of the wheel, each a twentieth."""
    plan = tl.LiveStudy(tmp_path / "s", ["M", "MMI"], 2, task="teleoperation")
    code = next(code for code, order in plan.orders.items() if order[0] == "MMI")
    with StudyServer(plan) as server:
        number = advance(server.participant(code), "drive")
        page = opened(browser.new_context(), server.links()[code])
        next_page(page)
        go_on(page, "drive")
        until(page, f"{K} > 4")
        page.mouse.move(300, 300)
        for _ in range(4):
            page.mouse.wheel(0, 100)
        until(page, "document.body.innerText.includes('80 %')")
        until(page, f"{K} > {page.evaluate(K) + 4}")
        go_on_after_reload(page, number)
        until(page, f"{K} > {page.evaluate(K) + 4}")
        log = record(plan, code, f"{number:02d}-drive")
        assert log.commands[0][2] == 1.0
        assert log.commands[-1][2] == pytest.approx(0.8)
        assert median(log.delays) > 0.099, "nobody sees what the camera does not show yet"
        assert page.faults == []


@pytest.mark.parametrize("seconds", [2.0, pytest.param(5.0, marks=pytest.mark.long)])
def test_time_without_a_network_is_a_pause(served, browser, seconds):
    """A drive stands still without a network, says so, and goes on in place."""
    context = browser.new_context()
    page = driving(context, served.links["P01"])
    context.set_offline(True)
    time.sleep(seconds)
    state = page.evaluate("self.study.run.state()")
    before = on_disk(served.plan)
    assert state["still"]
    assert state["made"] - state["have"] <= 6, "half a second goes out unanswered"
    assert page.evaluate("!document.querySelector('.away').hidden")
    context.set_offline(False)
    assert wait_for_commands(served.plan, before + 10) >= before + 10
    assert page.evaluate("trouble.hidden")
    pauses = record(served.plan).pauses
    assert max(pause["seconds"] for pause in pauses) >= seconds - 0.6
    assert page.faults == []


@pytest.mark.parametrize("seconds", [1.0, pytest.param(15.0, marks=pytest.mark.long)])
def test_a_server_killed_and_back_loses_nothing(make_plan, browser, seconds):
    plan = make_plan(training=60.0)
    server = Server(plan.folder)
    server.start()
    link = f"http://127.0.0.1:{server.port}/p/{read_tokens(plan.folder)['P01']}"
    page = driving(browser.new_context(), link)
    acknowledged = page.evaluate("self.study.rows")
    server.kill()
    assert on_disk(plan) >= acknowledged
    plant_torn_line(plan.folder / "P01" / "01-training.jsonl", random.Random(1))
    time.sleep(seconds)
    made = page.evaluate("self.study.run.state().made")
    server.start()
    try:
        assert wait_for_commands(plan, made + 10) >= made + 10
        assert page.faults == []
    finally:
        server.kill()
    assert len(record(plan).pauses) >= 1


@pytest.mark.long
@pytest.mark.parametrize("task", ["ground_robot", "teleoperation", "team"])
def test_every_frame_of_a_task_moves(tmp_path, browser, task):
    """Frames that differ from the one before, of all that the screen shows in three seconds."""
    plan = tl.LiveStudy(
        tmp_path / "s", participants=2, task=task, training=30.0, whole_squares=False
    )
    with StudyServer(plan) as server:
        page = driving(browser.new_context(), server.links()["P01"], rows=20)
        if task == "ground_robot":
            page.keyboard.down("ArrowUp")
        else:
            box = page.locator("canvas.pad").bounding_box()
            page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.4 * box["height"])
        time.sleep(2.0)
        page.evaluate(FRAMES)
        time.sleep(3.5)
        frames, moved, seconds = page.evaluate("self.counted")
        assert page.faults == []
    assert frames / seconds >= 58.0
    assert moved > 0.9 * frames


FRAMES = """() => {
  const canvas = document.querySelector('canvas'),
    copy = Object.assign(document.createElement('canvas'), { width: 120, height: 60 }),
    g = copy.getContext('2d', { willReadFrequently: true }),
    began = performance.now();
  let before = '', frames = 0, moved = 0;
  const look = (now) => {
    g.fillStyle = '#fff';
    g.fillRect(0, 0, 120, 60);
    g.drawImage(canvas, 0, 0, 120, 60);
    const seen = g.getImageData(0, 0, 120, 60).data.join();
    frames += 1;
    moved += seen !== before;
    before = seen;
    self.counted = [frames, moved, (now - began) / 1000];
    if (now - began < 3000) requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}"""


def test_what_the_experimenter_does_reaches_the_page(served, browser):
    page = driving(browser.new_context(), served.links["P01"])
    served.act("restart", page=1)
    until(page, "document.querySelector('main > button')?.textContent === 'Start'")
    rows = on_disk(served.plan)
    go_on(page, "drive")
    until(page, "self.study.rows > 5")
    assert on_disk(served.plan) == rows  # the first attempt stays as it was
    served.act("note", text=ATTACK)
    experimenter = opened(browser.new_context(), served.server.experimenter)
    until(experimenter, "document.body.innerText.includes('<script>')")
    assert experimenter.evaluate("window.fired === undefined && document.images.length === 0")
    served.act("end")
    until(page, "document.querySelector('h1')?.textContent === 'Thank you'")
    assert page.faults == []


def test_a_study_in_german_and_a_participant_who_joins_once_and_declines(make_plan, browser):
    plan = make_plan(language="de")
    with StudyServer(plan, enrol=True) as server:
        page = opened(browser.new_context(), server.overview()["join"])
        page.dblclick("button")
        next_page(page)
        assert page.evaluate("document.documentElement.lang") == "de"
        assert page.inner_text("form button") == "Weiter"
        questions = []
        page.on("dialog", lambda dialog: (questions.append(dialog.message), dialog.accept()))
        page.click("text=Ich nehme nicht teil")
        until(page, "document.querySelector('h1')?.textContent.includes('beendet')")
        assert "Möchten Sie nicht teilnehmen?" in questions[0]
        assert page.locator("#withdraw button").count() == 0
        assert page.faults == []
        driver = driving(browser.new_context(), server.links()["P02"])
        assert driver.inner_text(".tl-drive .mode") == "VON HAND"
        driver.on("dialog", lambda dialog: dialog.accept())
        driver.click("text=Teilnahme beenden")
        until(driver, "document.querySelector('h1')?.textContent.includes('beendet')")
    people = tl.read_live_study(plan.folder).participants
    assert people["withdrawn"].tolist() == [True, True, False]
    assert people["completion"].astype(bool).tolist() == [True, False, False]


def test_a_full_disk_is_said_on_both_pages_and_loses_nothing(served, browser, full_disk):
    experimenter = opened(browser.new_context(), served.server.experimenter)
    page = driving(browser.new_context(), served.links["P01"])
    with full_disk():
        until(page, "!trouble.hidden && trouble.textContent.includes('cannot save')")
        until(experimenter, "trouble.textContent.includes('No space left on device')")
        made = page.evaluate("self.study.run.state().made")
    until(page, "trouble.hidden")
    until(experimenter, "trouble.hidden")
    assert wait_for_commands(served.plan, made + 5) >= made + 5
    assert page.faults == []


def test_a_page_whose_commands_cannot_be_stops(served, browser, monkeypatch):
    page = driving(browser.new_context(), served.links["P01"])
    asked = []

    def refuse(task, config, command):
        asked.append(command)
        raise ValueError("mode cannot be 7")

    monkeypatch.setattr(LiveTask, "check", refuse)
    until(page, "document.querySelector('main').textContent.includes('mode cannot be 7')")
    before = len(asked)
    time.sleep(1.0)
    assert len(asked) == before, "it is not sent again"
    assert page.faults == []


def test_pages_fit_a_phone(served, browser):
    context = browser.new_context(viewport={"width": 390, "height": 844})
    missing = []
    context.on("response", lambda answer: missing.append(answer.url) if answer.status > 399 else 0)
    own = served.server.participant("P01")
    for name in ("nasa_tlx", "trust"):
        advance(own, name)
        page = opened(context, served.links["P01"])
        next_page(page)
        rows = page.evaluate(
            "[...document.querySelectorAll('.points')].map((points) => new Set("
            "[...points.querySelectorAll('input')].map((input) => input.offsetTop)).size)"
        )
        assert set(rows) == {1}, "a scale stays on one line"
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert missing == []


def test_the_pages_can_be_used_by_keyboard_and_screen_reader(served, browser):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page = opened(browser.new_context(bypass_csp=True), served.links["P01"])
    participant = served.server.participant("P01")
    for name in ("consent", "training", "nasa_tlx", "satisfaction", "debriefing"):
        advance(participant, name)
        page.reload()
        next_page(page)
        found = axe.run(page, options={"rules": {"landmark-one-main": {"enabled": True}}})
        violations = found.response["violations"]
        serious = [one["id"] for one in violations if one["impact"] in ("serious", "critical")]
        assert serious == [], (name, serious)
