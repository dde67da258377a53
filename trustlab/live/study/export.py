"""Everything that a live study has recorded as one zip: tables in CSV and Parquet, and a README."""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from trustlab.live.study.pages import StudyPage
from trustlab.models.files import write_atomically
from trustlab.sessions.session import Session
from trustlab.sessions.vocabulary import VOCABULARY

MEANINGS = Path(__file__).with_name("export.csv")
"""Names, units and meanings of the columns that are no signals."""

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a spreadsheet takes for the beginning of a formula."""


def write_export(path: Path, tables: Mapping[str, pd.DataFrame], about: str) -> None:
    """
    Write tables by name, and a README with what is said about them as a whole, as a zip.

    Entries carry no time of writing, so that the same study gives the same bytes. In a CSV file an
    apostrophe stands before words that a spreadsheet would take for a formula.
    """
    files: dict[str, str | bytes] = {}
    for name, table in tables.items():
        words = table.select_dtypes(["object", "string"]).columns
        harmless = table.assign(**{column: table[column].map(_harmless) for column in words})
        files[f"{name}.csv"] = harmless.to_csv(index=False)
        files[f"{name}.parquet"] = table.to_parquet(index=False)
    files["README.txt"] = _readme(tables, about)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in files.items():
            entry = zipfile.ZipInfo(name)
            entry.external_attr = 0o644 << 16  # else unzip makes files that nobody may read
            archive.writestr(entry, text, zipfile.ZIP_DEFLATED)
    write_atomically(path, content.getvalue())


def _harmless(value: object) -> object:
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def _readme(tables: Mapping[str, pd.DataFrame], about: str) -> str:
    """Return what the columns mean, with their units."""
    with MEANINGS.open(encoding="utf-8", newline="") as file:
        own = {name: (unit, meaning) for name, unit, meaning in csv.reader(file)}
    lines = [about, ""]
    for name, table in tables.items():
        lines += [f"{name}.csv, {name}.parquet: {len(table)} rows"]
        for column in map(str, table):
            unit, meaning = own.get(column) or _meaning_of(column)
            lines.append(f"  {column}{f' [{unit}]' if unit else ''}: {meaning}")
    return "\n".join(lines) + "\n"


def _meaning_of(column: str) -> tuple[str, str]:
    """Return unit and meaning of a signal, or of the score of a questionnaire."""
    if column in VOCABULARY:
        return VOCABULARY[column].unit, VOCABULARY[column].meaning
    page, _, kind = column.rpartition("_")
    return "", f"{SCORES[kind]} of the questionnaire {page}" if kind in SCORES else ""


SCORES = {"raw": "mean score", "mean": "mean score", "subscale": "score of a subscale"}


def samples_of(sessions: list[Session]) -> pd.DataFrame:
    """Return every sample of drives as one table."""
    tables = {}
    for session in sessions:
        meta = session.metadata
        tables[meta.participant, meta.more["position"], meta.condition] = session.data
    names = ["participant", "position", "condition", "t"]
    return pd.concat(tables, names=names).reset_index() if tables else pd.DataFrame()


def items_of(pages: list[StudyPage]) -> pd.DataFrame:
    """Return every item that people were asked, with its words."""
    rows = []
    for page in pages:
        for item in page.items:
            expected = "" if item.expected is None else str(item.expected)
            more = {"choices": "; ".join(item.choices), "expected": expected}
            rows.append({"page": page.name, **vars(item), **more})
    return pd.DataFrame(rows).rename(columns={"name": "item", "text": "words"})
