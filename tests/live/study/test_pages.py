"""
Pages from TOML: their order, their words, and which answers are taken. Oracles: the printed scales,
and lists written out.
"""

import re
import tomllib
from dataclasses import asdict

import pytest

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
    course = ["consent", "training", "identification", *drive, "pause", *drive, "debriefing"]
    assert names(read_pages()) == course
    steps = steps_of(read_pages(), ["C2", "C1"])
    drives = [(s.condition, s.position, s.page.title) for s in steps if s.page.name == "drive"]
    assert drives == [("C2", 1, "Drive 1 of 2"), ("C1", 2, "Drive 2 of 2")]
    assert [s.name for s in steps[2:4]] == ["02-identification", "03-drive"]


def test_own_pages_stand_where_they_say(toml):
    pages = read_pages(files=toml(OWN))
    drive = ["drive", "ease", "nasa_tlx", "trust", "satisfaction"]
    before = ["consent", "hours", "training", "identification"]
    assert names(pages) == [*before, *drive, *drive, "last", "debriefing"]
    by_name = {page.name: page for page in pages}
    assert by_name["consent"].title == "Einverständnis"
    assert by_name["consent"].items[0].kind == "check"  # what a file does not give stays
    assert [(i.name, i.low, i.high, i.reversed) for i in by_name["hours"].items[:2]] == [
        ("games", 1, 5, False),
        ("late", 1, 5, True),
    ]
    assert [StudyPage.read(asdict(one)) for one in pages] == pages


def test_answers_that_a_page_takes(toml):
    pages = {page.name: page for page in read_pages(files=toml(OWN))}
    hours = {"games": 5, "late": 1, "hand": "left"}
    assert pages["hours"].check(hours) == hours
    for words in ("<script>", "", "x" * 1000):
        assert pages["last"].check({"words": words}) == {"words": words}
    wrong = [("hours", hours | {"games": games}) for games in (0, 6, 2.5, True, "3", None, [3])]
    wrong += [("hours", hours | change) for change in ({"hand": "both"}, {"hand": {}}, {"more": 1})]
    wrong += [("hours", answers) for answers in (None, [], {"games": 3})]
    wrong += [("last", {"words": words}) for words in ("x" * 1001, 3, "a\0b")]
    for name, answers in [*wrong, ("consent", {"consent": False})]:
        with pytest.raises(AnswerError):
            pages[name].check(answers)


def test_a_page_that_belongs_to_no_drive_has_no_number(toml):
    text = '[consent]\ntitle = "Part {number}"\n\n[drive]\ntitle = "{number}"\n'
    text += 'text = "{number} of {count}"\n[trust]\nscored = "likert"\n'
    text += 'items = [{name = "a", text = "Did drive {number} please you?"}]'
    pages = {step.page.name: step.page for step in steps_of(read_pages(files=toml(text)), ["C1"])}
    assert (pages["consent"].title, pages["drive"].title) == ("Part {number}", "1")
    assert pages["drive"].text == "1 of 1"
    assert pages["trust"].items[0].text == "Did drive 1 please you?"


def test_pages_behind_the_same_one_keep_their_order(toml):
    one = "title = 'x'\ntext = 'y'\n"
    text = f"[a]\nafter='consent'\n{one}[b]\nafter='consent'\n{one}[c]\nafter='a'\n{one}"
    names = [page.name for page in read_pages(files=toml(text))]
    assert names[:5] == ["consent", "a", "b", "c", "training"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[a", "is no TOML file"),
        ("[mine]\nafter='drive'\ntitel='x'", "pages.toml, .* got 'titel'; did you mean 'title'"),
        ("[pause]\nskip=true\ntitel='x'", "pages.toml, .*'low'.*'skip', got 'titel'"),
        (
            "[trust]\nitems=[{name='a', text='t', kind='choice', chioces=[]}]",
            "a key must be one of .*'choices'.* got 'chioces'",
        ),
        (
            "[trust]\nitems=[{name='a', text='t', choices=['x']}]",
            "a key must be one of .*'reversed', 'expected', got 'choices'",
        ),
        (
            "[drive]\nitems=[{name='a', text='t'}]",
            "a key of .*pages.toml, .* must be one of .*, got 'items'",
        ),
        ("[debriefing]\ngroup='told'", "a key of .*pages.toml, .* must be one of .*, got 'group'"),
        ("[identification]\nsection='each'", "section must be one of 'start'"),
        ("[mine]\nafter='drive'\nskip=true\ntitle='x'\ntext='y'", "got 'skip'"),
        ("[pause]\nskip='false'", r"skip of .*pages.toml, \[pause\] must be True or False"),
        (
            "[trust]\nitems=[{name='trust', text='t'}]",
            "its items must be deceptive, .* score others as likert",
        ),
        ("[trust]\ngroup=1", r"pages.toml, \[trust\]: group must be of type str"),
        ("[trust]\nsection='sometimes'", "section must be one of 'start', 'each', 'end'"),
        ("[drive]\nsection='start'", "section must be one of 'each'"),
        ("[training]\nkind='end'", "got 'kind'"),
        ("[trust]\ntext=3", r"pages.toml, \[trust\]: text must be of type str, got 3"),
        ("[mine]\nafter=['trust']\ntitle='x'\ntext='y'", "must say before or after which page"),
        ("[trust]\nitems=3", "items must be of type list, got 3"),
        ("[trust]\nitems=[{name='a', text='t', reversed=1}]", "reversed must be of type bool"),
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


def shape(page):
    """All of a page but its words."""
    items = [(i.name, i.kind, i.low, i.high, i.step, i.reversed) for i in page.items]
    return page.name, page.kind, page.section, page.scored, items


HOLE = re.compile(r"\{(\w+)\}")


def test_every_language_has_the_same_messages_pages_and_items():
    english = read_words("en")
    pages = read_pages("en")
    assert set(LANGUAGES) == {"de", "en"}
    for language in LANGUAGES:
        words = read_words(language)
        assert list(words) == list(english)
        for name, text in words.items():
            assert set(HOLE.findall(text)) == set(HOLE.findall(english[name])), name
        for page, model in zip(read_pages(language), pages, strict=True):
            assert shape(page) == shape(model)
    with pytest.raises(ValueError, match="language must be one of 'de', 'en'"):
        read_pages("fr")


def test_items_that_are_reversed_otherwise_than_printed_are_refused(toml):
    words = tomllib.loads(LANGUAGES["en"].read_text())["nasa_tlx"]["items"]
    items = [f"{{name = '{item['name']}', text = 'x', reversed = true}}" for item in words]
    with pytest.raises(ValueError, match="with reversed left out; score others as likert"):
        read_pages(files=toml(f"[nasa_tlx]\nitems = [{', '.join(items)}]"))


CHECKED = """
[about]
after = "consent"
title = "You"
text = "About you."
items = [
    {name = "why", kind = "text", text = "Why?", required = true},
    {name = "attention", text = "Mark 3 here.", expected = 3},
    {name = "a", text = "A"},
]
"""


def test_words_may_be_required_and_attention_checked(toml):
    page = next(page for page in read_pages(files=toml(CHECKED)) if page.name == "about")
    answers = {"why": "so", "attention": 5, "a": 1}
    assert page.check(answers) == answers
    with pytest.raises(AnswerError, match=r"^Why\?$"):  # its text, in the study's language
        page.check(answers | {"why": " "})
    with pytest.raises(ValueError, match=r"item 'attention': expected = 9 is no answer to it"):
        read_pages(files=toml(CHECKED.replace("expected = 3", "expected = 9")))
