"""The Results section of a paper: sentences, tables and a figure, shown and written to HTML, LaTeX or Word."""

import html
import io
import os
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from trustlab.models.checks import one_of, shown
from trustlab.models.extras import extra
from trustlab.studies.analysis.apa import apa_table
from trustlab.studies.analysis.repeated_measures import RepeatedMeasures, repeated_measures

# What LaTeX would read as a command, and signs that it lacks as letters.
_LATEX = str.maketrans(
    {sign: f"\\{sign}" for sign in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$", ">": "$>$"}
    | {"−": "$-$", "×": r"$\times$", "²": "$^2$", "η": r"$\eta$", "ε": r"$\varepsilon$", "χ": r"$\chi$", "≥": r"$\geq$"}
)
_MOMENTS = {"n": "n", "mean": "M", "sd": "SD", "ci_low": "95% CI low", "ci_high": "95% CI high"}
_TESTS = (
    "effect",
    "F",
    "df1_corrected",
    "df2_corrected",
    "p_corrected",
    "eta2_partial",
    "eta2_generalized",
    "correction",
)
_HEADS = {
    "df1_corrected": "df1",
    "df2_corrected": "df2",
    "p_corrected": "p",
    "eta2_partial": "ηp²",
    "eta2_generalized": "ηG²",
}
_PAIRS = ("level", "a", "b", "mean_difference", "ci_low", "ci_high", "t", "df", "p", "p_holm", "p_bonferroni", "d_z")


@dataclass(frozen=True, eq=False)
class StudyReport:
    """
    The Results section of one measure.

    Parameters
    ----------
    result : RepeatedMeasures or FactorialMeasures
        The analysis.
    text : str
        Its sentences: test with its correction, effect sizes, means, pairs, exclusions, and what to know before using them.
    tables : dict of str to pandas.DataFrame
        Descriptive statistics, analysis of variance and pairwise comparisons by title; unrounded.
    """

    result: Any
    text: str
    tables: dict[str, pd.DataFrame]

    def table(self) -> pd.DataFrame:
        """Return the test of every effect, as `result.table()` does."""
        return self.result.table()

    def plot(self, axes=None):
        """
        Plot the means, as `result.plot()` does.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib.axes.Axes
        """
        return self.result.plot(axes=axes)

    def write(self, path: str | os.PathLike, digits: int = 2) -> Path:
        """
        Write text, tables and (but for LaTeX) figure to a file whose ending says the format.

        Parameters
        ----------
        path : path-like
            Ends in .html, .tex (a fragment that needs booktabs) or .docx.
        digits : int
            Decimals; p-values have three.

        Returns
        -------
        pathlib.Path

        Raises
        ------
        ValueError
            If the ending is another one.
        """
        path = Path(path)
        kind = one_of(f"the ending of {shown(path.name)}", path.suffix.lower(), (".html", ".tex", ".docx"))
        tables = {title: _printed(table, digits) for title, table in self.tables.items()}
        if kind == ".docx":
            _write_word(path, self, tables)
        else:
            make = _html if kind == ".html" else _latex
            path.write_text(make(self, tables), encoding="utf-8")
        return path

    def _repr_html_(self) -> str:
        return _html(self, {title: _printed(table, 2) for title, table in self.tables.items()}, figure=False)


def report(
    frame: pd.DataFrame, dv: Hashable, within: Hashable | list[Hashable], subject: Hashable, **options: Any
) -> StudyReport:
    """
    Analyse one measure and write its Results section.

    Parameters
    ----------
    frame : pandas.DataFrame
        Long table.
    dv, within, subject : hashable
        Columns, as for `repeated_measures`.
    **options : object
        Passed on to `repeated_measures`: between, covariate, missing, order, correction, alpha.

    Returns
    -------
    StudyReport

    Raises
    ------
    ValueError
        As `repeated_measures` does.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> study = tl.report(frame, dv="value", within="condition", subject="subject")
    >>> study.result.n, study.result.k
    (36, 5)
    """
    result = repeated_measures(frame, dv, within, subject, **options)
    one_way = isinstance(result, RepeatedMeasures)
    tests = result.table().assign(effect=str(result.within)) if one_way else result.table()
    factors = ["condition"] if one_way else [*result.between, *result.within]
    moments = result.descriptives().astype(dict.fromkeys(factors, str))  # levels that are numbers are not rounded
    tables = {"Descriptive statistics": moments, "Analysis of variance": tests[list(_TESTS)]}
    if one_way:
        tables["Pairwise comparisons"] = result.pairs()
    else:
        for factor in (*result.within, *result.between):
            tables[f"Pairwise comparisons of {factor}"] = result.pairs(factor).drop(columns="level")
    notes = f" {' '.join(result.notes)}" if one_way and result.notes else ""
    return StudyReport(result, f"{result.apa()}{notes}", tables)


def _printed(table: pd.DataFrame, digits: int) -> pd.DataFrame:
    """Return a table with the columns and roundings of a paper."""
    shown_columns = [name for name in table if name in _PAIRS] if "a" in table else list(table)
    if "mean" in table:
        shown_columns = [name for name in table if name in _MOMENTS or table[name].dtype.kind not in "fi"]
    own = table[shown_columns].rename(columns=_MOMENTS if "mean" in table else {})
    own = own.rename(columns={"p_corrected": "p"})  # so that it is printed as a p-value
    return apa_table(own, digits).rename(columns=_HEADS).astype(str)


def _html(found: StudyReport, tables: dict[str, pd.DataFrame], figure: bool = True) -> str:
    parts = [f"<p>{html.escape(found.text)}</p>"]
    for number, (title, table) in enumerate(tables.items(), start=1):
        caption = f"<p><b>Table {number}</b><br><i>{html.escape(_caption(found, title))}</i></p>"
        parts += [caption, table.to_html(index=False, border=0)]
    if figure:
        drawing = io.StringIO()
        _drawn(found, drawing, "svg")
        parts.append(drawing.getvalue()[drawing.getvalue().index("<svg") :])
    return "\n".join(parts)


def _latex(found: StudyReport, tables: dict[str, pd.DataFrame]) -> str:
    with extra("reports"):
        import jinja2  # noqa: F401  what pandas writes LaTeX with
    parts = [found.text.translate(_LATEX)]
    for title, table in tables.items():
        cells = table.rename(columns=lambda name: str(name).translate(_LATEX)).map(lambda cell: cell.translate(_LATEX))
        parts.append(cells.to_latex(index=False, escape=False, caption=_caption(found, title).translate(_LATEX)))
    return "\n\n".join(parts)


def _write_word(path: Path, found: StudyReport, tables: dict[str, pd.DataFrame]) -> None:
    with extra("reports"):
        import docx
    document = docx.Document()
    document.add_paragraph(found.text)
    for number, (title, table) in enumerate(tables.items(), start=1):
        document.add_paragraph(f"Table {number}. {_caption(found, title)}")
        grid = document.add_table(rows=1 + len(table), cols=table.shape[1])
        for i, row in enumerate([list(map(str, table.columns)), *table.to_numpy().tolist()]):
            for j, cell in enumerate(row):
                grid.cell(i, j).text = cell
    picture = io.BytesIO()
    _drawn(found, picture, "png")
    document.add_picture(picture)
    document.save(str(path))


def _caption(found: StudyReport, title: str) -> str:
    origin = f" [{found.result.origin}]" if found.result.origin else ""
    return f"{title}{origin}"


def _drawn(found: StudyReport, file: Any, kind: str) -> None:
    """Draw the figure into a file, and close it."""
    import matplotlib.pyplot as plt

    axes = found.plot()
    axes.figure.savefig(file, format=kind, dpi=200)
    plt.close(axes.figure)
