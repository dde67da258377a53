"""Path patterns: what the names of folders and files say of a session."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

from trustlab.sessions.errors import RecipeError, nearest

__all__ = ["PathMatch", "PathPattern", "natural_key"]

_FIELD = re.compile(r"\{([^{}]*)\}")
_TYPES = {"int": (r"\d{1,15}", int), "float": (r"-?\d{1,15}(?:\.\d{1,15})?", float), "str": (r"[^/]+?", str)}


def natural_key(value: object) -> tuple:
    """
    Return a sort key that puts 2 before 10, numbers before words and nothing last.

    Parameters
    ----------
    value : object
        A number, a text or None.
    """
    if value is None:
        return (2,)
    if isinstance(value, int | float):
        return (0, float(value))
    parts = re.split(r"(\d+)", str(value))
    return (1, [(1, "", int(part)) if part.isdecimal() else (0, part, 0) for part in parts if part])


@dataclass(frozen=True)
class PathMatch:
    """
    A path that fits a pattern.

    Parameters
    ----------
    base : str
        The folder that the pattern starts from.
    fields : mapping
        The pattern's fields, typed.
    texts : mapping
        The same as they are written in the path.
    """

    base: str
    fields: Mapping[str, object]
    texts: Mapping[str, str]


@dataclass(frozen=True)
class PathPattern:
    """
    A pattern such as ``part{folder:int}/trial{trial:int}.csv`` for the end of a path.

    Parameters
    ----------
    text : str
        Folders and file with ``/`` between them; ``{name}``, ``{name:int}`` or ``{name:float}`` for a field (the
        same name twice must read the same twice), ``*`` for anything within one folder or file name.
    source : str, optional
        The recipe, for errors.

    Raises
    ------
    RecipeError
        If the pattern is empty, or a field has no name or a type that does not exist.
    """

    text: str
    source: str | None = None

    def __post_init__(self):
        if not isinstance(self.text, str) or not self.text.strip("/ "):
            raise RecipeError(
                f"a path pattern must be a text such as 'trial{{trial:int}}.csv', got {self.text!r}",
                self.source,
            )
        types: dict[str, type] = {}
        regex, last = "", 0
        for found in _FIELD.finditer(self.text):
            regex += self._literal(self.text[last : found.start()])
            name, _, kind = found.group(1).partition(":")
            if not name.isidentifier():
                raise RecipeError(f"pattern {self.text!r}: {found.group()!r} needs a name", self.source)
            kind = kind or "str"
            if kind not in _TYPES:
                raise RecipeError(
                    f"pattern {self.text!r}: field {name!r} has the unknown type {kind!r}"
                    f"{nearest(kind, _TYPES)} (known: int, float, str)",
                    self.source,
                )
            regex += f"(?P={name})" if name in types else f"(?P<{name}>{_TYPES[kind][0]})"
            types.setdefault(name, _TYPES[kind][1])
            last = found.end()
        regex += self._literal(self.text[last:])
        object.__setattr__(self, "fields", types)
        object.__setattr__(self, "_regex", re.compile(regex))
        object.__setattr__(self, "depth", self.text.strip("/").count("/") + 1)

    def _literal(self, text: str) -> str:
        if "{" in text or "}" in text:
            raise RecipeError(f"pattern {self.text!r}: a brace is open", self.source)
        return "[^/]*".join(re.escape(part) for part in text.replace(os.sep, "/").split("*"))

    def match(self, path: str | os.PathLike) -> PathMatch | None:
        """
        Return the fields of a path whose end fits the pattern, or None.

        Parameters
        ----------
        path : path-like
            A file or folder; its absolute path counts, so that it may be named from anywhere.
        """
        parts = os.path.abspath(path).replace(os.sep, "/").split("/")
        found = self._regex.fullmatch("/".join(parts[-self.depth :]))
        if found is None:
            return None
        texts = found.groupdict()
        fields = {name: self.fields[name](text) for name, text in texts.items()}
        return PathMatch("/".join(parts[: -self.depth]) or "/", fields, texts)

    def fill(self, texts: Mapping[str, object]) -> str:
        """
        Return the pattern with its fields filled in.

        Parameters
        ----------
        texts : mapping
            Field names to what to write.
        """
        return _FIELD.sub(lambda found: str(texts[found.group(1).partition(":")[0]]), self.text)
