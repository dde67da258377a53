"""
What a session says about itself, and its form as JSON in the files that `write_session` writes.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from trustlab.models.checks import shown
from trustlab.sessions.errors import SessionError

_FIELDS = ("participant", "condition", "source", "synthetic")

# The fields with a name of their own, and the types that a file may give them; everything else goes
# to `more`.
_TYPES = {
    "participant": (str, int, type(None)),
    "condition": (str, int, float, type(None)),
    "synthetic": (bool,),
    "more": (dict,),
}


@dataclass(frozen=True)
class Metadata:
    """
    What a session says about itself.

    Parameters
    ----------
    participant : str, int or None
        Who took part.
    condition : str, int, float or None
        The experimental condition, for example "C1".
    source : str or None
        The file or the generator that the session came from.
    synthetic : bool
        True when the data were simulated; every figure and table made from them says so.
    more : mapping
        Whatever else the log names (trial, block, autonomy …): names to plain values.

    Examples
    --------
    >>> import trustlab as tl
    >>> metadata = tl.Metadata(participant=3, condition="C1", more={"trial": 2})
    >>> metadata.changed(condition="C2", site="north wing").more
    mappingproxy({'trial': 2, 'site': 'north wing'})
    """

    participant: str | int | None = None
    condition: str | int | float | None = None
    source: str | None = None
    synthetic: bool = False
    more: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        object.__setattr__(self, "more", MappingProxyType(dict(self.more)))

    def __reduce__(self):
        # A MappingProxyType cannot be pickled; the constructor makes it again from a dictionary.
        return (
            Metadata,
            (self.participant, self.condition, self.source, self.synthetic, dict(self.more)),
        )

    def changed(self, **changes: Any) -> "Metadata":
        """
        Return metadata with entries added or replaced.

        Parameters
        ----------
        **changes : object
            participant, condition, source, synthetic, or any other name, which goes to `more`.
        """
        fields = {name: changes.pop(name) for name in _FIELDS if name in changes}
        return replace(self, **fields, more={**self.more, **changes})

    def as_dict(self) -> dict[str, object]:
        """Return everything in one flat dictionary."""
        return {name: getattr(self, name) for name in _FIELDS} | dict(self.more)


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not a plain value")


def digest(values: bytes | np.ndarray) -> str:
    """Return 16 digits that change with every bit of a text, or of a column as floats."""
    data: Any = values if isinstance(values, bytes) else np.ascontiguousarray(values, dtype=float)
    return hashlib.blake2b(data, digest_size=8).hexdigest()


def metadata_to_json(metadata: Metadata, columns: Any, **extra: object) -> str:
    """Return metadata (but the source), digests of the columns and extra entries as JSON."""
    content = {name: getattr(metadata, name) for name in _FIELDS if name != "source"}
    for name, value in [*content.items(), *metadata.more.items()]:
        if not _survives_json(value):
            fault = f"metadata {name!r} would not read back the same: {shown(value)}"
            raise SessionError(
                f"{fault}; use plain numbers, texts, lists or dictionaries with text keys"
            )
    text = json.dumps(content | {"more": dict(metadata.more)} | extra, default=_plain)
    digests = {name: digest(columns[name]) for name in columns}
    return json.dumps(
        json.loads(text) | {"digests": digests | {"metadata": _digest_of_json(json.loads(text))}}
    )


def _digest_of_json(content: dict) -> str:
    return digest(json.dumps(content, sort_keys=True).encode())


def _survives_json(value: object) -> bool:
    try:
        return bool(json.loads(json.dumps(value, default=_plain)) == value)
    except (TypeError, ValueError, RecursionError):  # ValueError also where == gives an array
        return False


def metadata_from_json(text: str) -> tuple[Metadata, dict]:
    """Return the metadata written by `metadata_to_json`, and what else was given there."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SessionError(
            f"the trustlab metadata are damaged ({error}); write the file again"
        ) from error
    if not isinstance(content, dict):
        raise SessionError(
            f"the trustlab metadata must be an object, found {shown(content)}; write it again"
        )
    digests = content.pop("digests", None)  # which files of earlier versions lack
    if digests is not None and (
        not isinstance(digests, dict) or digests.get("metadata") != _digest_of_json(content)
    ):
        raise SessionError(
            "the trustlab metadata are not as they were written; the file is damaged: write it "
            "again"
        )
    content["digests"] = digests or {}
    facts: dict[str, Any] = {}
    for name, types in _TYPES.items():
        value = content.pop(name, {"synthetic": False, "more": {}}.get(name))
        if not isinstance(value, types):
            allowed = " or ".join("null" if kind is type(None) else kind.__name__ for kind in types)
            raise SessionError(
                f"the trustlab metadata give {name} as {shown(value)}; it must be {allowed}"
            )
        facts[name] = value
    return Metadata(**facts), content
