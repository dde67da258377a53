"""
Team and teleoperation in Chromium, with real pointer, keys and wheel, against a server.

Oracle: the replay of the commands that were logged, and where the mouse was.
"""

import pytest

import trustlab as tl
from tests.live.study.test_browser import go_on, next_page, opened, until
from trustlab.live.study.server import StudyServer

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
K = "(self.study.run?.state().have ?? -1)"


@pytest.fixture
def through(browser):
    """A function that goes through a whole study; `act` is told of every drive that was begun."""

    def go(plan, act):
        after = -1
        with StudyServer(plan) as server:
            page = opened(browser.new_context(), server.links()["P01"])
            while True:
                after, kind = next_page(page, after)
                if kind == "end":
                    break
                go_on(page, kind, "fine")
                if kind == "drive":
                    act(page)
            assert page.faults == []
        study = tl.read_live_study(plan.folder)
        assert study.measures["verified"].tolist() == [True, True]
        return study

    return go


def pointing(page, x, y):
    """Move the mouse to a place of the hand's square, (−1, −1) to (1, 1)."""
    box = page.locator("canvas.pad").bounding_box()
    half = 0.35 * box["width"]
    middle = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(middle[0] + half * x, middle[1] - half * y)


def test_a_person_leads_a_team_in_the_browser(tmp_path, through):
    settings = {"duration": 7.0, "training": 2.0, "goals": 2}
    plan = tl.LiveStudy(tmp_path / "s", ["by_hand", "suggested"], 2, task="team", **settings)
    said = []

    def lead(page):
        until(page, f"{K} > 4")
        pointing(page, 0.9, 0.5)
        page.keyboard.press("2")

    def act(page):
        lead(page)
        until(page, f"{K} > 10")
        said.append(page.inner_text("#drive"))
        if len(said) == 2:
            number = page.evaluate("self.study.page")
            page.reload()  # the run goes on behind the last command
            next_page(page, number - 1)
            go_on(page, "drive")
            lead(page)
        until(page, "!document.querySelector('#drive')")

    study = through(plan, act)
    for words in ("Goal 1 of 2", "Robot", "%"):
        assert words in said[0]
    for session in study.sessions():
        assert session["leader_choice"].max() == 2
        last = [session[f"pointer_{axis}"][-1] for axis in "xy"]
        assert last == pytest.approx([0.9, 0.5], abs=0.02)
    by_hand = next(s for s in study.sessions() if s.metadata.condition == "by_hand")
    assert by_hand["leader"][-1] == 2, "from the end of the dwell time on"
    assert study.measures["pauses"].max() >= 1, "the page was loaded again"
    assert study.measures["period_median"].tolist() == pytest.approx([0.05, 0.05], abs=0.02)
