"""A recipe drafted from a table: what its names and words suggest, and what to fill in."""

from __future__ import annotations

import csv
import gzip
import io
import json
import os
import re
from pathlib import Path
from typing import Any

import pandas as pd

from trustlab.models.files import path_of, writing
from trustlab.sessions.columns import BLANKS
from trustlab.sessions.errors import SessionError, damage_named, source_named
from trustlab.sessions.reading import existing, likely_unit
from trustlab.sessions.recipe import NUMBER, TableRule, parse
from trustlab.sessions.tables import COMMENTS, HEAD, TEXTS, refuse_encoding, suffix_of
from trustlab.sessions.vocabulary import UNITS, VOCABULARY

TIME = r"t|(time|stamp|timestamp|secs?|clock|zeit\w*)\b.*|.*_?time(stamp)?"
# What labs call the columns that models need, without a unit behind it.
NAMES = {
    "mode": r"(drive_?)?mode|driver|driving|control(ler)?|manual|auto(nomous|nomy)?|who",
    "path_error": r"(path|track\w*|cross_?track|lateral)?_?(err(or)?|dev(iation)?)|cte|xte",
    "robot_x": r"(pos\w*|robot|odom)?_?x",
    "robot_y": r"(pos\w*|robot|odom)?_?y",
    "robot_z": r"(pos\w*|robot|odom)?_?z",
    "v_command": r"(stick|cmd|joy\w*|command)_?(v|vel\w*|lin\w*|x)",
    "p_r": r"(r|robot\w*|auto\w*|machine|vehicle|uav)_?perf(ormance)?",
    "p_h": r"(h|human\w*|op|operator|user|person|manual)_?perf(ormance)?",
    "w_command": r"(stick|cmd|joy\w*|command)_?(w|omega|ang\w*|turn|z)",
    "yaw": r"heading|theta|psi",
}
# How labs write a unit at the end of a name, beside ours.
SPELLINGS = {name: name for name in UNITS} | {"pct": "%", "percent": "%", "perc": "%"}
SPELLED = "|".join(sorted(map(re.escape, SPELLINGS), key=len, reverse=True))
UNIT_AT_END = re.compile(rf"(.+?)(?:\s*[\[(]\s*({SPELLED})\s*[\])]|[_ ]({SPELLED}))")
MANUAL = r"(?i)(manu\w+|human|mensch|person|op(erator)?|user|teleop\w*|hand)"
AUTONOMOUS = r"(?i)(auto\w*|robot\w*|machine|controller)"
# Answers, of which the column's name is the question.
YES, NO = r"(?i)on|true|yes|1(\.0)?", r"(?i)off|false|no|0(\.0)?"


def draft_recipe(path: str | os.PathLike, out: str | os.PathLike | None = None) -> Path:
    """
    Write a recipe for a table, with what its names and words suggest and "?" where you know more.

    Every guess carries a comment. Reading with the draft names the first thing that is missing:
    blank cells, signs, stamps that are not even.

    Parameters
    ----------
    path : path-like
        A ``.csv``, ``.csv.gz``, ``.tsv``, ``.txt`` or ``.parquet`` file.
    out : path-like, optional
        The recipe; by default the table's name with ``.toml`` in the working directory. An
        existing file is not replaced.

    Returns
    -------
    pathlib.Path
        The recipe.

    Raises
    ------
    SessionError
        If the file is no table of these formats, or the recipe exists already.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     recipe = tl.draft_recipe("data/sessions/pilot.csv", f"{folder}/mine.toml")
    ...     session = tl.read_session("data/sessions/pilot.csv", recipe)
    >>> session.columns
    ['mode', 'p_r', 'p_h']
    """
    source = path_of("path", path)
    target = path_of("out", f"{source.name.split('.')[0]}.toml" if out is None else out)
    if target.exists():
        raise SessionError(f"{target} exists already; give another name as out=...")
    with source_named(str(source)):
        existing(source)
        if suffix_of(source) not in (*TEXTS, ".parquet"):
            raise SessionError(
                f"draft_recipe reads {', '.join(TEXTS)} and .parquet tables; for a bag, name "
                "topics and fields as in docs/how_to/logs.md"
            )
        with damage_named("cannot be read as a table", "check the file"):
            if suffix_of(source) in TEXTS:
                layout, frame = _read(source)
            else:
                import pyarrow.parquet as pq

                layout, frame = {}, pq.read_table(source).to_pandas(ignore_metadata=True)
        if frame.empty:
            raise SessionError("no sample follows the names of its columns; draft from a whole log")
    with writing(target, SessionError):
        target.write_text(_recipe(source.name, layout, frame), encoding="utf-8")
    return target


def _read(path: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """Return the keys of [table] that read a text table, and its first rows."""
    with (gzip.open if path.suffix.lower() == ".gz" else open)(path, "rb") as file:
        head = file.read(HEAD) + file.readline(HEAD)
    refuse_encoding(head, "latin-1")  # what holds no text: that encoding has every byte
    try:
        encoding, text = "utf-8", head.decode("utf-8-sig")
    except UnicodeDecodeError:  # the text of Windows has a letter for almost every byte
        encoding, text = "cp1252", head.decode("cp1252", "ignore")
    lines = re.split("\r\n?|\n", text)
    skipped = next((k for k, line in enumerate(lines) if not line.startswith(COMMENTS)), 0)
    sample = [line.strip(" ") for line in lines[skipped : skipped + 50]]
    if not any(sample):
        return {}, pd.DataFrame()
    for delimiter in ";\t|, ":
        rows = [
            row for row in csv.reader(sample, delimiter=delimiter, skipinitialspace=True) if row
        ]
        if {len(row) for row in rows} == {max(2, len(rows[0]))}:
            break
    else:
        delimiter, rows = ",", [*csv.reader(sample)]
    comma = any(re.fullmatch(r"[+-]?\d+,\d+", cell) for row in rows[1:] for cell in row)
    layout = {
        "header": not all(NUMBER.fullmatch(cell.replace(",", ".")) for cell in rows[0]),
        "delimiter": delimiter,
        "decimal": "," if comma else ".",
        "skip_lines": skipped,
        "encoding": encoding,
    }
    rule = parse(TableRule, layout, "[table]")  # refuses what no recipe can state
    frame = pd.read_csv(
        io.StringIO("\n".join(lines[skipped:])),
        sep=r"\s+" if delimiter == " " else delimiter,
        header=0 if rule.header else None,
        decimal=rule.decimal,
        na_values=list(BLANKS),
        skipinitialspace=True,
        on_bad_lines="skip",
        index_col=False,
    )
    return layout, frame


def _recipe(title: str, layout: dict[str, Any], frame: pd.DataFrame) -> str:
    """Return the text of the draft."""
    named = [name for name in frame if re.fullmatch(TIME, _parts(name)[0])]
    rising = [name for name in frame if frame[name].is_monotonic_increasing]
    time = [*named, *rising, frame.columns[0]][0]
    unit, remark = _time_unit(time, frame[time])
    rules: dict[str, str] = {}
    rest = []
    for name, values in frame.drop(columns=time).items():
        ours = _ours(name)
        if ours and ours not in rules:
            rules[ours] = _rule(ours, name, values, "name")
        else:
            rest.append(name)
    if "mode" not in rules:
        rules["mode"] = (
            'mode = { value = "?" }  # who drives: 1 manual, 0 autonomous; or { column = "...", '
            "map = { ... } }"
        )
        for name in rest:
            if not _is_number(frame[name]) and frame[name].nunique() == 2:
                rest.remove(name)
                rules["mode"] = _rule("mode", name, frame[name], "values")
                break
    table = [f"{key} = {json.dumps(value)}" for key, value in layout.items()]
    unused = "".join(f"#   {name}\n" for name in rest)
    return "\n".join(
        [
            f"# Drafted from {title}: fill in what is marked ?, check what is guessed.",
            f"name = {_quoted(title.split('.')[0])}",
            'kind = "table"',
            "# performance_window = 100   # if p_r and p_h are moving means: over how many seconds",
            *(["", "[table]", *table] if table else []),
            "",
            "[time]",
            f"column = {_quoted(time)}",
            f'unit = "{unit}"{remark}',
            "from_zero = true   # counts from the first sample",
            "",
            "[columns]",
            *rules.values(),
            "# What a column may be called: trustlab.sessions.vocabulary(). Not used:",
            unused,
        ]
    )


def _quoted(name: Any) -> str:
    return str(name) if isinstance(name, int) else json.dumps(str(name).strip(), ensure_ascii=False)


def _parts(name: Any) -> tuple[str, str]:
    """Return a name in small letters and underscores, and the unit that it ends with, or ""."""
    match = UNIT_AT_END.fullmatch(str(name).strip())
    stem = match[1] if match else str(name).strip()
    return re.sub(r"[\s.\-]+", "_", stem).lower(), SPELLINGS[match[2] or match[3]] if match else ""


def _ours(name: Any) -> str:
    """Return the column of the vocabulary that a lab's name suggests; empty if none."""
    bare = _parts(name)[0]
    if bare in VOCABULARY or name in VOCABULARY:
        return bare if bare in VOCABULARY else name
    return next((ours for ours, words in NAMES.items() if re.fullmatch(words, bare)), "")


def _rule(ours: str, name: Any, values: pd.Series, reason: str) -> str:
    """Return the line of one column; `reason` is what it was guessed by."""
    needed = VOCABULARY[ours].unit
    same = name == ours
    written = "" if same else _parts(name)[1]
    keys = {"column": _quoted(name)}
    remarks = [] if same else [f"guessed by its {reason}"]
    if written or needed not in ("1", "measure"):
        keys["unit"] = f'"{written or (needed if same else "?")}"'
    codes = values.dropna().unique()
    shares = values.dtype.kind in "iuf" and all(0 <= code <= 1 for code in codes)
    if not _is_number(values) or (ours == "mode" and not shares):
        keys["map"] = f"{{ {', '.join(_entry(name, code) for code in codes[:10])} }}"
    elif ours == "mode":
        if re.fullmatch(AUTONOMOUS, _parts(name)[0]):
            keys |= {"scale": "-1", "offset": "1"}
        remarks.append("check that 1 is manual")
    comment = f"  # {'; '.join(remarks)}" if remarks else ""
    return f"{ours} = {{ {', '.join(map(' = '.join, keys.items()))} }}{comment}"


def _entry(name: Any, code: Any) -> str:
    """Return an entry of the map of modes: 1 manual, 0 autonomous, "?" where nothing says so."""
    word = str(code)
    no = re.fullmatch(NO, word)
    said = _parts(name)[0] if no or re.fullmatch(YES, word) else word
    pair = [re.fullmatch(MANUAL, said), re.fullmatch(AUTONOMOUS, said)]
    manual, autonomous = reversed(pair) if no else pair
    return f"{_quoted(word)} = " + ("1" if manual else "0" if autonomous else '"?"')


def _is_number(values: pd.Series) -> bool:
    return values.dtype.kind in "biuf"


def _time_unit(name: Any, values: pd.Series) -> tuple[str, str]:
    """Return the unit of time, and a remark."""
    if unit := _parts(name)[1]:
        return unit, ""
    if _is_number(values):
        step = float(values.diff().abs().median())
        unit = likely_unit(values.iloc[0], step)
        return unit, f"   # guessed: rows are {step:.4g} apart"
    first = str(values.iloc[0]).strip()
    if re.match(r"\d{1,2}:\d{2}:\d{2}", first):
        return "clock", ""
    if re.match(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}", first):
        return "iso", ""
    return "?", '   # "iso" for 2026-03-01T12:00:00, "clock" for 12:00:00.5'
