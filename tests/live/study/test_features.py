"""
From the plan to the report: groups, enrolment; where a participant is.

Oracles: counting; R's design of a mixed analysis as `repeated_measures` is tested for; what
happened, written out, and the order in which it may not matter.
"""

from collections import Counter

import pytest
from hypothesis import given, strategies as st

import trustlab as tl
from tests.cases import refused
from tests.live.cases import ask, recorded
from trustlab.live.study.participant import Participant, progress_of

# --- features -------------------------------------------------------------------------------------


PAGES = """
[secret]
after = "consent"
title = "A secret"
text = "The robot lies."
group = "told"
"""


def test_groups_fill_squares_of_their_own_and_have_pages_of_their_own(make_plan):
    options = {"pages": PAGES, "whole_squares": True}
    plan = make_plan(participants={"told": 4, "untold": 4}, **options)
    assert list(plan.orders) == [f"P0{i}" for i in range(1, 9)]
    for group in ("told", "untold"):
        codes = [code for code, name in plan.groups.items() if name == group]
        assert Counter(plan.orders[code][0] for code in codes) == {"C1": 2, "C3": 2}
        for code in codes:
            names = [step.page.name for step in plan.steps(code)]
            assert ("secret" in names) == (group == "told")
    assert make_plan(participants={"told": 4, "untold": 4}, **options).groups == plan.groups
    column = recorded(plan).participants.set_index("participant")["group"]
    assert column.to_dict() == plan.groups
    with refused("group of the page secret must be one of '', 'a', 'b'"):
        make_plan(participants={"a": 4, "b": 4}, **options)


def test_groups_are_the_factor_between_subjects(make_team_plan):
    plan = make_team_plan({"told": ["A", "B"], "untold": ["C", "D"]})
    assert plan.groups == {"A": "told", "B": "told", "C": "untold", "D": "untold"}
    plan.rehearse(0)
    study = recorded(plan)
    effects = study.analysis("force").table()
    factors = {"between": "group", "order": ["by_hand", "most_trusted"]}
    oracle = tl.repeated_measures(study.measures, "force", "condition", "participant", **factors)
    assert effects.equals(oracle.table())
    assert effects.to_string().count("group") > 1


def test_who_joins_takes_the_next_free_place_and_gets_a_code(make_plan, serving):
    with serving(make_plan(), enrol=True) as served:
        join = served.overview()["join"]
        served.state("P01")  # somebody reads the page of this place
        for _ in range(5):  # a program that looks at links
            assert ask(join).status == 200
        places = [ask(join, {}) for _ in range(3)]
        assert [place.status for place in places] == [200, 200, 409]
        links = [served.base + place.json["link"] for place in places[:2]]
        assert links == list(served.links.values())[1:]
        taken = places[0].headers["Set-Cookie"].split("; ")
        assert {"HttpOnly", "SameSite=Strict", "Path=/join"} <= set(taken)
        again, other_tab = (ask(join, body, Cookie=taken[0]) for body in (None, {}))
        assert (again.status, again.headers["Location"]) == (302, places[0].json["link"])
        assert other_tab.json == places[0].json
        assert ask(join.replace("/join/", "/p/")).status == 404
        shown = served.withdraw("P02").json["completion"]
    codes = served.study.participants["completion"]
    assert shown == codes[1] != codes[2]
    with serving(served.plan) as served:
        assert served.overview()["join"] == ""
        assert ask(f"{served.base}/join/{join[-22:]}").status == 404


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
    own = recorded(plan).measures.query("participant == 'P01'").sort_values("position")
    assert own["delay"].tolist() == pytest.approx([0.3, 0.45])
    assert own["seen_late"].tolist() == [False, True]


# --- a page is a fold over events -----------------------------------------------------------------


COUNT = 8
RESTART = {"kind": "restart", "page": 1}


def done(page, **facts):
    return {"kind": "page", "page": page, **facts}


def test_a_restarted_drive_comes_back_and_what_was_said_of_it_is_asked_again():
    training = [done(0), done(1), done(2), RESTART]
    now = progress_of(training)
    assert (now.page(COUNT), now.attempt(1)) == (1, 1)
    assert progress_of([*training, done(1)]).page(COUNT) == 3
    assert progress_of([*training, RESTART]).attempt(1) == 2
    # Page 0 came before the drive, page 3 belongs to the next one.
    said = [done(0, position=1), done(1, name="drive", position=1), done(2, position=1)]
    assert set(progress_of([*said, done(3, position=2), RESTART]).done) == {0, 3}


@given(st.lists(st.integers(0, COUNT - 2), max_size=12), st.randoms())
def test_the_same_pages_done_lead_to_the_same_page_in_any_order_and_number(pages, random):
    events = [done(page) for page in [*pages, *pages]]
    random.shuffle(events)
    assert progress_of(events).page(COUNT) == min(set(range(COUNT)) - set(pages))
