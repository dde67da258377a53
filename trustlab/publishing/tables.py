"""Tables as people read them: heads in words, numbers as papers write them, in book and Lab."""

import html
import numbers
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

from trustlab.identification.posterior.result import WORDS
from trustlab.studies.words import P_VALUE, decimals_of

# Columns whose decimals are those of the standard error of their row.
ESTIMATE = re.compile(
    "stderr|se|M|ci_high|ci_low|difference|estimate|mean|mean_difference|simulated|value"
)
# "0.3 to 0.5" and "0.3 ± 0.1" stay on a line.
BETWEEN = re.compile(r"(?<=\d) (to|±) (?=[-−\d])")
LEAST_P = 0.001
# Significant digits of a typical number of a column, of a standard error, and of numbers whose
# sizes are too different for the same decimals: by more than so many powers of ten.
DIGITS = 3
DIGITS_OF_ERROR = 2
DIGITS_ALONE = 4
SAME_SCALE = 1
MOST_DECIMALS = 8
MOST_ROWS = 1000


# Names in code, and what a table shows instead: as a head or as a cell.
TEMPLATE = Path(__file__).parent / "templates" / "columns.toml"
NAMES = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))
CELLS = NAMES["td"] | WORDS
HEADS = NAMES["th"] | CELLS


def table_html(frame: pd.DataFrame) -> str:
    """
    Return a table as HTML: the names of rows as columns of their own, so that all of them sort;
    numbers with few digits, their full value beside them in ``<data value>``; the caption that
    `caption` gave it, with columns that are the same in every row.
    """
    plain = frame.columns.nlevels == 1
    caption = frame.attrs.get("caption", "")
    if plain:
        frame = _with_row_names(frame)
        same = _constant(frame)
        if same.any():
            pairs = frame.loc[:, same].iloc[0].items()
            values = "; ".join(f"{_word(name)}: {cell(value)}" for name, value in pairs)
            values = html.unescape(re.sub("<[^>]*>", "", values))
            caption = f"{caption} In every row: {values}."
        frame = frame.loc[:, ~same]
    texts = frame.apply(_texts, errors=_errors(frame) if plain else None)
    level = f"{100.0 * frame.attrs.get('confidence', 0.95):g} % CI"
    heads = texts.rename(columns=lambda name: html.escape(_word(name).replace("95 % CI", level)))
    table = heads.to_html(
        index=not plain, escape=False, border=0, sparsify=plain, max_rows=MOST_ROWS
    )
    head = f"><caption>{html.escape(caption)}</caption>" if caption else ">"
    return table.replace(">", head, 1)


def _word(name: object) -> str:
    return HEADS.get(str(name), str(name))


def _with_row_names(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose names of rows are columns; plain numbers of rows are left out."""
    if frame.index.name is None and pd.api.types.is_integer_dtype(frame.index):
        return frame.reset_index(drop=True)
    above = f", by {frame.columns.name}" if frame.columns.name else ""
    heads = [_word(name or "") + above for name in frame.index.names]
    return frame.rename_axis(columns=None).reset_index(names=heads, allow_duplicates=True)


def _constant(frame: pd.DataFrame) -> np.ndarray:
    """Mark columns that are the same in every row of three or more, unless most of them are."""
    same = frame.apply(lambda x: x.notna().all() and len({*x.astype(str)}) == 1).to_numpy(bool)
    return same & (len(frame) >= 3) & (2 * same.sum() <= same.size)


def _errors(frame: pd.DataFrame) -> pd.Series | None:
    """Return the standard error of each row, or else half of its interval."""
    errors = frame.get("stderr", frame.get("se"))
    if errors is None and {"ci_low", "ci_high"} <= {*frame}:
        return (frame["ci_high"] - frame["ci_low"]) / 2.0
    return errors


def _texts(column: pd.Series, errors: pd.Series | None) -> pd.Series:
    """Return a column as texts; under several heads, its name is the last."""
    name = str(column.name[-1] if isinstance(column.name, tuple) else column.name)
    p = P_VALUE.fullmatch(name) is not None
    decimals = [common_decimals(column) if column.dtype.kind == "f" else None] * len(column)
    if errors is not None and ESTIMATE.fullmatch(name):
        decimals = [common_decimals([error], DIGITS_OF_ERROR) for error in errors]
    texts = [cell(value, p, count) for value, count in zip(column, decimals, strict=True)]
    return pd.Series(texts, column.index, dtype=object)


def common_decimals(values, digits: int = DIGITS) -> int | None:
    """
    Return the decimals that show a typical number, and differences between numbers; None where
    their sizes are too different to have the same.
    """
    values = np.asarray(values, dtype=float)
    finite = values[np.isfinite(values)]
    if not finite.any():
        return 0
    powers = np.floor(np.log10(np.abs(finite[finite != 0.0])))
    if np.ptp(powers) > SAME_SCALE:
        return None
    most = max(decimals_of(finite, digits), decimals_of(np.ptp(finite), DIGITS_OF_ERROR))
    if most > MOST_DECIMALS:
        return None
    exact = (n for n in range(most) if np.allclose(finite, finite.round(n), 1e-9, 0.0))
    return next(exact, most)


def cell(value: object, p: bool = False, decimals: int | None = None) -> str:
    """Return a value as a table shows it; a p-value with three decimals or as a bound."""
    if pd.api.types.is_scalar(value) and pd.isna(value):
        return "–"
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        text = html.escape(CELLS.get(str(value), str(value)))
        return BETWEEN.sub("\u00a0\\1\u00a0", text)
    if isinstance(value, numbers.Integral):
        return str(value)
    number = float(value) + 0.0  # without the minus of a zero
    if p:
        text = "&lt;\u00a0.001" if number < LEAST_P else f"{number:.3f}".removeprefix("0")
    elif decimals is None:
        many = round(abs(number)) >= 10**DIGITS_ALONE
        text = f"{number:.0f}" if many else f"{number:.{DIGITS_ALONE}g}"
    else:
        text = f"{number:.{decimals}f}"
    return f'<data value="{number!r}">{text.replace("-", "−")}</data>'
