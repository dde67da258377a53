"""
Everything that a live study has recorded as one zip: tables in CSV and Parquet, and a data
dictionary.

The dictionary, `datapackage.json`, is a Data Package of the Frictionless standard
(https://datapackage.org): each table's fields with their types, units and meanings.
"""

from __future__ import annotations

import csv
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from trustlab.live.study.pages import StudyPage
from trustlab.models.files import write_atomically
from trustlab.sessions.session import Session
from trustlab.sessions.vocabulary import VOCABULARY

MEANINGS = Path(__file__).with_name("export.csv")
"""Names, units and meanings of the columns that are no signals."""

KINDS = {"b": "boolean", "i": "integer", "u": "integer", "f": "number"}


def write_export(path: Path, tables: Mapping[str, pd.DataFrame], about: Mapping[str, Any]) -> None:
    """
    Write tables by name, and what the dictionary says of them as a whole, as a zip.

    Entries carry no time of writing, so that the same study gives the same bytes.
    """
    package = {**about, "resources": [_resource(*entry) for entry in tables.items()]}
    files: dict[str, str | bytes] = {}
    for name, table in tables.items():
        files[f"{name}.csv"] = table.to_csv(index=False)
        files[f"{name}.parquet"] = table.to_parquet(index=False)
    files["datapackage.json"] = json.dumps(package, indent=1, ensure_ascii=False) + "\n"
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in files.items():
            entry = zipfile.ZipInfo(name)
            entry.external_attr = 0o644 << 16  # else unzip makes files that nobody may read
            archive.writestr(entry, text, zipfile.ZIP_DEFLATED)
    write_atomically(path, content.getvalue())


def _resource(name: str, table: pd.DataFrame) -> dict[str, Any]:
    fields = [_field(column, table[column]) for column in table]
    schema = {"fields": fields, "missingValues": [""]}
    resource = {"name": name, "path": f"{name}.csv", "format": "csv", "encoding": "utf-8"}
    return {**resource, "profile": "tabular-data-resource", "schema": schema}


def _field(name: str, values: pd.Series) -> dict[str, str]:
    """Return what the dictionary says of a column."""
    signal = VOCABULARY.get(name)
    unit, meaning = meanings().get(name, (signal.unit, signal.meaning) if signal else ("", ""))
    for ending, words in ENDINGS.items():
        if not meaning and name.endswith(ending):
            meaning = f"{words} of the questionnaire {name.removesuffix(ending)}"
    field = {"name": name, "type": KINDS.get(values.dtype.kind, "string"), "description": meaning}
    return field | {"unit": unit} if unit else field


ENDINGS = {"_raw": "mean score", "_mean": "mean score", "_subscale": "score of a subscale"}


def meanings() -> dict[str, tuple[str, str]]:
    """Return unit and meaning of the columns that are no signals."""
    with MEANINGS.open(encoding="utf-8", newline="") as file:
        return {name: (unit, meaning) for name, unit, meaning in list(csv.reader(file))[1:]}


def samples_of(sessions: list[Session]) -> pd.DataFrame:
    """Return every sample of drives as one table."""
    tables = []
    for session in sessions:
        meta = session.metadata
        table = session.data.reset_index(names="t")
        keys = {
            "participant": meta.participant,
            "position": meta.more["position"],
            "condition": meta.condition,
        }
        for place, (name, value) in enumerate(keys.items()):
            table.insert(place, name, value)
        tables.append(table)
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def items_of(pages: list[StudyPage]) -> pd.DataFrame:
    """Return every item that people were asked, with its words."""
    columns = ("kind", "low", "high", "step", "left", "right", "reversed", "required")
    rows = []
    for page in pages:
        for item in page.items:
            row = {"page": page.name, "item": item.name, "words": item.text}
            row |= {name: getattr(item, name) for name in columns}
            row["choices"] = "; ".join(item.choices)
            row["expected"] = "" if item.expected is None else str(item.expected)
            rows.append(row)
    return pd.DataFrame(rows)
