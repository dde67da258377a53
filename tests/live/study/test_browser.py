"""
A whole study in Chromium, and what people and machines do to it: tabs close, networks and servers
go away.

Oracle: the commands that the page says were acknowledged, against the files on the disk. Scripted
hands drive; nobody takes part.
"""

import re
import time
from statistics import median

import pytest

import trustlab as tl
from tests.live.cases import advance, record

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

    def heard(said):
        if "Content Security" in said.text:
            page.faults.append(said.text)

    page.on("pageerror", lambda error: page.faults.append(str(error)))
    page.on("console", heard)
    page.goto(url)
    return page


def until(page, script, seconds=60):
    """Poll: Playwright's own waiting needs eval, which the page's policy forbids."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            if found := page.evaluate(script):
                return found
        except Error as error:  # the page was left for another just now
            if "context was destroyed" not in str(error):
                raise
        time.sleep(0.06)
    raise TimeoutError(f"{script}: {page.evaluate('document.body.innerText')[:300]}")


def says(page, words, where="document.body"):
    until(page, f"{where}.textContent.includes({words!r})")


def rows(page):
    return page.evaluate("self.study.rows")


def drive_on(page, count):
    """Wait until so many more rows are there."""
    until(page, f"self.study.rows > {rows(page) + count}")


def moves(page):
    """Whether what is drawn changes while a few rows are done."""
    drawn = "document.querySelector('canvas').toDataURL()"
    before = page.evaluate(drawn)
    drive_on(page, 8)
    return page.evaluate(drawn) != before


def next_page(page, after=-1):
    """Wait for a page of the study after that one; return its number and kind."""
    until(page, f"(self.study?.page ?? -1) > {after} && !!document.querySelector('h1')")
    return page.evaluate("[self.study.page, self.study.kind]")


def go_on(page, kind="drive", words=""):
    """Answer a form, or start a drive."""
    if kind == "form":
        page.evaluate(FILL, words)
    else:
        page.click("main > button")


def driving(context, url, count=8):
    """Go to the training drive, and drive so many rows."""
    page = opened(context, url)
    number, kind = next_page(page)
    if kind == "form":
        go_on(page, kind)
        number, kind = next_page(page, number)
    assert (number, kind) == (1, "drive")
    go_on(page)
    drive_on(page, count)
    return page


def reload(page, number):
    """Load a drive again, and go on with it."""
    page.reload()
    next_page(page, number - 1)
    go_on(page)


def on_disk(plan):
    return len(record(plan).commands)


def come_to_disk(plan, at_least):
    """Wait until so many commands are on the disk."""
    end = time.monotonic() + 20
    while on_disk(plan) < at_least:
        assert time.monotonic() < end
        time.sleep(0.05)


# the whole study
# --------------------------------------------------------------------------------------------------


def test_three_people_at_once_from_consent_to_report(make_plan, serving, browser):
    course = tl.testbeds.Course(((0, 0), (4, 0), (4, 4), (0, 4)), radius=1.0)
    brief = {"training": 5.0, "identification": [(1, 5.0), (0, 5.0)], "course": course}
    plan = make_plan(rehearsal=True, **brief)
    with serving(plan) as served:
        phone = browser.new_context(viewport={"width": 400, "height": 700})
        experimenter = opened(phone, served.server.experimenter)
        people = {code: opened(browser, url) for code, url in served.links.items()}
        where = dict.fromkeys(people, -1)
        end = time.monotonic() + 240
        while people:
            assert time.monotonic() < end, where
            for code, page in list(people.items()):
                number, kind = page.evaluate("[self.study?.page ?? -1, self.study?.kind]")
                if number == where[code] or not page.evaluate("!!document.querySelector('h1')"):
                    continue
                where[code] = number
                shown = page.inner_text("#where")
                if kind == "end":
                    assert (shown, page.faults) == (code, [])
                    del people[code]
                else:
                    assert shown == f"{code} · page {number + 1} of {len(plan.steps(code)) - 1}"
                    go_on(page, kind, f"{code}: {ATTACK}")
            time.sleep(0.15)
        until(experimenter, "document.body.innerText.split('Thank you').length === 4")
        assert " of " not in experimenter.inner_text("tbody tr td:nth-child(3)")
        assert experimenter.query_selector_all("text=/^End$/") == [], "who is done cannot be ended"
        served.act("end")
        assert experimenter.evaluate("document.body.scrollWidth <= innerWidth")
        assert experimenter.faults == []
    study = served.study
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
    page.on("request", lambda asked: fetched.append(asked.url))
    page.goto(path.as_uri())
    assert page.evaluate("window.fired === undefined && !document.querySelector('img[src=x]')")
    assert page.evaluate("document.body.scrollWidth <= innerWidth"), "tables scroll within"
    assert {url for url in fetched if not url.startswith("data:")} == {path.as_uri()}
    words = page.evaluate("document.body.innerText")
    headings = ["Who took part", "Measures by condition", "Questionnaires", "Order effects"]
    said = ["scripted hands, no person took part", "0 deleted", "What people wrote", ATTACK]
    assert [each for each in headings + said if each not in words] == []
    assert "Out[" not in words
    assert re.search(r"p_r by condition: \[.*\(N = 3\)", words), words[1000:2500]
    assert str(study.plan.folder.parent) not in path.read_text()


def lead(page):
    """Point to a place of the hand's square, choose robot 2, and return what the page says."""
    until(page, "self.study.rows > 4")
    box = page.locator("canvas.pad").bounding_box()
    half = 0.35 * box["width"]
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x + 0.9 * half, y - 0.5 * half)
    page.keyboard.press("2")
    until(page, "self.study.rows > 10")
    return page.inner_text("#drive")


def test_a_person_leads_a_team(make_plan, serving, browser):
    """Oracle: where the mouse was, and the replay of the commands that were logged."""
    settings = {"duration": 7.0, "training": 2.0, "goals": 2, "task": "team"}
    said = []
    with serving(make_plan(["by_hand", "suggested"], 2, short=settings)) as served:
        page = opened(browser, served.link)
        number, kind = next_page(page)
        while kind != "end":
            go_on(page, kind, "fine")
            if kind == "drive":
                said.append(lead(page))
                if len(said) == 2:
                    assert moves(page)
                    reload(page, number)  # behind the last command
                    lead(page)
                until(page, "!document.querySelector('#drive')")
            number, kind = next_page(page, number)
        assert page.faults == []
    assert "Goal 1 of 2" in said[0]
    measures = served.study.measures
    assert measures["verified"].tolist() == [True, True]
    assert measures["pauses"].max() >= 1, "the page was loaded again"
    assert measures["period_median"].tolist() == pytest.approx([0.05, 0.05], abs=0.02)
    for session in served.study.sessions():
        assert session["leader_choice"].max() == 2
        last = session.data[["pointer_x", "pointer_y"]].iloc[-1]
        assert last.tolist() == pytest.approx([0.9, 0.5], abs=0.02)
        if session.metadata.condition == "by_hand":
            assert session["leader"][-1] == 2, "from the end of the dwell time on"


# what goes wrong
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def long_training(make_plan, serving):
    with serving(make_plan(training=60.0)) as study:
        yield study


def test_a_reload_and_a_closed_tab_lose_nothing_and_switch_no_mode(long_training, browser):
    """Oracle: the commands on the disk, before and behind."""
    plan, url, context = long_training.plan, long_training.link, browser.new_context()
    page = driving(context, url)
    page.keyboard.press("Space")
    says(page, "AUTONOMOUS")
    assert moves(page)
    reload(page, 1)
    before = on_disk(plan)
    come_to_disk(plan, before + 10)
    assert {command[2] for command in record(plan).commands[before:]} == {0}
    made = rows(page)
    page.close()
    assert on_disk(plan) >= made
    again = driving(context, url)  # the same browser
    other = opened(browser, url)  # another one: the same link, the same page
    assert next_page(other) == [1, "drive"]
    go_on(other)
    says(again, "another window")
    already = on_disk(plan)
    until(other, f"self.study.rows > {already + 5}")
    assert sum("begun again" in pause["why"] for pause in record(plan).pauses) >= 2
    assert page.faults == again.faults == []


def test_a_reload_takes_back_no_share(make_plan, serving, browser):
    """Oracle: four turns of the wheel, each a twentieth."""
    plan = make_plan(["M", "MMI"], 2, short={"task": "teleoperation"})
    code = next(code for code, order in plan.orders.items() if order[0] == "MMI")
    with serving(plan) as served:
        number = advance(served.server.participant(code), "drive")
        page = opened(browser, served.links[code])
        next_page(page)
        go_on(page)
        drive_on(page, 4)
        page.mouse.move(300, 300)
        for _ in range(4):
            page.mouse.wheel(0, 100)
        says(page, "80 %")
        assert moves(page)
        reload(page, number)
        drive_on(page, 4)
        log = record(plan, code, f"{number:02d}-drive")
        assert log.commands[0][2] == 1.0
        assert log.commands[-1][2] == pytest.approx(0.8)
        assert median(log.delays) > 0.099, "nobody sees what the camera does not show yet"
        assert page.faults == []


@pytest.mark.parametrize("seconds", [2.0, pytest.param(5.0, marks=pytest.mark.long)])
def test_without_a_network_or_a_disk_a_drive_stands_still_says_so_and_goes_on(
    long_training, browser, full_disk, seconds
):
    plan, context = long_training.plan, browser.new_context()
    experimenter = opened(browser, long_training.server.experimenter)
    page = driving(context, long_training.link)
    context.set_offline(True)
    time.sleep(seconds)
    state = page.evaluate("self.study.run.state()")
    assert state["still"]
    assert state["made"] - state["have"] <= 6, "half a second goes out unanswered"
    assert page.evaluate("!document.querySelector('.away').hidden")
    before = on_disk(plan)
    context.set_offline(False)
    come_to_disk(plan, before + 10)
    assert page.evaluate("trouble.hidden")
    assert max(pause["seconds"] for pause in record(plan).pauses) >= seconds - 0.6
    with full_disk():
        says(page, "cannot save", "trouble")
        says(experimenter, "No space left on device", "trouble")
    for each in (page, experimenter):
        until(each, "trouble.hidden")
    come_to_disk(plan, page.evaluate("self.study.run.state().made"))
    assert page.faults == []


def test_what_the_experimenter_does_reaches_the_page(served, browser):
    page = driving(browser, served.link)
    served.act("restart", page=1)
    until(page, "document.querySelector('main > button')?.textContent === 'Start'")
    before = on_disk(served.plan)
    go_on(page)
    drive_on(page, 5)
    assert on_disk(served.plan) == before  # the first attempt stays as it was
    served.act("note", text=ATTACK)
    experimenter = opened(browser, served.server.experimenter)
    says(experimenter, "<script>")
    assert experimenter.evaluate("window.fired === undefined && document.images.length === 0")
    served.act("end")
    until(page, "document.querySelector('h1')?.textContent === 'Thank you'")
    assert page.faults == []


def test_a_study_in_german_and_a_participant_who_joins_once_and_declines(
    make_plan, serving, browser
):
    over = "document.querySelector('h1')?.textContent.includes('beendet')"
    with serving(make_plan(language="de"), enrol=True) as served:
        page = opened(browser, served.overview()["join"])
        page.dblclick("button")
        next_page(page)
        assert page.evaluate("document.documentElement.lang") == "de"
        assert page.inner_text("form button") == "Weiter"
        questions = []
        page.on("dialog", lambda dialog: (questions.append(dialog.message), dialog.accept()))
        page.click("text=Ich nehme nicht teil")
        until(page, over)
        assert "Möchten Sie nicht teilnehmen?" in questions[0]
        assert page.locator("#withdraw button").count() == 0
        assert page.faults == []
        driver = driving(browser, served.links["P02"])
        assert driver.inner_text(".tl-drive .mode") == "VON HAND"
        driver.on("dialog", lambda dialog: dialog.accept())
        driver.click("text=Teilnahme beenden")
        until(driver, over)
    people = served.study.participants
    assert people["withdrawn"].tolist() == [True, True, False]
    assert people["completion"].astype(bool).tolist() == [True, False, False]


def test_pages_fit_a_phone_and_can_be_used_by_keyboard_and_screen_reader(served, browser):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    phone = browser.new_context(bypass_csp=True, viewport={"width": 390, "height": 844})
    missing, scales = [], []
    phone.on("response", lambda answer: missing.append(answer.url) if answer.status > 399 else 0)
    page = opened(phone, served.link)
    participant = served.server.participant("P01")
    for name in ("consent", "training", "nasa_tlx", "trust", "satisfaction", "debriefing"):
        advance(participant, name)
        page.reload()
        next_page(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        scales += page.evaluate(
            "[...document.querySelectorAll('.points')].map((points) => new Set("
            "[...points.querySelectorAll('input')].map((input) => input.offsetTop)).size)"
        )
        found = axe.run(page, options={"rules": {"landmark-one-main": {"enabled": True}}})
        violations = found.response["violations"]
        serious = [one["id"] for one in violations if one["impact"] in ("serious", "critical")]
        assert serious == [], (name, serious)
    assert set(scales) == {1}, "a scale stays on one line"
    assert missing == []
