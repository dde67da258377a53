"""
From the plan to the report: groups, enrolment; where a participant is.

Oracles: counting; R's design of a mixed analysis as `repeated_measures` is tested for; what
happened, written out, and the order in which it may not matter.
"""

from collections import Counter

import pytest
from hypothesis import given, strategies as st

import trustlab as tl
from trustlab.live.study.participant import Participant, progress_of

# --- features -------------------------------------------------------------------------------------


PAGES = """
[secret]
after = "consent"
title = "A secret"
text = "The robot lies."
group = "told"

[identification]
skip = true
"""


@pytest.fixture
def pages(tmp_path):
    path = tmp_path / "pages.toml"
    path.write_text(PAGES)
    return path


def names(plan, code):
    return [step.page.name for step in plan.steps(code)]


def test_groups_fill_squares_of_their_own_and_have_pages_of_their_own(make_plan, pages):
    options = {"participants": {"told": 4, "untold": 4}, "pages": pages, "whole_squares": True}
    plan = make_plan(**options)
    assert list(plan.orders) == [f"P0{i}" for i in range(1, 9)]
    assert Counter(plan.groups.values()) == {"told": 4, "untold": 4}
    for group in ("told", "untold"):
        codes = [code for code, name in plan.groups.items() if name == group]
        assert Counter(plan.orders[code][0] for code in codes) == {"C1": 2, "C3": 2}
        assert {"secret" in names(plan, code) for code in codes} == {group == "told"}
    same = make_plan(**options, name="again")
    assert same.groups == plan.groups
    column = tl.read_live_study(plan.folder).participants.set_index("participant")["group"]
    assert column.to_dict() == plan.groups
    with pytest.raises(ValueError, match="group of the page secret must be one of '', 'a', 'b'"):
        make_plan(**options | {"participants": {"a": 4, "b": 4}}, name="other")


def test_groups_are_the_factor_between_subjects(make_team_plan):
    plan = make_team_plan({"told": ["A", "B"], "untold": ["C", "D"]})
    assert plan.groups == {"A": "told", "B": "told", "C": "untold", "D": "untold"}
    plan.rehearse(0)
    study = tl.read_live_study(plan.folder)
    effects = study.analysis("force").table()
    factors = {"between": "group", "order": ["by_hand", "most_trusted"]}
    oracle = tl.repeated_measures(study.measures, "force", "condition", "participant", **factors)
    assert effects.equals(oracle.table())
    assert effects.to_string().count("group") > 1
    with pytest.raises(ValueError, match="no column 'forces'"):
        study.analysis("forces")


def test_who_joins_takes_the_next_free_place_and_gets_a_code(make_plan, serving, client):
    plan = make_plan(participants=2)
    with serving(plan, enrol=True) as served:
        join = served.overview()["join"]
        for _ in range(5):  # a program that looks at links
            assert client(join).status == 200
        places = [client(join, {}) for _ in range(3)]
        assert [place.status for place in places] == [200, 200, 409]
        links = [served.base + place.json["link"] for place in places[:2]]
        assert links == list(served.links.values())
        cookie = places[0].headers["Set-Cookie"]
        assert {"HttpOnly", "SameSite=Strict", "Path=/join"} <= set(cookie.split("; "))
        again = client(join, Cookie=cookie.partition(";")[0])
        assert (again.status, again.headers["Location"]) == (302, places[0].json["link"])
        other_tab = client(join, {}, Cookie=cookie.partition(";")[0])
        assert other_tab.json == places[0].json
        assert client(join.replace("/join/", "/p/")).status == 404
        assert served.withdraw().status == 200
        shown = served.state().json
    codes = tl.read_live_study(plan.folder).participants["completion"]
    assert shown["completion"] == codes[0] != codes[1]
    with serving(plan) as served:
        assert served.overview()["join"] == ""
        assert client(served.base + "/join/" + join.rpartition("/")[2]).status == 404


def test_a_study_fixes_a_least_delay_and_marks_who_saw_later(make_team_plan):
    """Pictures are as late as the study says in the first drive, later by .15 s in the next."""
    plan = make_team_plan(duration=1.0, least_delay=0.3)
    plan.rehearse(0)
    who = Participant(plan, "P01")
    steps = [step.index for step in who.steps if step.page.name == "drive"]
    for page, late in zip(reversed(steps), (9, 6), strict=True):
        who.experimenter_restart({"page": page})
        about = {"page": page, "window": "a"}
        assert who.drive(about | {"begin": True})["config"]["late"] == 0.3
        for k in range(20):
            who.drive(about | {"k": k, "commands": [[0.0, 0.0, 0]], "seen": max(k - late, 0)})
    who.close()
    measures = tl.read_live_study(plan.folder).measures
    own = measures[measures["participant"] == "P01"].sort_values("position")
    assert own["delay"].tolist() == pytest.approx([0.3, 0.45])
    assert own["seen_late"].tolist() == [False, True]


# --- a page is a fold over events -----------------------------------------------------------------


COUNT = 8


def done(page, **facts):
    return {"kind": "page", "page": page, **facts}


def test_a_restarted_drive_comes_back_and_what_follows_stays_done():
    events = [done(0), done(1), done(2), {"kind": "restart", "page": 1}]
    assert progress_of(events).page(COUNT) == 1
    assert progress_of(events).attempt(1) == 1
    assert progress_of([*events, done(1)]).page(COUNT) == 3
    assert progress_of([*events, {"kind": "restart", "page": 1}]).attempt(1) == 2


def test_what_was_said_of_a_drive_that_is_driven_again_is_asked_again():
    events = [done(1, name="drive", position=1), done(2, name="trust", position=1)]
    events += [done(3, name="drive", position=2), {"kind": "restart", "page": 1}]
    events.insert(0, done(0, name="own", position=1))  # it came before the drive
    assert set(progress_of(events).done) == {0, 3}


@given(st.lists(st.integers(0, COUNT - 2), max_size=12), st.randoms())
def test_the_same_pages_done_lead_to_the_same_page_in_any_order_and_number(pages, random):
    events = [done(page) for page in pages]
    shuffled = [*events, *events]
    random.shuffle(shuffled)
    assert progress_of(shuffled).page(COUNT) == progress_of(events).page(COUNT)
    assert progress_of(events).page(COUNT) == min(set(range(COUNT)) - set(pages))


# --- the guide's ten minutes ----------------------------------------------------------------------
