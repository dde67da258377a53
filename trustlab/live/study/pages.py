"""
The pages of a study: their words and items from TOML files, their order for a participant, and
which answers are accepted.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from trustlab.models.checks import flag, one_of, shown
from trustlab.studies.questionnaires import NASA_TLX, TRUST_CHECKLIST, Questionnaire

FOLDER = Path(__file__).parents[1] / "words"
LANGUAGES = {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}
"""The files of words that come with the package."""

LONGEST_ANSWER = 1000
"""Characters that a participant may write in one answer."""

SECTIONS = ("start", "each", "end")
FIXED = {"identification": ("start",), "drive": ("each",), "debriefing": ("end",)}
"""Where these pages must be; they are for all groups."""

NEEDED = ("drive", "debriefing")
"""What no study can leave out."""

PRINTED = {"nasa_tlx": NASA_TLX, "trust": TRUST_CHECKLIST}
SCORED = (*PRINTED, "satisfaction", "likert")
SCALE = ("low", "high", "step", "left", "right")
"""What a page may give for all its scales."""

ITEMS = {
    "scale": (*SCALE, "reversed", "expected"),
    "choice": ("choices", "expected"),
    "text": ("required", "expected"),
    "check": (),
}
"""The kinds of items, and what each may have besides its name and text."""

ASKED = ("scored", "items", *SCALE)
KEYS = ("title", "text", "section", "before", "after", "skip")
"""What the tables of forms, and of all pages, may hold; the kind is no lab's to choose."""

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

    name: str = ""
    text: str = ""
    kind: str = "scale"
    low: int = 1
    high: int = 7
    step: int = 1
    left: str = ""
    right: str = ""
    choices: list = field(default_factory=list)
    reversed: bool = False
    required: bool = False
    expected: Any = None

    def __post_init__(self):
        if not NAME.fullmatch(self.name) or not self.text:
            raise ValueError(
                "it needs a text, and a name of small letters, digits and _, at most 40, that "
                "begins with a letter"
            )
        one_of("kind", self.kind, ITEMS)
        words = {choice for choice in self.choices if isinstance(choice, str)}
        if self.kind == "choice" and not 2 <= len(words) == len(self.choices):
            raise ValueError(
                f"choices must be two different words or more, got {shown(self.choices)}"
            )
        steps, rest = divmod(self.high - self.low, max(self.step, 1))
        if self.kind == "scale" and (self.step < 1 or rest or not 1 <= steps <= 1000):
            raise ValueError(
                f"step {self.step} does not lead from low {self.low} to high {self.high}, in at "
                "most 1000 steps"
            )
        if self.expected is not None:
            try:
                self.check(self.expected)
            except AnswerError:
                raise ValueError(f"expected = {shown(self.expected)} is no answer to it") from None

    def check(self, answer: Any) -> None:
        """Refuse an answer that this item does not allow."""
        if self.kind == "scale":
            fits = type(answer) is int and answer in range(self.low, self.high + 1, self.step)
            allowed = f"{self.low} to {self.high} in steps of {self.step}"
        elif self.kind == "check":
            fits, allowed = answer is True, "given"
        elif self.kind == "choice":
            fits, allowed = answer in self.choices, f"one of {', '.join(self.choices)}"
        else:
            fits = isinstance(answer, str) and len(answer) <= LONGEST_ANSWER and storable(answer)
            fits = fits and bool(answer.strip() or not self.required)
            least = int(self.required)
            allowed = f"{least} to {LONGEST_ANSWER} characters that files can hold"
        if not fits:
            raise AnswerError(f"{self.name}: the answer must be {allowed}")


@dataclass(frozen=True)
class StudyPage:
    """
    One page: a form with any number of items, a drive, or the end.

    `section` says whether it comes once at the start, after each drive, or once at the end;
    `scored` how its items are scored; `group` who sees it, all if empty.
    """

    name: str
    title: str = ""
    text: str = ""
    section: str = ""
    kind: str = "form"
    scored: str = ""
    items: list = field(default_factory=list)
    group: str = ""

    def __post_init__(self):
        if not self.title.strip() or not self.text:
            raise ValueError("it needs a title and a text")
        one_of("scored", self.scored, ("", *SCORED))
        one_of("section", self.section, FIXED.get(self.name, SECTIONS))
        names = [item.name for item in self.items]
        if len(set(names)) < len(names):
            raise ValueError(f"two items have the same name: {names}")
        scales = {(item.low, item.high, item.step) for item in self.scales}
        if self.scored and len(scales) != 1:
            raise ValueError(
                f"a scored page has items on one scale, got {sorted(scales) or 'none'}"
            )

    @property
    def scales(self) -> list[Item]:
        """The items that are scored: scales that do not check attention."""
        return [item for item in self.items if item.kind == "scale" and item.expected is None]

    @property
    def questionnaire(self) -> Questionnaire:
        """What the page asks, on the scale of its items; a page of a lab's own keeps its name."""
        items = self.scales
        scale = {name: getattr(items[0], name) for name in ("low", "high", "step")}
        names, turned = (
            [item.name for item in items],
            [item.name for item in items if item.reversed],
        )
        printed = PRINTED.get(self.scored)
        if printed is None or set(names) != set(printed.items):
            return Questionnaire(self.name, names, reversed=turned, **scale)
        if self.name != self.scored:
            parts = {f"{self.name}_{name}": part for name, part in printed.subscales.items()}
            printed = replace(printed, name=self.name, subscales=parts)
        return replace(printed, **scale)

    def check(self, answers: Any) -> dict:
        """
        Return the answers, one to each item and none besides, in the items' order; or raise
        `AnswerError`.
        """
        if not isinstance(answers, dict) or set(answers) - {item.name for item in self.items}:
            raise AnswerError("the answers must be names of items with values")
        for item in self.items:
            try:
                item.check(answers.get(item.name))
            except AnswerError:  # people know an item by its text, in their language
                raise AnswerError(item.text) from None
        return {item.name: answers[item.name] for item in self.items}

    @classmethod
    def read(cls, content: dict) -> "StudyPage":
        """Return a page from what `asdict` made of it."""
        return cls(**content | {"items": [Item(**item) for item in content["items"]]})


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


def steps_of(pages: Sequence[StudyPage], order: Iterable[str], group: str = "") -> list[Step]:
    """
    Return a participant's way through the study: the start, what belongs to each condition of their
    order, and the end; pages of another group are left out.
    """
    order = list(order)
    places: list[tuple] = [("each", condition, k) for k, condition in enumerate(order, 1)]
    steps: list[Step] = []
    for section, condition, position in (("start", None, None), *places, ("end", None, None)):
        for page in pages:
            others = page.section != section or page.group not in ("", group)
            if others or (page.name == "pause" and position == len(order)):
                continue
            if position is not None:
                text = json.dumps(asdict(page)).replace("{number}", str(position))
                page = StudyPage.read(json.loads(text.replace("{count}", str(len(order)))))
            steps.append(Step(page, len(steps), condition, position))
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
    behind: dict[str, str] = {}  # the page that was put behind each
    for path in files:
        for name, table in _content(path).items():
            where = places[name] = f"{path}, [{name}]"
            if not isinstance(table, dict) or not NAME.fullmatch(name):
                raise ValueError(f"{where} must be a table, [name], in small letters, digits and _")
            group = () if name in FIXED else ("group",)
            asked = () if "kind" in tables.get(name, ()) else ASKED
            for key in table:
                one_of(f"a key of {where}", key, (*group, *asked, *KEYS))
            tables = _changed(tables, name, table, where, behind)
    return [_page(places[name], name, table) for name, table in tables.items()]


def _content(path: Path) -> dict:
    """Return what a TOML file holds."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"the pages in {path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ValueError(f"{path} is no TOML file in UTF-8: {error}") from None


def _changed(
    tables: dict[str, dict], name: str, table: dict, where: str, behind: dict[str, str]
) -> dict[str, dict]:
    """Return pages of which a file's table changes one, leaves one out, or is a new one."""
    before, after = table.pop("before", ""), table.pop("after", "")
    anchor = before or after
    if name in tables:
        if anchor:
            raise ValueError(
                f"{where} is there already, and keeps its place; leave out before and after"
            )
        skip = flag(f"skip of {where}", table.pop("skip", False))
        if skip and name in NEEDED:
            raise ValueError(f"{where} cannot be left out of a study")
        tables[name] |= table
        if skip:
            del tables[name]
        return tables
    at_end = after == "debriefing"
    if bool(before) == bool(after) or anchor not in list(tables) or "section" in table or at_end:
        raise ValueError(
            f"{where} must say before or after which page it stands: one of {', '.join(tables)}"
        )
    table["section"] = tables[anchor]["section"]
    while after and behind.get(anchor) in tables:  # those behind the same page keep their order
        anchor = behind[anchor]
    if after:
        behind[anchor] = name
    pages = list(tables.items())
    pages.insert(list(tables).index(anchor) + bool(after), (name, table))
    return dict(pages)


def _page(where: str, name: str, table: dict) -> StudyPage:
    """Return a page from its table in TOML files."""
    common = {key: table[key] for key in SCALE if key in table}
    own = {key: value for key, value in table.items() if key not in SCALE} | {"name": name}
    if isinstance(own.get("items"), list):
        own["items"] = [_item(where, item, common) for item in own["items"]]
    if isinstance(own.get("text"), str):
        own["text"] = re.sub(r"(?<!\n)\n(?!\n)", " ", own["text"].strip())
    page = _made(where, StudyPage, own, StudyPage.__annotations__)
    if printed := PRINTED.get(page.scored):
        turned = {item.name for item in page.scales if item.reversed}
        if not page.questionnaire.source or turned not in (set(), {*printed.reversed}):
            raise ValueError(
                f"{where} is scored as {printed.source}: its items must be "
                f"{', '.join(printed.items)}, with reversed left out; score others as likert"
            )
    return page


def _item(where: str, table: Any, common: dict) -> Item:
    """Return an item from its table; what its page gives holds where it gives nothing itself."""
    if not isinstance(table, dict):
        raise ValueError(f"{where}: an item is a table, got {shown(table)}")
    where = f"{where}, item {shown(table.get('name'))}"
    kind = one_of(f"{where}: kind", table.get("kind", "scale"), ITEMS)
    table = common | table if kind == "scale" else table
    return _made(where, Item, table, ("name", "text", "kind", *ITEMS[kind]))


def _made(where: str, kind: type, table: dict, keys: Iterable[str]) -> Any:
    """Return a page or an item from its fields by name; errors say where it stands."""
    try:
        for key, value in table.items():
            wanted = kind.__annotations__[one_of("a key", key, keys)]
            if wanted not in (Any, type(value)):
                raise ValueError(f"{key} must be of type {wanted.__name__}, got {shown(value)}")
        return kind(**table)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
