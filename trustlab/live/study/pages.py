"""
The pages of a study: their words and items from TOML files, their order for a participant, and
which answers are accepted.
"""

import base64
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from trustlab.models.checks import did_you_mean, flag, one_of, shown, whole_number

LANGUAGES = {
    path.stem: path for path in sorted((Path(__file__).parents[1] / "words").glob("*.toml"))
}
"""The files of words that come with the package."""

TASK_WORDS = Path(__file__).parents[1] / "words"
WORDS = "words"
"""The table of such a file that holds messages; each of the others is a page."""

PICTURES = {".png": "image/png", ".jpg": "image/jpeg", ".webp": "image/webp"}
LARGEST_PICTURE = 1_000_000
LONGEST_ANSWER = 1000
"""Characters that a participant may write in one answer."""

SECTIONS = ("start", "each", "end")
KINDS = ("form", "drive", "end")
ITEMS = ("scale", "choice", "text", "check")
SCORED = ("nasa_tlx", "trust", "satisfaction", "likert")
HOLE = re.compile(r"\{(\w+)\}")
NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")
FIXED = ("training", "identification", "drive", "debriefing")
"""Pages whose kind the study fixes."""


class AnswerError(ValueError):
    """An answer that the page does not allow."""


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
            raise AnswerError(f"{self.name}: this answer cannot be taken")


@dataclass(frozen=True)
class StudyPage:
    """
    One page: a form with any number of items, a drive, or the end.

    `section` says whether it comes once at the start, after each drive, or once at the end;
    `scored` how its items are scored; `shuffled` whether everybody gets them in an order of their
    own; `group` who sees it, all if empty; `picture` an image as a data URI; `seconds` when a form
    is handed in as it is, 0 for never.
    """

    name: str
    title: str
    text: str
    section: str
    kind: str = "form"
    scored: str = ""
    items: tuple[Item, ...] = ()
    shuffled: bool = False
    group: str = ""
    picture: str = ""
    seconds: int = 0

    def check(self, answers: Any, late: bool = False) -> dict[str, Any]:
        """
        Return the answers, one to each item and none besides, in the items' order; or raise
        `AnswerError`. Where time was over, answers may be missing.
        """
        if not isinstance(answers, dict):
            raise AnswerError("the answers must be names with values")
        if unknown := set(answers) - {item.name for item in self.items}:
            raise AnswerError(f"{shown(sorted(map(str, unknown))[0])} is no item of this page")
        items = self.items
        if late and self.seconds:
            items = tuple(item for item in items if item.name in answers)
        for item in items:
            item.check(answers.get(item.name))
        return {item.name: answers[item.name] for item in items}

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> "StudyPage":
        """Return a page from what `asdict` made of it."""
        items = tuple(
            Item(**{**item, "choices": tuple(item["choices"])}) for item in content["items"]
        )
        return cls(**{**content, "items": items})


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


def _known(where: str, table: Mapping[str, Any], allowed: Iterable[str]) -> None:
    for key in table:
        if key not in allowed:
            raise ValueError(
                f"{where} has no {key!r}{did_you_mean(key, allowed)}; there are: "
                f"{', '.join(allowed)}"
            )


def _item(where: str, table: Any, page: Mapping[str, Any]) -> Item:
    """
    Return an item from its table in a TOML file; what its page gives holds where it gives nothing
    itself.
    """
    allowed = [field.name for field in fields(Item)]
    if not isinstance(table, Mapping) or not {"name", "text"} <= set(table):
        raise ValueError(f"{where}: an item needs a name and a text, got {shown(table)}")
    where = f"{where}, item {table['name']!r}"
    _known(where, table, allowed)
    common = {key: page[key] for key in ("low", "high", "step", "left", "right") if key in page}
    settings = common | dict(table)
    item = Item(**settings | {"choices": tuple(settings.get("choices", ()))})
    if not isinstance(item.name, str) or not NAME.fullmatch(item.name):
        raise ValueError(
            f"{where}: a name has small letters, digits and _, at most 40, and begins with a letter"
        )
    if item.kind not in ITEMS:
        raise ValueError(f"{where}: kind must be one of {', '.join(ITEMS)}, got {shown(item.kind)}")
    if not all(
        isinstance(words, str) for words in (item.text, item.left, item.right, *item.choices)
    ):
        raise ValueError(f"{where}: text, left, right and choices must be words")
    if item.kind == "choice" and len(set(item.choices)) < max(2, len(item.choices)):
        raise ValueError(
            f"{where}: a choice needs two different choices or more, got {list(item.choices)}"
        )
    if item.kind == "scale":
        for key in ("low", "high", "step"):
            whole_number(
                f"{where}: {key}",
                getattr(item, key),
                least=1 if key == "step" else -1000,
                most=1000,
            )
        if item.high <= item.low or (item.high - item.low) % item.step:
            raise ValueError(
                f"{where}: step {item.step} does not lead from low {item.low} to high {item.high}"
            )
    flag(f"{where}: required", item.required)
    if item.expected is not None:
        try:
            item.check(item.expected)
        except AnswerError:
            raise ValueError(
                f"{where}: expected = {shown(item.expected)} is no answer to it"
            ) from None
    return item


PAGE_KEYS = (
    "title",
    "text",
    "kind",
    "section",
    "scored",
    "items",
    "shuffled",
    "group",
    "picture",
    "seconds",
    "low",
    "high",
    "step",
    "left",
    "right",
)
PLACES = ("before", "after", "skip")


def _page(where: str, name: str, table: Mapping[str, Any]) -> StudyPage:
    """Return a page from its table in a TOML file."""
    for key in ("title", "text"):
        if not isinstance(table.get(key), str) or not table[key].strip():
            raise ValueError(f"{where} needs a {key}")
    kind, scored = table.get("kind", "form"), table.get("scored", "")
    if kind not in KINDS or (kind != "form" and name not in FIXED):
        raise ValueError(f"{where}: a page of your own is a form, got kind = {shown(kind)}")
    if scored and scored not in SCORED:
        raise ValueError(f"{where}: scored must be one of {', '.join(SCORED)}, got {shown(scored)}")
    items = tuple(_item(where, item, table) for item in table.get("items", ()))
    names = [item.name for item in items]
    if len(set(names)) < len(names):
        raise ValueError(f"{where}: two items have the same name: {names}")
    scales = {(item.low, item.high, item.step) for item in items if item.kind == "scale"}
    if scored and len(scales) != 1:
        raise ValueError(
            f"{where}: a scored page has items on one scale, got {sorted(scales) or 'none'}"
        )
    text = re.sub(r"(?<!\n)\n(?!\n)", " ", table["text"].strip())
    more = {name: table[name] for name in ("group", "picture", "seconds") if name in table}
    whole_number(f"{where}: seconds", more.get("seconds", 0), least=0, most=3600)
    if more.get("seconds") and (kind != "form" or scored):
        raise ValueError(
            f"{where}: seconds is for a form without a score, as answers may be missing"
        )
    more["shuffled"] = flag(f"{where}: shuffled", table.get("shuffled", False))
    return StudyPage(name, table["title"], text, table["section"], kind, scored, items, **more)


def _data_uri(where: str, path: Path) -> str:
    """Return a picture as it is kept in a plan."""
    kind = PICTURES.get(path.suffix.lower())
    if kind is None or not path.is_file() or path.stat().st_size > LARGEST_PICTURE:
        raise ValueError(
            f"{where}: picture must be a file of {', '.join(PICTURES)} with at most "
            f"{LARGEST_PICTURE} bytes, got {path}"
        )
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"


def _content(path: Path) -> dict[str, Any]:
    """Return what a TOML file holds."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"the pages in {path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ValueError(f"{path} is no TOML file in UTF-8: {error}") from None
    if not isinstance(content.get(WORDS, {}), dict):
        raise ValueError(f"{path}: {WORDS!r} must be a table, [{WORDS}]")
    return content


def _tables(path: Path) -> dict[str, dict[str, Any]]:
    """Return the pages of a TOML file, their names and keys checked."""
    content = {name: table for name, table in _content(path).items() if name != WORDS}
    for name, table in content.items():
        if not isinstance(table, dict) or not NAME.fullmatch(name):
            raise ValueError(
                f"{path}: {name!r} must be a table, [name], in small letters, digits and _"
            )
        _known(f"{path}, [{name}]", table, (*PAGE_KEYS, *PLACES))
    return content


def read_words(language: str = "en", files: Iterable[Path] = ()) -> dict[str, str]:
    """Return the messages of a language, as the files change them."""
    words = dict(_content(LANGUAGES[one_of("language", language, LANGUAGES)])[WORDS])
    for path in files:
        changes = _content(path).get(WORDS, {})
        _known(f"{path}, [{WORDS}]", changes, words)
        for name, text in changes.items():
            holes = set(HOLE.findall(words[name]))
            if not isinstance(text, str) or not set(HOLE.findall(text)) <= holes:
                filled = ", ".join(sorted(holes)) or "nothing"
                raise ValueError(
                    f"{path}, [{WORDS}]: {name} must be words, in which {filled} can be filled in; "
                    f"got {shown(text)}"
                )
        words |= changes
    return words


def read_pages(language: str = "en", files: Iterable[Path] = ()) -> list[StudyPage]:
    """
    Return the pages of a study: those of a language, as the files change them, add to them and
    leave some out.
    """
    tables = _tables(LANGUAGES[one_of("language", language, LANGUAGES)])
    for path in files:
        for name, table in _tables(path).items():
            where = f"{path}, [{name}]"
            if "picture" in table:
                table["picture"] = _data_uri(where, path.parent / str(table["picture"]))
            anchor = table.pop("after", table.get("before"))
            follows = "before" not in table
            table.pop("before", None)
            if name in tables:
                if anchor is not None:
                    raise ValueError(
                        f"{where} is there already, and keeps its place; leave out before and after"
                    )
                if table.pop("skip", False):
                    if name in ("drive", "debriefing"):
                        raise ValueError(f"{where} cannot be left out of a study")
                    del tables[name]
                else:
                    tables[name] = tables[name] | table
                continue
            if anchor not in tables or "section" in table or (anchor == "debriefing" and follows):
                raise ValueError(
                    f"{where} must say before or after which page it stands: one of "
                    f"{', '.join(tables)}"
                )
            order = list(tables)
            order.insert(order.index(anchor) + follows, name)
            tables[name] = {**table, "section": tables[anchor]["section"]}
            tables = {key: tables[key] for key in order}
    return [_page(f"[{name}]", name, table) for name, table in tables.items()]


def task_pages(task: str, language: str) -> list[Path]:
    """Return the files that change a language's pages for a task; none for the ground robot."""
    path = TASK_WORDS / task / f"{one_of('language', language, LANGUAGES)}.toml"
    return [path] if path.exists() else []


def steps_of(pages: Iterable[StudyPage], order: Iterable[str], group: str = "") -> list[Step]:
    """
    Return a participant's way through the study: the start, what belongs to each condition of their
    order, and the end; pages of another group are left out.
    """
    pages, order = [page for page in pages if page.group in ("", group)], list(order)
    by_section = {name: [page for page in pages if page.section == name] for name in SECTIONS}
    course: list[tuple[StudyPage, str | None, int | None]] = [
        (page, None, None) for page in by_section["start"]
    ]
    for position, condition in enumerate(order, 1):
        for page in by_section["each"]:
            if page.name != "pause" or position < len(order):
                title = page.title.replace("{number}", str(position)).replace(
                    "{count}", str(len(order))
                )
                course.append((replace(page, title=title), condition, position))
    course += [(page, None, None) for page in by_section["end"]]
    return [
        Step(page, index, condition, position)
        for index, (page, condition, position) in enumerate(course)
    ]


def as_json(pages: Iterable[StudyPage]) -> list[dict[str, Any]]:
    """Return pages as plain values for `study.json`."""
    return [asdict(page) for page in pages]
