"""Patterns for paths of files, and paths to a field inside a message."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from string import Formatter

from trustlab.models.checks import one_of, shown

_MOST_STARS = 3
# The lengths are bounded, so that no digits of a path overflow and no match takes long.
_TYPES = {
    "int": (r"\d{1,15}", int),
    "float": (r"-?\d{1,15}(?:\.\d{1,15})?", float),
    "str": (r"[^/]+?", str),
}


def natural_key(value: object) -> tuple:
    """Return a sort key that puts 2 before 10, numbers before words and None last."""
    if value is None:
        return (2,)
    if isinstance(value, int | float):
        return (0, float(value))
    parts = re.split(r"(\d+)", str(value))
    return (1, [(1, "", int(part)) if part.isdecimal() else (0, part, 0) for part in parts if part])


@dataclass(frozen=True)
class PathMatch:
    """A path that fits a pattern: the folder where the pattern starts, and its fields."""

    base: str
    fields: Mapping[str, object]
    texts: Mapping[str, str]


@dataclass(frozen=True)
class PathPattern:
    """
    A pattern such as ``part{folder:int}/trial{trial:int}.csv`` for the end of a path.

    Folders and file are separated by ``/``; a field is ``{name}``, ``{name:int}`` or
    ``{name:float}`` (a name that occurs twice must have the same text twice); ``*`` stands for
    anything within one folder or file name.
    """

    text: str
    fields: Mapping[str, type] = field(init=False, compare=False, repr=False)
    depth: int = field(init=False, compare=False, repr=False)
    _regex: re.Pattern = field(init=False, compare=False, repr=False)

    def __post_init__(self):
        if not isinstance(self.text, str) or not self.text.strip("/ "):
            raise ValueError(
                f"a pattern must be like 'trial{{trial:int}}.csv', got {shown(self.text)}"
            )
        if {".", ".."} & set(self.text.split("/")):
            raise ValueError(
                f"pattern {self.text!r}: leads from a folder down, so that it has no . or .. in it"
            )
        if max(part.count("*") for part in self.text.split("/")) > _MOST_STARS:
            fault = f"has more than {_MOST_STARS} * in one name; name what they stand for"
            raise ValueError(f"pattern {self.text!r}: {fault}")
        types: dict[str, type] = {}
        parts: list[str] = []
        # Where the last field of any length stands in `parts`, if fixed text alone has followed
        text_field = None
        for literal, name, kind, _ in self._parts():
            parts.append("[^/]*".join(map(re.escape, literal.replace(os.sep, "/").split("*"))))
            text_field = None if "*" in literal else text_field
            if name is None:
                continue
            if not name.isidentifier():
                raise ValueError(f"pattern {self.text!r}: a field needs a name, got {name!r}")
            kind = one_of(
                f"pattern {self.text!r}: the type of field {name!r}", kind or "str", _TYPES
            )
            if kind == "str" and name not in types and text_field is not None:
                # The field before ends where its text first stands: a later place would only leave
                # less for this one. So no other place is tried, and the time to match stays in
                # proportion to the path.
                parts[text_field:] = [f"(?>{''.join(parts[text_field:])})"]
            text_field = len(parts) if kind == "str" and name not in types else None
            parts.append(f"(?P={name})" if name in types else f"(?P<{name}>{_TYPES[kind][0]})")
            types.setdefault(name, _TYPES[kind][1])
        object.__setattr__(self, "fields", types)
        object.__setattr__(self, "_regex", re.compile("".join(parts)))
        object.__setattr__(self, "depth", self.text.strip("/").count("/") + 1)

    def _parts(self) -> list[tuple]:
        """Return the texts between the fields, each with name and type of the field after it."""
        try:
            return list(Formatter().parse(self.text))
        except ValueError as error:
            raise ValueError(
                f"pattern {self.text!r}: a brace is not closed, or not opened ({error})"
            ) from None

    def match(self, path: str | os.PathLike) -> PathMatch | None:
        """Return the fields of a path whose end fits the pattern, or None."""
        parts = os.path.abspath(path).replace(os.sep, "/").split("/")
        match = self._regex.fullmatch("/".join(parts[-self.depth :]))
        if match is None:
            return None
        texts = match.groupdict()
        fields = {name: self.fields[name](text) for name, text in texts.items()}
        return PathMatch("/".join(parts[: -self.depth]) or "/", fields, texts)

    def of_texts(self) -> "PathPattern":
        """Return the pattern whose fields may be any text."""
        return PathPattern(re.sub(r":(int|float)}", "}", self.text))

    def fill(self, texts: Mapping[str, object]) -> str:
        """Return the pattern with its fields filled in."""
        return "".join(literal + str(texts.get(name, "")) for literal, name, _, _ in self._parts())


@dataclass(frozen=True)
class Selector:
    """An entry of a list: by its field `key`, or by a list of names `key` beside the list."""

    key: str
    value: str

    def __str__(self) -> str:
        return f'[{self.key}="{self.value}"]'


_STEP = re.compile(r"""(?:^|\.)([A-Za-z_]\w*)|\[(\d{1,9})\]|\[([A-Za-z_][\w.]*)=(["'])(.*?)\4\]""")


@dataclass(frozen=True)
class FieldPath:
    """
    Where a number stands in a message.

    ``twist.twist.linear.x``, ``axes[1]``, ``yaw(pose.pose.orientation)``,
    ``transforms[child_frame_id="turtle1"].transform.translation.x`` or
    ``position[name="wheel_left"]``.
    """

    text: str
    steps: tuple[str | int | Selector, ...] = field(init=False, compare=False, repr=False)
    yaw: bool = field(init=False, compare=False, repr=False)

    def __post_init__(self):
        path, yaw = self.text, False
        if isinstance(path, str) and path.startswith("yaw(") and path.endswith(")"):
            path, yaw = path[4:-1], True
        matches = list(_STEP.finditer(path)) if isinstance(path, str) else []
        written = "".join(each.group() for each in matches)
        if not matches or not matches[0].group(1) or written != path:
            example = (
                "'twist.twist.linear.x', 'axes[1]', 'position[name=\"left\"]' or "
                "'yaw(pose.pose.orientation)'"
            )
            raise ValueError(
                f"cannot read the field path {shown(self.text)}; write it like {example}"
            )
        steps: list[str | int | Selector] = []
        for each in matches:
            name, index, key, _, value = each.groups()
            steps.append(name or (Selector(key, value) if key else int(index)))
        object.__setattr__(self, "steps", tuple(steps))
        object.__setattr__(self, "yaw", yaw)

    @property
    def selectors(self) -> str:
        """The selectors as written; a message without such an entry is no sample."""
        return "".join(str(step) for step in self.steps if isinstance(step, Selector))
