"""What the dissertation prints, as strings, and the models with the printed parameters."""

import tomllib
from functools import cache

from trustlab.models.published import (
    ByName,
    printed_pilot,
    published_folder,
    published_models,
    published_table,
)

__all__ = [
    "ByName",
    "printed_pilot",
    "published_facts",
    "published_folder",
    "published_models",
    "published_table",
]


@cache
def published_facts(name: str) -> dict:
    """Return what a TOML file of data/published says; it is read once and must not be changed."""
    return tomllib.loads((published_folder() / f"{name}.toml").read_text(encoding="utf-8"))
