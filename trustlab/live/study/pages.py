"""
The pages of a study: their words and items from TOML files, their order for a participant, and
which answers are accepted.
"""

import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from trustlab.models.checks import one_of, shown

FOLDER = Path(__file__).parents[1] / "words"
LANGUAGES = {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}
"""The files of words that come with the package."""

LONGEST_ANSWER = 1000
"""Characters that a participant may write in one answer."""

SECTIONS = ("start", "each", "end")
FIXED = {"drive": ("each",), "debriefing": ("end",)}
"""Where these two pages must be."""

ITEMS = ("scale", "choice", "text", "check")
SCORED = ("nasa_tlx", "trust", "satisfaction", "likert")
SCALE = ("low", "high", "step", "left", "right")
"""What a page may give for all its items."""

OWN = ("title", "text", "section", "scored", "items", "group")
KEYS = (*OWN, *SCALE, "before", "after", "skip")
"""What the table of a page may hold; its kind is no lab's to choose."""

LISTS = ("items", "choices")

NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


class AnswerError(ValueError):
    """An answer that the page does not allow; its status in HTTP."""

    status = 400


def storable(text: str) -> bool:
    """Whether files can hold a text: no zero, and no half of a pair of code units."""
    return "\0" not in text and text.encode(errors="replace").decode() == text


@dataclass(frozen=True)
class Item:
    """
    One question: `low` to `high` in steps for a scale, `choices` for a choice, at most 1,000
    characters for a text, which may be left empty unless it is `required`.

    An item with an `expected` answer checks attention.
    """

    name: str
    text: str
    kind: str = "scale"
    low: int = 1
    high: int = 7
    step: int = 1
    left: str = ""
    right: str = ""
    choices: tuple[str, ...] = ()
    reversed: bool = False
    required: bool = False
    expected: Any = None

    def check(self, answer: Any) -> None:
        """Refuse an answer that this item does not allow."""
        if self.kind == "scale":
            fits = type(answer) is int and answer in range(self.low, self.high + 1, self.step)
        elif self.kind == "check":
            fits = answer is True
        else:
            fits = isinstance(answer, str) and len(answer) <= LONGEST_ANSWER and storable(answer)
            fits = fits and (self.kind == "text" or answer in self.choices)
            fits = fits and not (self.required and not answer.strip())
        if not fits:
            raise AnswerError(f"{self.name}: the answer must be {self.allowed}")

    @property
    def allowed(self) -> str:
        """What may be answered, in words."""
        if self.kind == "scale":
            return f"{self.low} to {self.high} in steps of {self.step}"
        if self.kind == "check":
            return "given"
        if self.kind == "choice":
            return f"one of {', '.join(self.choices)}"
        least = int(self.required)
        return f"{least} to {LONGEST_ANSWER} characters that files can hold"


@dataclass(frozen=True)
class StudyPage:
    """
    One page: a form with any number of items, a drive, or the end.

    `section` says whether it comes once at the start, after each drive, or once at the end;
    `scored` how its items are scored; `group` who sees it, all if empty.
    """

    name: str
    title: str
    text: str
    section: str
    kind: str = "form"
    scored: str = ""
    items: tuple[Item, ...] = ()
    group: str = ""

    @property
    def scales(self) -> list[Item]:
        """The items that are scales."""
        return [item for item in self.items if item.kind == "scale"]

    def check(self, answers: Any) -> dict:
        """
        Return the answers, one to each item and none besides, in the items' order; or raise
        `AnswerError`.
        """
        if not isinstance(answers, dict) or set(answers) - {item.name for item in self.items}:
            raise AnswerError("the answers must be names of items with values")
        for item in self.items:
            item.check(answers.get(item.name))
        return {item.name: answers[item.name] for item in self.items}

    @classmethod
    def read(cls, content: dict) -> "StudyPage":
        """Return a page from what `asdict` made of it; older plans hold more."""
        items = tuple(
            Item(**item | {"choices": tuple(item["choices"])}) for item in content["items"]
        )
        parts = {name: content[name] for name in cls.__annotations__}
        return cls(**parts | {"items": items})


@dataclass(frozen=True)
class Step:
    """
    A page at its place in a participant's way through the study: of which condition and at which
    position, for those of a drive.
    """

    page: StudyPage
    index: int
    condition: str | None = None
    position: int | None = None

    @property
    def name(self) -> str:
        """The name of its files: the number and the page, never the condition."""
        return f"{self.index:02d}-{self.page.name}"


def steps_of(pages: Iterable[StudyPage], order: Iterable[str], group: str = "") -> list[Step]:
    """
    Return a participant's way through the study: the start, what belongs to each condition of their
    order, and the end; pages of another group are left out.
    """
    own, order = [page for page in pages if page.group in ("", group)], list(order)
    places = [("each", condition, number) for number, condition in enumerate(order, 1)]
    steps: list[Step] = []
    for section, condition, position in (("start", None, None), *places, ("end", None, None)):
        for page in own:
            if page.section != section or (page.name == "pause" and position == len(order)):
                continue
            title = page.title
            if position is not None:
                title = title.replace("{number}", str(position))
                title = title.replace("{count}", str(len(order)))
            steps.append(Step(replace(page, title=title), len(steps), condition, position))
    return steps


# from files
# --------------------------------------------------------------------------------------------------


def task_pages(task: str, language: str) -> list[Path]:
    """Return the files that change a language's pages for a task; none for the ground robot."""
    path = FOLDER / task / f"{language}.toml"
    return [path] if path.exists() else []


def read_words(language: str = "en") -> dict[str, str]:
    """Return the messages of a language."""
    return _content(LANGUAGES[one_of("language", language, LANGUAGES)])["words"]


def read_pages(language: str = "en", files: Iterable[Path] = ()) -> list[StudyPage]:
    """
    Return the pages of a study: those of a language, as the files change them, add to them and
    leave some out.
    """
    tables = _content(LANGUAGES[one_of("language", language, LANGUAGES)])
    del tables["words"]
    places = {name: f"[{name}]" for name in tables}
    for path in files:
        for name, table in _content(path).items():
            where = places[name] = f"{path}, [{name}]"
            if not isinstance(table, dict) or not NAME.fullmatch(name):
                raise ValueError(f"{where} must be a table, [name], in small letters, digits and _")
            for key in table:
                one_of(f"a key of {where}", key, KEYS)
            tables = _changed(tables, name, table, where)
    return [_page(places[name], name, table) for name, table in tables.items()]


def _content(path: Path) -> dict:
    """Return what a TOML file holds."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"the pages in {path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ValueError(f"{path} is no TOML file in UTF-8: {error}") from None


def _changed(tables: dict[str, dict], name: str, table: dict, where: str) -> dict[str, dict]:
    """Return pages of which a file's table changes one, leaves one out, or is a new one."""
    place = {side: table.pop(side) for side in ("before", "after") if side in table}
    skip = table.pop("skip", False)
    if name in tables:
        if place:
            raise ValueError(
                f"{where} is there already, and keeps its place; leave out before and after"
            )
        if not skip:
            return tables | {name: tables[name] | table}
        if name in FIXED:
            raise ValueError(f"{where} cannot be left out of a study")
        return {key: page for key, page in tables.items() if key != name}
    follows, anchor = "after" in place, next(iter(place.values()), None)
    at_end = follows and anchor == "debriefing"
    if len(place) != 1 or anchor not in tables or "section" in table or at_end:
        raise ValueError(
            f"{where} must say before or after which page it stands: one of {', '.join(tables)}"
        )
    order = list(tables)
    order.insert(order.index(anchor) + follows, name)
    tables = {**tables, name: {**table, "section": tables[anchor]["section"]}}
    return {key: tables[key] for key in order}


def _check(where: str, kind: type, table: dict) -> None:
    """Refuse what is no field of a page or an item, and values of other types."""
    types = kind.__annotations__ | {key: list for key in LISTS if key in kind.__annotations__}
    for key, value in table.items():
        wanted = types[one_of(f"a key of {where}", key, types)]
        if wanted is not Any and type(value) is not wanted:
            raise ValueError(
                f"{where}: {key} must be of type {wanted.__name__}, got {shown(value)}"
            )


def _page(where: str, name: str, table: dict) -> StudyPage:
    """Return a page from its table in TOML files."""
    common = {key: table[key] for key in SCALE if key in table}
    own = {"title": "", "text": "", "items": []} | table | {"name": name}
    own = {key: value for key, value in own.items() if key not in SCALE}
    _check(where, StudyPage, own)
    items = tuple(_item(where, item, common) for item in own["items"])
    text = re.sub(r"(?<!\n)\n(?!\n)", " ", own["text"].strip())
    page = StudyPage(**own | {"items": items, "text": text})
    if not page.title.strip() or not text:
        raise ValueError(f"{where} needs a title and a text")
    one_of(f"{where}: scored", page.scored, ("", *SCORED))
    one_of(f"{where}: section", page.section, FIXED.get(name, SECTIONS))
    names = [item.name for item in page.items]
    if len(set(names)) < len(names):
        raise ValueError(f"{where}: two items have the same name: {names}")
    scales = {(item.low, item.high, item.step) for item in page.scales}
    if page.scored and len(scales) != 1:
        raise ValueError(
            f"{where}: a scored page has items on one scale, got {sorted(scales) or 'none'}"
        )
    return page


def _item(where: str, table: Any, common: dict) -> Item:
    """Return an item from its table; what its page gives holds where it gives nothing itself."""
    if not isinstance(table, dict) or not {"name", "text"} <= set(table):
        raise ValueError(f"{where}: an item needs a name and a text, got {shown(table)}")
    where = f"{where}, item {table['name']!r}"
    own = {"choices": []} | common | table
    _check(where, Item, own)
    choices = tuple(own["choices"])
    item = Item(**own | {"choices": choices})
    if not NAME.fullmatch(item.name):
        raise ValueError(
            f"{where}: a name has small letters, digits and _, at most 40, and begins with a letter"
        )
    one_of(f"{where}: kind", item.kind, ITEMS)
    if not all(isinstance(choice, str) for choice in choices):
        raise ValueError(f"{where}: choices must be words, got {shown(choices)}")
    if item.kind == "choice" and len(set(choices)) < max(2, len(choices)):
        raise ValueError(
            f"{where}: a choice needs two different choices or more, got {list(choices)}"
        )
    steps, rest = divmod(item.high - item.low, max(item.step, 1))
    if item.kind == "scale" and (item.step < 1 or rest or not 1 <= steps <= 1000):
        raise ValueError(
            f"{where}: step {item.step} does not lead from low {item.low} to high {item.high}, in "
            "at most 1000 steps"
        )
    if item.expected is not None:
        try:
            item.check(item.expected)
        except AnswerError:
            raise ValueError(
                f"{where}: expected = {shown(item.expected)} is no answer to it"
            ) from None
    return item
