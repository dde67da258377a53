"""
Team and teleoperation in Chromium, with real pointer, keys and wheel, against a server.

Oracle: `TeamLoop` and `TeleoperationLoop` stepped here, without the task's code, by the commands
that were logged.
"""

import time

import numpy as np
import pytest

import trustlab as tl
from tests.live.study.test_browser import go_on, next_page, opened, until
from tests.live.test_widget import Notebook
from trustlab.live.attempt import Attempt
from trustlab.live.study.server import StudyServer
from trustlab.live.tasks.team import LeadingSettings
from trustlab.trust.dynamics import MODELS

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


def through(page, act):
    """Go through a whole study; `act` is told of every drive that was begun."""
    after = -1
    while True:
        after, kind = next_page(page, after)
        if kind == "end":
            return
        go_on(page, kind, "fine")
        if kind == "drive":
            act(page)


def pointing(page, x, y):
    """Move the mouse to a place of the hand's square, (−1, −1) to (1, 1)."""
    box = page.locator("canvas.pad").bounding_box()
    half = 0.35 * box["width"]
    middle = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(middle[0] + half * x, middle[1] - half * y)


@pytest.fixture(scope="module")
def led(tmp_path_factory, browser):
    """A study of a team, one participant led by real events to its end."""
    folder = tmp_path_factory.mktemp("led") / "study"
    plan = tl.LiveStudy(
        folder, ["by_hand", "suggested"], 2, task="team", duration=7.0, training=2.0, goals=2
    )
    said = []

    def act(page):
        until(page, "self.study.driving?.now?.t > 0.2")
        pointing(page, 0.9, 0.5)
        page.keyboard.press("2")
        until(page, "self.study.driving?.now?.t > 0.5")
        said.append(page.inner_text("#drive") if page.query_selector("#drive") else "")
        if len(said) == 2:
            number = page.evaluate("self.study.page")
            page.reload()  # computed in the page, the run goes on from the rows on the disk
            next_page(page, number - 1)
            go_on(page, "drive")
            until(page, "self.study.driving?.now?.t > 0.4")
            pointing(page, 0.9, 0.5)
            page.keyboard.press("2")
        until(page, "!document.querySelector('#drive')")

    with StudyServer(plan) as server:
        page = opened(browser.new_context(), server.links()["P01"])
        through(page, act)
        assert page.faults == []
    return tl.read_live_study(folder), said


def test_a_person_leads_a_team_in_the_browser(led):
    study, said = led
    measures = study.measures
    assert measures["verified"].all()
    assert len(measures) == 2
    assert "Goal 1 of 2" in said[0]
    assert "Robot" in said[0]
    assert "%" in said[0]
    for session in study.sessions():
        assert session["leader_choice"].max() == 2
        assert (session["pointer_x"][-20:] == session["pointer_x"][-1]).all()
        assert session["pointer_x"][-1] == pytest.approx(0.9, abs=0.02)
        assert session["pointer_y"][-1] == pytest.approx(0.5, abs=0.02)
    by_hand = next(s for s in study.sessions() if s.metadata.condition == "by_hand")
    assert by_hand["leader"][-1] == 2, "from the end of the dwell time on"
    assert measures["period_median"].to_numpy() == pytest.approx([0.05, 0.05], abs=0.02)


def test_a_server_that_begins_anew_goes_on_with_the_run(tmp_path, browser):
    plan = tl.LiveStudy(
        tmp_path / "s",
        ["most_trusted", "by_hand"],
        2,
        task="team",
        duration=4.0,
        training=4.0,
        trust=MODELS["asymmetric"](),  # a model in Python: the server computes the run
    )
    with StudyServer(plan) as server:
        port, links = server.port, server.links()
        page = opened(browser.new_context(), links["P01"])
        number, kind = next_page(page)
        go_on(page, kind)
        next_page(page, number)
        go_on(page, "drive")
        until(page, "self.study.driving?.now?.t > 0.5")
        pointing(page, -0.5, 0.5)
    made = page.evaluate("self.study.rows")
    time.sleep(0.5)
    assert page.evaluate("self.study.rows") <= made + 11, "the task stands still"
    with StudyServer(plan, port=port):
        until(page, "self.study.page > 1", 90)
        assert page.faults == []
    records = tl.read_live_study(plan.folder).records["P01"]
    assert next(e for e in records.events if e["kind"] == "page" and e["page"] == 1)["verified"]


def test_a_team_in_a_notebook_outlives_its_kernel(tmp_path, browser):
    settings = LeadingSettings(duration=4.0)
    live = tl.LiveTeam("by_hand", settings, "me", 4, tmp_path)
    config = dict(live.attempt.config)
    live.attempt.close()
    one = Notebook(browser.new_context(), tmp_path, config)
    one.page.click("text=Start driving")
    one.page.wait_for_function("document.querySelector('.tl-track')?.driving?.now?.t > 0.5")
    pointing(one.page, 0.5, -0.5)
    one.page.keyboard.press("3")
    one.until(lambda: len(one.attempt.rows) > 20, 20)
    one.away = True
    one.page.wait_for_timeout(300)
    kept = len(one.attempt.rows)
    one.attempt.close()
    one.attempt = Attempt(tmp_path, "me", config)  # a kernel that began anew knows the file alone
    assert len(one.attempt.rows) == kept
    one.away = False
    one.page.reload()
    one.page.click("text=Start driving")
    one.until(lambda: one.attempt.finished, 40)
    assert one.attempt.verified
    assert len(one.attempt.rows) == 80
    assert max(row[2] for row in one.attempt.rows) == 3
    assert one.faults == []


def test_a_person_flies_and_allocates_by_the_wheel(tmp_path, browser):
    plan = tl.LiveStudy(
        tmp_path / "s", ["MMI", "TMIG"], 2, task="teleoperation", duration=3.0, training=1.0
    )

    flown = []

    def act(page):
        until(page, "self.study.driving?.now?.t > 0.5")
        flown.append(page.evaluate("self.study.page"))
        if len(flown) == 2:
            page.reload()  # computed in the page, the flight goes on from the rows on the disk
            next_page(page)
            go_on(page, "drive")
            until(page, "self.study.driving?.now?.t > 0.4")
        pointing(page, 0.3, -0.4)
        page.mouse.wheel(0, 100)
        page.mouse.wheel(0, 100)
        until(page, "!document.querySelector('#drive')")

    with StudyServer(plan) as server:
        page = opened(browser.new_context(), server.links()["P02"])
        through(page, act)
        assert page.faults == []
    study = tl.read_live_study(plan.folder)
    assert study.measures["verified"].all()
    assert len(study.measures) == 2
    runs = {session.metadata.condition: session for session in study.sessions()}
    assert runs["MMI"]["alpha_choice"][-1] == pytest.approx(0.9)
    assert set(runs["TMIG"]["alpha_choice"]) == {-1.0}
    assert np.isfinite(runs["TMIG"].data.to_numpy()).all()
