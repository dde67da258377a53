"""Patterns for paths of files, and paths to a number inside a message."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from string import Formatter

from trustlab.models.checks import one_of, shown

# Of each type of a field: what its text looks like, and what makes a value of it.
TYPES = {
    "int": (r"\d{1,15}", int),
    "float": (r"-?\d{1,15}(?:\.\d{1,15})?", float),
    "str": (r"[^/]+?", str),
}


def natural_key(value: object) -> tuple:
    """Return a sort key that puts 2 before 10, numbers before texts and None last."""
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


class PathPattern:
    """
    A pattern such as ``part{folder:int}/trial{trial:int}.csv`` for the end of a path.

    Folders and file are separated by ``/``; a field is ``{name}``, ``{name:int}`` or
    ``{name:float}`` (a name that occurs twice must have the same text twice); ``*`` stands for
    anything within one folder or file name.
    """

    def __init__(self, text: str):
        where = f"pattern {shown(text)}"
        if not isinstance(text, str) or not text.strip("/ "):
            raise ValueError(f"{where} must be like 'trial{{trial:int}}.csv'")
        if {".", ".."} & {*text.split("/")}:
            raise ValueError(f"{where}: leads from a folder down, so that it has no . or .. in it")
        try:
            parts = list(Formatter().parse(text))
        except ValueError as error:
            raise ValueError(f"{where}: a brace is not closed, or not opened ({error})") from None
        self.text = text
        self.types: dict[str, str] = {}
        regex = ""
        for literal, name, kind, _ in parts:
            regex += "[^/]*".join(map(re.escape, literal.split("*")))
            if name is None:
                continue
            if not name.isidentifier():
                raise ValueError(f"{where}: a field needs a name, got {name!r}")
            kind = one_of(f"{where}: the type of field {name!r}", kind or "str", TYPES)
            regex += f"(?P={name})" if name in self.types else f"(?P<{name}>{TYPES[kind][0]})"
            self.types.setdefault(name, kind)
        self.regex = re.compile(regex)

    def match(self, path: str | os.PathLike) -> PathMatch | None:
        """Return the fields of a path whose end fits the pattern, or None."""
        parts = os.path.abspath(path).replace(os.sep, "/").split("/")
        depth = self.text.strip("/").count("/") + 1
        match = self.regex.fullmatch("/".join(parts[-depth:]))
        if match is None:
            return None
        texts = match.groupdict()
        fields = {name: TYPES[self.types[name]][1](text) for name, text in texts.items()}
        return PathMatch("/".join(parts[:-depth]) or "/", fields, texts)

    def fill(self, texts: Mapping[str, object]) -> str:
        """Return the pattern with its fields filled in."""
        return re.sub(r"{(\w+)(:\w+)?}", lambda field: str(texts[field[1]]), self.text)


@dataclass(frozen=True)
class Selector:
    """An entry of a list: by its field `key`, or by a list of names `key` beside the list."""

    key: str
    value: str

    def __str__(self) -> str:
        return f'[{self.key}="{self.value}"]'


STEP = re.compile(r"""(?:^|\.)([A-Za-z_]\w*)|\[(\d{1,9})\]|\[([A-Za-z_][\w.]*)=(["'])(.*?)\4\]""")


class FieldPath:
    """
    Where a number stands in a message.

    ``twist.twist.linear.x``, ``axes[1]``, ``yaw(pose.pose.orientation)``,
    ``transforms[child_frame_id="turtle1"].transform.translation.x`` or
    ``position[name="wheel_left"]``.
    """

    def __init__(self, text: str):
        path = text if isinstance(text, str) else ""
        heading = re.fullmatch(r"yaw\((.*)\)", path)
        path = heading[1] if heading else path
        matches = list(STEP.finditer(path))
        if not matches or not matches[0][1] or "".join(each[0] for each in matches) != path:
            example = "'twist.twist.linear.x', 'axes[1]' or 'position[name=\"left\"]'"
            raise ValueError(f"cannot read the field path {shown(text)}; write it like {example}")
        self.text = text
        self.yaw = heading is not None
        self.steps: list[str | int | Selector] = []
        for name, index, key, _, value in (each.groups() for each in matches):
            self.steps.append(name or (Selector(key, value) if key else int(index)))

    @property
    def selectors(self) -> str:
        """The selectors as written; a message without such an entry is no sample."""
        return "".join(str(step) for step in self.steps if isinstance(step, Selector))
