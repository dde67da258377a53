"""
Pages from TOML: their order, their words, and which answers are taken. Oracles: the printed scales,
and lists written out.
"""

import re

import pytest

from trustlab.live.study.pages import AnswerError, StudyPage, as_json, read_pages, steps_of
from trustlab.studies.questionnaires.likert import SATISFACTION_ITEMS, TRUST_CHECKLIST
from trustlab.studies.questionnaires.nasa_tlx import TLX_SCALES

OWN = """
[consent]
title = "Einverständnis"

[hours]
after = "consent"
title = "You"
text = "About you."
scored = "likert"
low = 1
high = 5
items = [
    {name = "games", text = "I often play driving games."},
    {name = "late", text = "I react late.", reversed = true},
    {name = "hand", kind = "choice", text = "Hand", choices = ["left", "right"]},
]

[ease]
after = "drive"
title = "Ease"
text = "How easy was it?"
items = [{name = "ease", text = "It was easy.", low = 0, high = 10}]

[last]
before = "debriefing"
title = "At the end"
text = "Anything else?"
items = [{name = "words", kind = "text", text = "Say it."}]

[pause]
skip = true
"""


@pytest.fixture
def toml(tmp_path):
    def write(text):
        path = tmp_path / "pages.toml"
        path.write_text(text, encoding="utf-8")
        return [path]

    return write


def names(pages, order=("C2", "C1")):
    return [step.page.name for step in steps_of(pages, order)]


def test_the_course_of_a_participant():
    drive = ["drive", "nasa_tlx", "trust", "satisfaction"]
    assert names(read_pages()) == [
        "consent",
        "training",
        "identification",
        *drive,
        "pause",
        *drive,
        "debriefing",
    ]
    steps = steps_of(read_pages(), ["C2", "C1"])
    assert [(s.condition, s.position) for s in steps if s.page.name == "drive"] == [
        ("C2", 1),
        ("C1", 2),
    ]
    assert [s.page.title for s in steps if s.page.name == "drive"] == [
        "Drive 1 of 2",
        "Drive 2 of 2",
    ]
    assert [s.name for s in steps[:4]] == [
        "00-consent",
        "01-training",
        "02-identification",
        "03-drive",
    ]


def test_items_are_those_that_the_questionnaires_score():
    pages = {page.name: page for page in read_pages()}
    scale = {
        name: [item.name for item in page.items if item.kind == "scale"]
        for name, page in pages.items()
    }
    assert scale["nasa_tlx"] == list(TLX_SCALES)
    assert scale["trust"] == list(TRUST_CHECKLIST.items)
    assert scale["satisfaction"] == list(SATISFACTION_ITEMS)
    ends = {
        name: {(i.low, i.high, i.step) for i in page.items if i.kind == "scale"}
        for name, page in pages.items()
    }
    assert (ends["nasa_tlx"], ends["trust"], ends["satisfaction"]) == (
        {(0, 100, 5)},
        {(1, 7, 1)},
        {(1, 7, 1)},
    )


def test_own_pages_stand_where_they_say(toml):
    pages = read_pages(files=toml(OWN))
    drive = ["drive", "ease", "nasa_tlx", "trust", "satisfaction"]
    course = [
        "consent",
        "hours",
        "training",
        "identification",
        *drive,
        *drive,
        "last",
        "debriefing",
    ]
    assert names(pages) == course
    by_name = {page.name: page for page in pages}
    assert by_name["consent"].title == "Einverständnis"
    assert by_name["consent"].items[0].kind == "check"  # what a file does not give stays
    assert [(i.name, i.low, i.high, i.reversed) for i in by_name["hours"].items[:2]] == [
        ("games", 1, 5, False),
        ("late", 1, 5, True),
    ]
    assert [StudyPage.read(one) for one in as_json(pages)] == pages


def test_no_page_names_a_condition():
    words = str(as_json(read_pages()))
    assert re.findall(r"\bC[1-5]\b|TSC|threshold|Algorithm", words) == []


def test_answers_that_a_page_takes(toml):
    pages = {page.name: page for page in read_pages(files=toml(OWN))}
    hours = {"games": 5, "late": 1, "hand": "left"}
    assert pages["hours"].check(hours) == hours
    assert pages["last"].check({"words": "<script>"}) == {"words": "<script>"}
    assert pages["last"].check({"words": ""}) == {"words": ""}
    assert pages["last"].check({"words": "x" * 1000})
    refused = [
        {"games": 0},
        {"games": 6},
        {"games": 2.5},
        {"games": True},
        {"games": "3"},
        {"games": None},
        {"hand": "both"},
        {"more": 1},
        {"games": [3]},
        {"hand": {}},
    ]
    for change in refused:
        with pytest.raises(AnswerError):
            pages["hours"].check(hours | change)
    for answers in (None, [], "x", {}, {"games": 3}):
        with pytest.raises(AnswerError):
            pages["hours"].check(answers)
    for words in ("x" * 1001, 3, None, "a\0b"):
        with pytest.raises(AnswerError):
            pages["last"].check({"words": words})
    with pytest.raises(AnswerError):
        pages["consent"].check({"consent": False})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[a", "is no TOML file"),
        ("a = 1", "'a' must be a table"),
        ("[Big]\ntitle='x'", "must be a table, .*small letters"),
        (
            "[mine]\ntitle='x'\ntext='y'",
            "must say before or after which page it stands: one of consent, training",
        ),
        ("[mine]\nafter='nowhere'\ntitle='x'\ntext='y'", "must say before or after"),
        ("[mine]\nafter='debriefing'\ntitle='x'\ntext='y'", "must say before or after"),
        ("[mine]\nafter='drive'\ntext='y'", "needs a title"),
        (
            "[mine]\nafter='drive'\ntitle='x'\ntext='y'\nkind='drive'",
            "a page of your own is a form",
        ),
        ("[mine]\nafter='drive'\ntitle='x'\ntext='y'\nscored='tlx'", "scored must be one of"),
        ("[mine]\nafter='drive'\ntitle='x'\ntext='y'\nscored='likert'", "on one scale, got none"),
        ("[mine]\nafter='drive'\ntitel='x'", "has no 'titel'; did you mean 'title'"),
        ("[trust]\nafter='drive'", "is there already, and keeps its place"),
        ("[drive]\nskip=true", "cannot be left out"),
        (
            "[mine]\nafter='drive'\ntitle='x'\ntext='y'\nitems=[{name='a'}]",
            "an item needs a name and a text",
        ),
        (
            "[mine]\nafter='drive'\ntitle='x'\ntext='y'\nitems=[{name='A b', text='t'}]",
            "a name has small letters",
        ),
        (
            "[mine]\nafter='drive'\ntitle='x'\ntext='y'\nitems=[{name='a', text='t', step=4}]",
            "step 4 does not lead",
        ),
        (
            "[mine]\nafter='drive'\ntitle='x'\ntext='y'\nitems=[{name='a', text='t', low=0.5}]",
            "low must be a whole number",
        ),
        (
            "[mine]\nafter='drive'\ntitle='x'\ntext='y'\nitems=[{name='a', text='t', "
            "kind='slider'}]",
            "kind must be one of",
        ),
        (
            "[mine]\nafter='drive'\ntitle='x'\ntext='y'\nitems=[{name='a', text='t', "
            "kind='choice'}]",
            "two different choices",
        ),
        (
            "[mine]\nafter='drive'\ntitle='x'\ntext='y'\nitems=[{name='a', text='t'}, "
            "{name='a', text='u'}]",
            "the same name",
        ),
    ],
)
def test_faults_of_a_file_are_named(toml, text, said):
    with pytest.raises(ValueError, match=said):
        read_pages(files=toml(text))


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ValueError, match=r"no\.toml cannot be read: No such file"):
        read_pages(files=[tmp_path / "no.toml"])
