"""A recipe drafted from a table: what its names and values suggest, and what to fill in."""

from __future__ import annotations

import csv
import gzip
import json
import os
import re
from pathlib import Path
from typing import Any

import pandas as pd

from trustlab.models.files import path_of
from trustlab.sessions.columns import BLANKS
from trustlab.sessions.errors import SessionError, damage_named, nearest_file
from trustlab.sessions.reading import MOST_PERFORMANCE
from trustlab.sessions.recipe import NUMBER
from trustlab.sessions.tables import TEXTS, suffix_of
from trustlab.sessions.vocabulary import UNITS, VOCABULARY

ROWS = 20_000
PERFORMANCE = '# {} = {{ column = "..." }}   # performance, if it is logged; else with_performance'
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
MANUAL = r"(?i)(manu\w+|human|mensch|person|op(erator)?|user|teleop\w*|hand|on|true)"
AUTONOMOUS = r"(?i)(auto\w*|robot\w*|machine|controller|off|false)"
STEPS = {"s": 5.0, "ms": 5e3, "us": 5e6}  # the longest step between rows that looks like the unit


def draft_recipe(path: str | os.PathLike, out: str | os.PathLike | None = None) -> Path:
    """
    Write a recipe for a table, with what its names and values suggest and "?" where you know more.

    Every guess carries a comment. Reading with the draft names the first thing that is missing.

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
    if suffix_of(source) not in (*TEXTS, ".parquet"):
        raise SessionError(
            f"path {source}: draft_recipe reads {', '.join(TEXTS)} and .parquet tables; for a bag, "
            "name topics and fields as in docs/start.md"
        )
    if not source.is_file():
        raise SessionError(f"path {source}: there is no such file{nearest_file(source)}")
    with damage_named(f"{source} cannot be read as a table", "check the file"):
        if source.suffix.lower() == ".parquet":
            import pyarrow.parquet as pq

            batch = next(pq.ParquetFile(source).iter_batches(ROWS))
            frame, layout = batch.to_pandas(ignore_metadata=True), {}
        else:
            frame, layout = _read(source)
    target.write_text(_recipe(source, frame, layout), encoding="utf-8")
    return target


def _read(path: Path) -> tuple[pd.DataFrame, dict[str, object]]:
    """Return the first rows of a text table, and the entries of [table] that read it."""
    with (gzip.open if path.suffix.lower() == ".gz" else open)(path, "rb") as file:
        head = file.read(1 << 20)
    try:
        encoding, text = "utf-8", head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # The text of Windows has a letter for almost every byte; a last one may be cut in two.
        encoding = "cp1252" if error.start < len(head) - 3 else "utf-8"
        text = head.decode(encoding, "ignore")
    lines = text.splitlines()[:50]
    skipped = next((k for k, line in enumerate(lines) if not line.startswith("#")), 0)
    delimiter = next((mark for mark in ";\t|, " if _even(lines[skipped:], mark)), ",")
    first, *rows = csv.reader(lines[skipped:], delimiter=delimiter, skipinitialspace=True)
    decimal = any(re.fullmatch(r"[+-]?\d+,\d+", cell) for row in rows for cell in row)
    header = not all(NUMBER.fullmatch(cell.replace(",", ".")) for cell in first)
    frame = pd.read_csv(
        path,
        sep=r"\s+" if delimiter == " " else delimiter,
        header=0 if header else None,
        decimal="," if decimal else ".",
        skiprows=skipped,
        nrows=ROWS,
        encoding=encoding,
        na_values=list(BLANKS),
        skipinitialspace=True,
        on_bad_lines="skip",
        index_col=False,
    )
    layout = {
        "header": header,
        "delimiter": delimiter,
        "decimal": "," if decimal else ".",
        "skip_lines": skipped,
        "encoding": encoding,
    }
    usual = {"header": True, "delimiter": ",", "decimal": ".", "skip_lines": 0, "encoding": "utf-8"}
    return frame, {name: value for name, value in layout.items() if value != usual[name]}


def _even(lines: list[str], mark: str) -> bool:
    """Return whether a mark divides each line into as many cells, more than one."""
    rows = csv.reader([line.strip(" ") for line in lines], delimiter=mark, skipinitialspace=True)
    widths = {len(row) for row in rows if row}
    return len(widths) == 1 and widths != {1}


def _recipe(path: Path, frame: pd.DataFrame, layout: dict[str, object]) -> str:
    """Return the text of the draft."""
    time = _time_column(frame)
    guesses: dict[str, str] = {}
    rest: dict[Any, str] = {}
    for name in frame.columns:
        ours = "" if name == time else _ours(name)
        if ours and ours not in guesses:
            guesses[ours] = _rule(ours, name, frame[name])
        elif name != time:
            rest[name] = f"#   {name}: {_shown(frame[name])}"
    words = [name for name in rest if _is_text(frame[name]) and frame[name].nunique() == 2]
    if "mode" not in guesses and words:
        guesses["mode"] = _rule("mode", words[0], frame[words[0]])
        del rest[words[0]]
    elif "mode" not in guesses:
        guesses["mode"] = (
            'mode = { value = "?" }  # who drives: 1 manual, 0 autonomous; or { column = "...", '
            "map = { ... } }"
        )
    unit, remark = _time_unit(str(time), frame[time])
    lines = [
        f"# Drafted from {path.name}: fill in what is marked ?, check what is guessed.",
        f"name = {json.dumps(path.name.split('.')[0], ensure_ascii=False)}",
        'kind = "table"',
        "# performance_window = 100   # if p_r and p_h are moving means: over how many seconds",
        "",
        *(["[table]"] if layout else []),
        *(f"{name} = {json.dumps(value)}" for name, value in layout.items()),
        *([""] if layout else []),
        "[time]",
        f"column = {_quoted(time)}",
        f'unit = "{unit}"{remark}',
        "from_zero = true   # counts from the first sample",
        "",
        *_resampling(unit, frame[time]),
        "[columns]",
        *guesses.values(),
        *[PERFORMANCE.format(name) for name in ("p_r", "p_h") if name not in guesses],
        *(
            ["# not used; what a column may be called: trustlab.sessions.vocabulary()"]
            if rest
            else []
        ),
        *rest.values(),
    ]
    return "\n".join(lines) + "\n"


def _quoted(name: Any) -> str:
    return str(name) if isinstance(name, int) else json.dumps(str(name).strip(), ensure_ascii=False)


def _time_column(frame: pd.DataFrame) -> Any:
    """Return the column that looks like time: by its name, else the first that rises."""
    named = [name for name in frame if re.fullmatch(TIME, _parts(name)[0])]
    rising = [name for name in frame if frame[name].is_monotonic_increasing]
    return (named or rising or [frame.columns[0]])[0]


def _parts(name: Any) -> tuple[str, str]:
    """Return a name in small letters and underscores, and the unit that it ends with, or ""."""
    match = UNIT_AT_END.fullmatch(str(name).strip())
    stem = match[1] if match else str(name).strip()
    return re.sub(r"[\s.\-]+", "_", stem).lower(), SPELLINGS[match[2] or match[3]] if match else ""


def _is_text(values: pd.Series) -> bool:
    return values.dtype == object or str(values.dtype) == "str"


def _ours(name: Any) -> str:
    """Return the column of the vocabulary that a lab's name suggests; empty if none."""
    bare = _parts(name)[0]
    if bare in VOCABULARY or str(name) in VOCABULARY:
        return bare if bare in VOCABULARY else str(name)
    return next((ours for ours, words in NAMES.items() if re.fullmatch(words, bare)), "")


def _rule(ours: str, name: Any, values: pd.Series) -> str:
    """Return the line of one column."""
    unit = VOCABULARY[ours].unit
    keys = [f"column = {_quoted(name)}"]
    reason = "name" if _ours(name) == ours else "values"
    remarks = [] if str(name) == ours else [f"guessed by its {reason}"]
    written = _parts(name)[1]
    if unit not in ("1", "measure") or (written and str(name) != ours):
        keys.append(f'unit = "{written or ("?" if str(name) != ours else unit)}"')
    elif _per_cent(ours, values):
        keys.append('unit = "%"')
        remarks.append(f"values reach {values.max():.4g}")
    codes = list(dict.fromkeys(values.dropna()))
    text = _is_text(values)
    if text or (ours == "mode" and not set(codes) <= {0, 1}):
        keys.append(f"map = {{ {', '.join(_code(code) for code in codes[:10])} }}")
    elif ours == "mode":
        remarks.append("check that 1 is manual")
    if ours == "path_error" and not text and (values < 0.0).any():
        keys.append("absolute = true")
        remarks.append("a signed deviation becomes a distance")
    if values.isna().any():
        keys.append('blank = "hold"')
        remarks.append(f"{values.isna().sum()} blank cells repeat the value before")
    comment = f"  # {'; '.join(remarks)}" if remarks else ""
    return f"{ours} = {{ {', '.join(keys)} }}{comment}"


def _per_cent(ours: str, values: pd.Series) -> bool:
    """Return whether values of 0 to 100 stand where the session has shares or performance."""
    share = ours in ("p_r", "p_h") or (ours != "mode" and VOCABULARY[ours].high == 1.0)
    most = MOST_PERFORMANCE if ours in ("p_r", "p_h") else 1.0
    return share and not _is_text(values) and most < values.max() <= 100.0 and values.min() >= 0.0


def _code(code: Any) -> str:
    """Return an entry of the map of modes: 1 manual, 0 autonomous, "?" where nothing says so."""
    word = str(code)
    meaning = (
        "1" if re.fullmatch(MANUAL, word) else "0" if re.fullmatch(AUTONOMOUS, word) else '"?"'
    )
    return f"{json.dumps(word, ensure_ascii=False)} = {meaning}"


def _resampling(unit: str, values: pd.Series) -> list[str]:
    """Return the section that makes an even grid of stamps that jitter; none for even ones."""
    if _is_text(values):
        return []
    steps = values.diff().dropna()
    step = float(steps.median())
    if not step > 0.0 or ((steps - step).abs() < 0.01 * step).all():
        return []
    grid = f"sample_time = {step * UNITS[unit][1]:.3g}   # s; stamps are not even"
    return ["[resampling]", 'method = "linear"', grid, ""]


def _time_unit(name: str, values: pd.Series) -> tuple[str, str]:
    """Return the unit of time, and a remark."""
    if unit := _parts(name)[1]:
        return unit, ""
    if _is_text(values):
        first = str(values.iloc[0]).strip()
        if re.match(r"\d{1,2}:\d{2}:\d{2}", first):
            return "clock", ""
        if re.match(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}", first):
            return "iso", ""
        return "?", '   # "iso" for 2026-03-01T12:00:00, "clock" for 12:00:00.5'
    step = float(values.diff().abs().median())
    unit = next((unit for unit, longest in STEPS.items() if step <= longest), "ns")
    return unit, f"   # guessed: rows are {step:.4g} apart"


def _shown(values: pd.Series) -> str:
    """Say in few words what a column holds."""
    known = values.dropna()
    if _is_text(known) or not len(known):
        return ", ".join(map(str, list(dict.fromkeys(known))[:5])) or "blank"
    return f"{known.min():.4g} to {known.max():.4g}"
