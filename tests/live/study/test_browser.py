"""
A whole study in Chromium, and what people and machines do to it: tabs close, networks and servers
go away, browsers die.

Oracle: the rows that the page says it has made, against the files on the disk. Scripted hands
drive; nobody takes part.
"""

import json
import re
import signal
import subprocess
import time
from contextlib import suppress

import pytest

import trustlab as tl
from tests.live.conftest import OPTIONS
from tests.live.study.test_crashes import Server, plant_torn_line
from trustlab.live.study import participation
from trustlab.live.study.server import StudyServer
from trustlab.live.study.store import read_tokens

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
        "!!document.querySelector('h2')",
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


def on_disk(folder, code="P01", name="01-training.0"):
    whole, _, _ = (folder / code / f"{name}.jsonl").read_text().rpartition("\n")
    numbers = [json.loads(line)[1][0] for line in whole.split("\n")[1:]]
    assert numbers == list(range(len(numbers)))
    return len(numbers)


def wait_for_rows(folder, at_least, seconds=20):
    end = time.monotonic() + seconds
    while on_disk(folder) < at_least and time.monotonic() < end:
        time.sleep(0.05)
    return on_disk(folder)


# the whole study
# --------------------------------------------------------------------------------------------------


def test_three_people_at_once_from_consent_to_report(make_plan, browser):
    plan = make_plan(rehearsal=True)
    with StudyServer(plan) as server:
        experimenter = opened(browser.new_context(), server.experimenter)
        people = {code: opened(browser.new_context(), url) for code, url in server.links().items()}
        where = dict.fromkeys(people, -1)
        end = time.monotonic() + 240
        while people and time.monotonic() < end:
            for code, page in list(people.items()):
                number, kind = page.evaluate("[self.study?.page ?? -1, self.study?.kind]")
                if number > where[code] and page.evaluate("!!document.querySelector('h2')"):
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
        assert experimenter.faults == []
    study = tl.read_live_study(plan.folder)
    measures = study.measures
    assert study.participants["complete"].all()
    assert measures["verified"].all()
    assert measures["synthetic"].all()
    assert study.exclusions().empty
    orders = (
        measures.sort_values(["participant", "position"])
        .groupby("participant")["condition"]
        .agg(list)
    )
    assert orders.to_dict() == plan.orders
    assert (
        measures[["tlx_raw", "trust_mean", "satisfaction_mean", "p_r", "p_h"]].notna().all().all()
    )
    answers = study.answers()
    assert len(answers) == 3 * (1 + 2 * (6 + 12 + 4))
    assert answers["text"].str.contains("<script>").sum() == 6
    check_report(study, browser)


def check_report(study, browser):
    """The report is complete in itself, and shows what people wrote as words."""
    path = study.report()
    page = browser.new_page()
    fetched = []
    page.route("**/*", lambda route: (fetched.append(route.request.url), route.continue_()))
    page.goto(path.as_uri())
    words = page.evaluate("document.body.innerText")
    assert ATTACK in words
    assert page.evaluate("window.fired === undefined && !document.querySelector('img[src=x]')")
    assert [url for url in fetched if not url.startswith(("data:", path.as_uri()))] == []
    assert "scripted hands, no person took part" in words
    assert "0 deleted" in words
    for heading in (
        "Who took part",
        "Measures by condition",
        "Questionnaires",
        "Order effects",
        "What people wrote",
    ):
        assert heading in words
    assert re.search(r"p_r by condition.*3 subjects × 2 conditions", words), words[1000:2500]
    assert str(study.plan.folder.parent) not in path.read_text()


@pytest.mark.long
def test_a_drive_of_sixty_seconds_in_real_time_is_verified(make_plan, browser):
    plan = make_plan(training=60.0)
    with StudyServer(plan) as server:
        page = driving(browser.new_context(), server.links()["P01"])
        page.keyboard.down("ArrowUp")
        until(page, "self.study.page === 2", 120)
    assert on_disk(plan.folder) == 600
    events = plan.participant("P01").events
    assert [event["verified"] for event in events if event.get("name") == "training"] == [True]
    commands = tl.read_session(plan.folder / "P01" / "01-training.0.csv")["v_command"]
    assert commands.max() > 0.0
    assert (
        commands == commands.max()
    ).sum() > 500  # the key was down, but for the ramp and where the page slept


# what goes wrong
# --------------------------------------------------------------------------------------------------


def test_a_closed_tab_loses_nothing_and_another_browser_goes_on(served, browser):
    folder, url = served.plan.folder, served.links["P01"]
    context = browser.new_context()
    page = driving(context, url)
    made = page.evaluate("self.study.rows")
    page.close()
    assert wait_for_rows(folder, made) >= made
    again = driving(context, url, rows=made + 5)  # the same browser
    assert again.faults == []
    other = opened(browser.new_context(), url)  # another one: the same link, the same page
    assert next_page(other) == [1, "drive"]
    go_on(other, "drive")
    until(again, "document.body.innerText.includes('another window')")
    already = on_disk(folder)
    until(other, f"self.study.rows > {already + 5}")
    assert wait_for_rows(folder, already + 5) > already
    starts = [
        e["rows"]
        for e in served.server.participation("P01").participant.events
        if e["kind"] == "begin"
    ]
    assert starts[0] == 0
    assert starts[1] >= made


def network_off(served, browser, seconds):
    context = browser.new_context()
    page = driving(context, served.links["P01"])
    context.set_offline(True)
    before = on_disk(served.plan.folder)
    time.sleep(seconds)
    made = page.evaluate("self.study.rows")
    assert made - before >= 8 * seconds  # the drive goes on meanwhile
    assert on_disk(served.plan.folder) <= before + 10
    context.set_offline(False)
    assert wait_for_rows(served.plan.folder, made) >= made


def test_two_seconds_without_a_network_lose_nothing(served, browser):
    network_off(served, browser, 2.0)


@pytest.mark.long
def test_five_seconds_without_a_network_lose_nothing(served, browser):
    network_off(served, browser, 5.0)


def server_killed(make_plan, browser, seconds):
    import random

    plan = make_plan(training=60.0)
    server = Server(plan.folder)
    server.start()
    page = driving(
        browser.new_context(), f"http://127.0.0.1:{server.port}/p/{read_tokens(plan.folder)['P01']}"
    )
    server.kill()
    plant_torn_line(plan.folder / "P01" / "01-training.0.jsonl", random.Random(1))
    time.sleep(seconds)
    made = page.evaluate("self.study.rows")
    server.start()
    try:
        assert wait_for_rows(plan.folder, made) >= made
        assert page.faults == []
    finally:
        server.kill()


def test_a_server_killed_and_back_loses_nothing(make_plan, browser):
    server_killed(make_plan, browser, 1.0)


@pytest.mark.long
def test_a_server_killed_for_fifteen_seconds_loses_nothing(make_plan, browser):
    server_killed(make_plan, browser, 15.0)


def browser_killed(make_plan, chromium, tmp_path, seconds):
    """
    The server is away, and then the browser is killed with −9: return how many rows are gone for
    good.
    """
    plan = make_plan(training=60.0)
    server, profile = Server(plan.folder), tmp_path / "profile"
    url = f"http://127.0.0.1:{server.port}/p/{read_tokens(plan.folder)['P01']}"
    server.start()
    context = chromium.launch_persistent_context(profile, **OPTIONS)
    page = driving(context, url, rows=20)
    server.kill()
    time.sleep(seconds)
    made = page.evaluate("self.study.rows")
    mine = subprocess.run(
        ["pgrep", "-f", f"user-data-dir={profile}"], capture_output=True, text=True
    ).stdout.split()
    assert mine
    subprocess.run(["kill", f"-{signal.SIGKILL.value}", *mine])
    with suppress(Error):  # closing may find that the browser is gone
        context.close()
    for lock in profile.glob("Singleton*"):
        lock.unlink()
    server.start()
    try:
        again = chromium.launch_persistent_context(profile, **OPTIONS)
        next_page(opened(again, url))
        had = on_disk(plan.folder)
        again.close()
    finally:
        server.kill()
    return made - had


def test_a_browser_killed_after_an_outage_loses_at_most_ten_rows(make_plan, chromium, tmp_path):
    assert browser_killed(make_plan, chromium, tmp_path, 1.5) <= 10


@pytest.mark.long
def test_a_browser_killed_after_eight_seconds_of_outage_loses_at_most_ten_rows(
    make_plan, chromium, tmp_path
):
    assert browser_killed(make_plan, chromium, tmp_path, 8.0) <= 10


def test_what_the_experimenter_does_reaches_the_page(served, browser, client):
    page = driving(browser.new_context(), served.links["P01"])
    act = f"{served.server.experimenter}/act"
    client(act, {"participant": "P01", "action": "restart", "page": 1})
    until(page, "document.querySelector('main > button')?.textContent === 'Start'")
    rows = on_disk(served.plan.folder)
    go_on(page, "drive")
    until(page, "self.study.rows > 5")
    assert wait_for_rows(served.plan.folder, rows) == rows  # the first attempt stays as it was
    client(act, {"participant": "P01", "action": "note", "text": ATTACK})
    experimenter = opened(browser.new_context(), served.server.experimenter)
    until(experimenter, "document.body.innerText.includes('<script>')")
    assert experimenter.evaluate("window.fired === undefined && document.images.length === 0")
    client(act, {"participant": "P01", "action": "end"})
    until(page, "document.querySelector('h2')?.textContent === 'Thank you'")
    assert page.faults == []


def test_a_study_in_german_and_a_participant_who_declines(make_plan, browser):
    plan = make_plan(language="de")
    with StudyServer(plan) as server:
        page = opened(browser.new_context(), server.links()["P01"])
        next_page(page)
        assert page.evaluate("document.documentElement.lang") == "de"
        assert "dauert etwa" in page.inner_text("#duration")
        assert page.inner_text("form button") == "Weiter"
        questions = []
        page.on("dialog", lambda dialog: (questions.append(dialog.message), dialog.accept()))
        page.click("text=Ich nehme nicht teil")
        until(page, "document.querySelector('h2')?.textContent.includes('beendet')")
        assert "Möchten Sie nicht teilnehmen?" in questions[0]
        assert page.locator("#withdraw button").count() == 0
        assert page.faults == []
        driver = driving(browser.new_context(), server.links()["P02"])
        assert driver.inner_text(".tl-drive .mode") == "VON HAND"
        driver.on("dialog", lambda dialog: dialog.accept())
        driver.click("text=Teilnahme beenden")
        until(driver, "document.querySelector('h2')?.textContent.includes('beendet')")
    assert tl.read_live_study(plan.folder).participants["withdrawn"].tolist() == [True, True, False]


def full(*_):
    raise OSError(28, "No space left on device")


def test_a_full_disk_is_said_on_both_pages_and_loses_nothing(served, browser, monkeypatch):
    experimenter = opened(browser.new_context(), served.server.experimenter)
    page = driving(browser.new_context(), served.links["P01"])
    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", full)
        until(page, "!trouble.hidden && trouble.textContent.includes('cannot save')")
        until(experimenter, "trouble.textContent.includes('No space left on device')")
        made = page.evaluate("self.study.rows")
    until(page, "trouble.hidden")
    until(experimenter, "trouble.hidden")
    assert wait_for_rows(served.plan.folder, made) >= made
    assert page.faults == []


def test_a_mistake_of_the_server_is_said_on_both_pages(served, browser, monkeypatch):
    experimenter = opened(browser.new_context(), served.server.experimenter)
    page = driving(browser.new_context(), served.links["P01"])
    with monkeypatch.context() as patched:
        patched.setattr(participation.Participation, "rows", lambda *_: 1 / 0)
        until(page, "trouble.textContent.includes('(error 500)')")
        until(experimenter, "trouble.textContent.includes('could not be answered')")
    until(page, "trouble.hidden")
    with monkeypatch.context() as patched:
        patched.setattr(served.server, "overview", lambda: 1 / 0)
        until(experimenter, "trouble.textContent.includes('error 500')")


def test_a_page_whose_rows_cannot_be_stops(served, browser, monkeypatch):
    page = driving(browser.new_context(), served.links["P01"])
    asked = []

    def refuse(config, row):
        asked.append(row)
        raise ValueError("row 9: mode cannot be 7")

    monkeypatch.setattr(participation, "check_row", refuse)
    until(page, "document.querySelector('main').textContent.includes('mode cannot be 7')")
    before = len(asked)
    time.sleep(1.5)
    assert len(asked) == before, "it is not sent again"
    assert page.faults == []


def test_pages_fit_a_phone(served, browser):
    context = browser.new_context(viewport={"width": 390, "height": 844})
    missing = []
    context.on("response", lambda answer: missing.append(answer.url) if answer.status > 399 else 0)
    own = served.server.participation("P01")
    for name in ("nasa_tlx", "trust"):
        step = next(step for step in own.steps if step.page.name == name)
        for index in range(step.index):
            if index not in own.progress.done:
                own.participant.add("page", page=index, name="x", answers={}, attempt=0)
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
    participation = served.server.participation("P01")
    for name in ("consent", "training", "nasa_tlx", "satisfaction", "debriefing"):
        step = next(step for step in participation.steps if step.page.name == name)
        for index in range(step.index):
            if index not in participation.progress.done:
                participation.participant.add("page", page=index, name="x", answers={}, attempt=0)
        page.reload()
        next_page(page)
        found = axe.run(page, options={"rules": {"landmark-one-main": {"enabled": True}}})
        serious = [
            one["id"]
            for one in found.response["violations"]
            if one["impact"] in ("serious", "critical")
        ]
        assert serious == [], (name, serious)
