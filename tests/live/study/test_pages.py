"""
Pages from TOML: their order, their words, and which answers are taken. Oracles: the printed scales,
and lists written out.
"""

import re
import tomllib
from dataclasses import asdict

import pytest

from tests.cases import refused
from tests.live.cases import written
from trustlab.live.study.pages import (
    LANGUAGES,
    AnswerError,
    StudyPage,
    read_pages,
    read_words,
    steps_of,
)

OWN = """
[consent]
title = "Einverständnis {number}"

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
    {name = "attention", text = "Mark 3 here.", expected = 3},
    {name = "hand", kind = "choice", text = "Hand", choices = ["left", "right"]},
    {name = "why", kind = "text", text = "Why?", required = true},
]

[more]
after = "consent"
title = "More"
text = "More about you."

[third]
after = "hours"
title = "Even more"
text = "Still about you."

[ease]
after = "drive"
title = "Ease"
text = "How easy was it?"
items = [{name = "ease", text = "It was easy in {number} of {count}.", low = 0, high = 10}]

[last]
before = "debriefing"
title = "At the end"
text = "Anything else?"
items = [{name = "words", kind = "text", text = "Say it."}]

[pause]
skip = true
"""


@pytest.fixture
def read(tmp_path):
    """A function that reads pages changed by a text."""
    return lambda text: read_pages(files=[written(tmp_path, text)])


@pytest.fixture
def own(read):
    """The pages of a lab's own file, by name."""
    return {page.name: page for page in read(OWN)}


def test_the_course_of_a_participant():
    steps = steps_of(read_pages(), ["C2", "C1"])
    drive = ["drive", "nasa_tlx", "trust", "satisfaction"]
    course = ["consent", "training", "identification", *drive, "pause", *drive, "debriefing"]
    assert [step.page.name for step in steps] == course
    drives = [(s.condition, s.position, s.page.title) for s in steps if s.page.name == "drive"]
    assert drives == [("C2", 1, "Drive 1 of 2"), ("C1", 2, "Drive 2 of 2")]
    assert [s.name for s in steps[2:4]] == ["02-identification", "03-drive"]


def test_own_pages_stand_where_they_say_and_those_of_a_drive_have_its_number(own):
    drive = ["drive", "ease", "nasa_tlx", "trust", "satisfaction"]
    before = ["consent", "hours", "more", "third", "training", "identification"]
    steps = steps_of(own.values(), ["C2", "C1"])
    names = [step.page.name for step in steps]
    assert names == [*before, *drive, *drive, "last", "debriefing"]
    assert steps[0].page.title == "Einverständnis {number}"
    assert steps[7].page.items[0].text == "It was easy in 1 of 2."
    assert own["consent"].items[0].kind == "check"  # what a file does not give stays
    scales = [(i.name, i.low, i.high, i.reversed) for i in own["hours"].scales]
    assert scales == [("games", 1, 5, False), ("late", 1, 5, True)]
    assert [StudyPage.read(asdict(one)) for one in own.values()] == [*own.values()]


def test_answers_that_a_page_takes(own):
    hours = {"games": 5, "late": 1, "attention": 5, "hand": "left", "why": "so"}
    assert own["hours"].check(hours) == hours
    for words in ("<script>", "", "x" * 1000):
        assert own["last"].check({"words": words}) == {"words": words}
    wrong = [("hours", hours | {"games": games}) for games in (0, 6, 2.5, True, "3", None, [3])]
    wrong += [("hours", hours | change) for change in ({"hand": "both"}, {"hand": {}}, {"more": 1})]
    wrong += [("hours", answers) for answers in (None, [], {"games": 3})]
    wrong += [("last", {"words": words}) for words in ("x" * 1001, 3, "a\0b", "half \ud800")]
    for name, answers in [*wrong, ("consent", {"consent": False})]:
        with pytest.raises(AnswerError):
            own[name].check(answers)
    with pytest.raises(AnswerError, match=r"^Why\?$"):  # its text, in the study's language
        own["hours"].check(hours | {"why": " "})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[a", "is no TOML file"),
        ("[mine]\nafter='drive'\ntitel='x'", "pages.toml, .* got 'titel'; did you mean 'title'"),
        (
            "[trust]\nitems=[{name='a', text='t', choices=['x']}]",
            "a key must be one of .*'reversed', 'expected', got 'choices'",
        ),
        ("[drive]\nitems=[{name='a', text='t'}]", "must be one of .*, got 'items'"),
        ("[debriefing]\ngroup='told'", "a key of .*pages.toml, .* must be one of .*, got 'group'"),
        ("[identification]\nsection='each'", "section must be one of 'start'"),
        ("[mine]\nafter='drive'\nskip=true\ntitle='x'\ntext='y'", "got 'skip'"),
        ("[pause]\nskip='false'", r"skip of .*pages.toml, \[pause\] must be True or False"),
        (
            "[trust]\nitems=[{name='trust', text='t'}]",
            "its items must be deceptive, .* score others as likert",
        ),
        ("[training]\nkind='end'", "got 'kind'"),
        ("[trust]\ntext=3", r"pages.toml, \[trust\]: text must be of type str, got 3"),
        ("[mine]\nafter=['trust']\ntitle='x'\ntext='y'", "must say before or after which page"),
        ("[trust]\nitems=[{name='a', text='t', reversed=1}]", "reversed must be of type bool"),
        ("[trust]\nitems=[{name='a', text='t', expected=9}]", "expected = 9 is no answer to it"),
        ("[trust]\nitems=[{name='a', text='t'}, {name='a', text='u'}]", "the same name"),
    ],
)
def test_faults_of_a_file_are_named(read, text, said):
    with refused(said):
        read(text)


def shape(page):
    """All of a page but its words."""
    items = [(i.name, i.kind, i.low, i.high, i.step, i.reversed) for i in page.items]
    return page.name, page.kind, page.section, page.scored, items


def test_every_language_has_the_same_messages_pages_and_items():
    english, shapes = read_words("en"), [*map(shape, read_pages("en"))]
    assert set(LANGUAGES) == {"de", "en"}
    for language in LANGUAGES:
        words = read_words(language)
        assert list(words) == list(english)
        for name, text in words.items():
            holes, known = (set(re.findall(r"\{(\w+)\}", said)) for said in (text, english[name]))
            assert holes == known, name
        assert [*map(shape, read_pages(language))] == shapes


def test_items_that_are_reversed_otherwise_than_printed_are_refused(read):
    words = tomllib.loads(LANGUAGES["en"].read_text())["nasa_tlx"]["items"]
    items = [f"{{name = '{item['name']}', text = 'x', reversed = true}}" for item in words]
    with refused("with reversed left out; score others as likert"):
        read(f"[nasa_tlx]\nitems = [{', '.join(items)}]")
