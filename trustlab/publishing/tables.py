"""Tables as people read them: heads in words, numbers as papers write them, in book and Lab."""

import functools
import html
import numbers
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

from trustlab.identification.posterior.result import WORDS

P_VALUE = re.compile(
    r"p|p, .*|mauchly_p"
    r"|p[ _](gg|hf|holm|bonferroni|corrected|adjusted|uncorrected|value|mauchly|anova|friedman"
    r"|mixed|shapiro_least|simulated|chi2)"
)
LEAST_P = 0.001
# "0.3 to 0.5" and "0.3 ± 0.1" stay on a line.
BETWEEN = re.compile(r"(?<=\d) (to|±) (?=[-−\d])")
# Significant digits of a typical number of a column, and of a standard error.
DIGITS = 3
# Of numbers that have no decimals in common.
DIGITS_ALONE = 4
DIGITS_OF_ERROR = 2
MOST_DECIMALS = 8
# Powers of ten between which numbers of a column are written with the same decimals.
SAME_SCALE = 1
# The standard error of a row says how many decimals these have.
ERRORS = {"stderr", "se"}
ESTIMATES = ERRORS | {
    "M",
    "ci_high",
    "ci_low",
    "difference",
    "estimate",
    "mean",
    "mean_difference",
    "simulated",
    "value",
}
MOST_ROWS = 1000


@functools.cache
def words() -> dict[str, dict[str, str]]:
    """Return names in code and what a table shows instead: in heads (th), in cells too (td)."""
    text = (Path(__file__).parent / "templates" / "columns.toml").read_text(encoding="utf-8")
    read = tomllib.loads(text)
    read["td"] |= WORDS
    return read


def table_html(frame: pd.DataFrame) -> str:
    """
    Return a table as HTML: the names of rows as columns of their own, so that all of them sort;
    numbers with few digits, their full value beside them in ``<data value>``; the caption that
    `caption` gave it, with columns that are the same in every row.
    """
    by_column = frame.columns.nlevels == 1
    said = frame.attrs.get("caption", "")
    if by_column:
        frame = _with_row_names(frame)
        same = _constants(frame)
        frame = frame.drop(columns=list(same))
        if same:
            words = "; ".join(f"{_word(name)}: {_plain(value)}" for name, value in same.items())
            said = f"{said} In every row: {words}."
    # By position, as two columns may have the same head.
    texts = pd.DataFrame({place: _written(frame, place) for place in range(frame.shape[1])})
    heads = [
        tuple(map(_head, name)) if isinstance(name, tuple) else _head(name)
        for name in frame.columns
    ]
    texts.columns = frame.columns.map(dict(zip(frame.columns, heads, strict=True)))
    texts.index = frame.index
    table = texts.to_html(
        index=not by_column, escape=False, border=0, sparsify=by_column, max_rows=MOST_ROWS
    )
    return table.replace(">", f"><caption>{html.escape(said)}</caption>", 1) if said else table


def _with_row_names(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose names of rows are columns; plain numbers of rows are left out."""
    if frame.index.name is None and pd.api.types.is_integer_dtype(frame.index):
        return frame.reset_index(drop=True)
    above = f", by {frame.columns.name}" if frame.columns.name else ""
    rows = frame.index.to_frame(index=False)
    rows.columns = pd.Index([f"{_word(name or '')}{above}" for name in frame.index.names])
    return pd.concat([rows, frame.reset_index(drop=True)], axis=1)


def _constants(frame: pd.DataFrame) -> dict:
    """Return columns that are the same in every row of three or more, unless most of them are."""
    if len(frame) < 3 or not frame.columns.is_unique:
        return {}
    same = {
        name: column.iloc[0]
        for name, column in frame.items()
        if column.notna().all() and len(set(column.astype(str))) == 1
    }
    return same if 2 * len(same) <= frame.shape[1] else {}


def _word(name: object) -> str:
    return (words()["th"] | words()["td"]).get(str(name), str(name))


def _head(name: object) -> str:
    return html.escape(_word(name))


def _written(frame: pd.DataFrame, place: int) -> list[str]:
    """Return the texts of a column."""
    head = frame.columns[place]
    name = str(head[-1] if isinstance(head, tuple) else head)
    column = frame.iloc[:, place]
    p = P_VALUE.fullmatch(name) is not None
    decimals: list[int | None] = [None] * len(column)
    errors = _errors(frame)
    if errors is not None and name in ESTIMATES:
        decimals = [common_decimals(np.array([error]), DIGITS_OF_ERROR) for error in errors]
    elif pd.api.types.is_float_dtype(column):
        decimals = [common_decimals(column.to_numpy(float))] * len(column)
    return [cell(value, p, count) for value, count in zip(column, decimals, strict=True)]


def _errors(frame: pd.DataFrame) -> np.ndarray | None:
    """Return the standard error of each row, or else half of its interval."""
    for name in ERRORS & set(frame.columns):
        return frame[name].to_numpy(float)
    if {"ci_low", "ci_high"} <= set(frame.columns):
        return (frame["ci_high"] - frame["ci_low"]).to_numpy(float) / 2.0
    return None


def common_decimals(values: np.ndarray, digits: int = DIGITS) -> int | None:
    """
    Return the decimals that show a typical number, and differences between numbers; None where
    their sizes are too different to have the same.
    """
    finite = values[np.isfinite(values)]
    sizes = np.abs(finite[finite != 0.0])
    if not sizes.size:
        return 0
    powers = np.floor(np.log10(sizes))
    if np.ptp(powers) > SAME_SCALE:
        return None
    spread = np.ptp(finite)
    wanted = digits - 1 - int(np.median(powers))
    if spread > 0.0:
        wanted = max(wanted, DIGITS_OF_ERROR - 1 - int(np.floor(np.log10(spread))))
    wanted = max(wanted, 0)
    if wanted > MOST_DECIMALS:
        return None
    for count in range(wanted):
        if np.allclose(finite, finite.round(count), 1e-9, 0.0):
            return count
    return wanted


def _plain(value: object) -> str:
    """Return a value as a caption shows it."""
    return html.unescape(re.sub("<[^>]*>", "", cell(value)))


def cell(value: object, p: bool = False, decimals: int | None = None) -> str:
    """Return a value as a table shows it; a p-value with three decimals or as a bound."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if pd.api.types.is_scalar(value) and pd.isna(value):
        return "–"
    if not isinstance(value, numbers.Real):
        text = words()["td"].get(str(value), str(value))
        return BETWEEN.sub("\u00a0\\1\u00a0", html.escape(text))
    if isinstance(value, numbers.Integral):
        return str(value)
    number = float(value) + 0.0  # without the minus of a zero
    if p:
        text = "&lt;\u00a0.001" if number < LEAST_P else f"{number:.3f}".removeprefix("0")
    elif decimals is None:
        text = f"{number:.{DIGITS_ALONE}g}" if abs(number) < 10**DIGITS_ALONE else f"{number:.0f}"
    else:
        text = f"{number:.{decimals}f}"
    return f'<data value="{number!r}">{text.replace("-", "−")}</data>'
