"""
The Results section of a paper: sentences, tables and a figure, shown and written to HTML, LaTeX or
Word.
"""

import html
import io
import os
import re
import unicodedata
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trustlab.identification import FitResult
from trustlab.models.checks import one_of, shown
from trustlab.models.extras import extra
from trustlab.models.tsc import HumanModel, RobotModel, TscModel
from trustlab.studies.analysis.apa import apa_number, apa_table
from trustlab.studies.analysis.repeated_measures import RepeatedMeasures, repeated_measures

# What LaTeX would read as a command, and signs that it lacks as letters.
_LATEX = str.maketrans(
    {sign: f"\\{sign}" for sign in "&%$#_{}"}
    | {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": "$<$",
        ">": "$>$",
    }
    | {
        "−": "$-$",
        "×": r"$\times$",
        "²": "$^2$",
        "η": r"$\eta$",
        "±": r"$\pm$",
        "ε": r"$\varepsilon$",
        "χ": r"$\chi$",
        "≥": r"$\geq$",
    }
)
# Heads of columns in LaTeX's mathematics; others are written in words.
_MATHEMATICS = {
    "ηp²": r"$\eta_p^2$",
    "ηG²": r"$\eta_G^2$",
    "d_z": "$d_z$",
    "df1": "$df_1$",
    "df2": "$df_2$",
    "p (Holm)": r"$p_\mathrm{Holm}$",
    "p (Bonferroni)": r"$p_\mathrm{Bonferroni}$",
} | {name: f"${name}$" for name in ("F", "M", "SD", "df", "n", "p", "t")}
# Parameters of fits: "human_p_min" is "human $p_{\min}$".
_SYMBOLS = {"beta": r"\beta", "p_min": r"p_{\min}", "p_max": r"p_{\max}"}
# What is printed instead of a parameter that tells how fast a model forgets.
_TIMES = {"a": "time constant [s]", "human_a": "human τ [s]", "robot_a": "robot τ [s]"}
_MATHEMATICS |= {
    f"{who}_{name}": f"{who} ${symbol}$"
    for who in ("human", "robot")
    for name, symbol in _SYMBOLS.items()
}
_MATHEMATICS |= {
    "human τ [s]": r"human $\tau$ [s]",
    "robot τ [s]": r"robot $\tau$ [s]",
    "TSC_l": "$TSC_l$",
    "TSC_u": "$TSC_u$",
}
# Symbols where there is no mathematics; other names are written with blanks.
_PLAIN = {name: name for name in ("TSC_l", "TSC_u", "d_z")} | {
    f"{who}_{name}": f"{who} {symbol}"
    for who in ("human", "robot")
    for name, symbol in {"beta": "β", "p_min": "p_min", "p_max": "p_max"}.items()
}
# Words for columns of results.
_WORDS = {
    "ci_low": "95% CI low",
    "ci_high": "95% CI high",
    "stderr": "standard error",
    "se": "standard error",
    "p_holm": "p (Holm)",
    "p_bonferroni": "p (Bonferroni)",
}
# Columns beyond which a table of one row is printed as a column.
_WIDE = 8
# Columns of a section's tables, and what they are called there.
_MOMENTS = {"n": "n", "mean": "M", "sd": "SD", "ci_low": "95% CI low", "ci_high": "95% CI high"}
_TESTS = {
    "effect": "effect",
    "F": "F",
    "df1_corrected": "df1",
    "df2_corrected": "df2",
    "p_corrected": "p",
}
_TESTS |= {"eta2_partial": "ηp²", "eta2_generalized": "ηG²", "correction": "correction"}
_PAIRS = (
    "a",
    "b",
    "mean_difference",
    "ci_low",
    "ci_high",
    "t",
    "df",
    "p",
    "p_holm",
    "p_bonferroni",
    "d_z",
)


@dataclass(frozen=True, eq=False)
class StudyReport:
    """
    The Results section of one measure, or any result in the form of one.

    Parameters
    ----------
    result : object
        The analysis, or a table.
    text : str
        Its sentences: test with its correction, effect sizes, means, pairs, exclusions, and what to
        know before using them; empty where the result has none.
    tables : dict of str to pandas.DataFrame
        Descriptive statistics, analysis of variance and pairwise comparisons by title; or the
        result's own table; unrounded.
    origin : str
        What kind of data these are where they were not measured; else empty.
    """

    result: Any
    text: str
    tables: dict[str, pd.DataFrame]
    origin: str

    def table(self) -> pd.DataFrame:
        """Return what `result.table()` does, or the table itself."""
        return self.result if isinstance(self.result, pd.DataFrame) else self.result.table()

    def plot(self, axes=None):
        """
        Plot the means of a section, as `result.plot()` does.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib.axes.Axes
        """
        return self.result.plot(axes=axes)

    @property
    def drawn(self) -> bool:
        """Whether there is a figure: that of an analysis of variance."""
        return isinstance(self.result, RepeatedMeasures)

    def write(self, path: str | os.PathLike, digits: int = 2) -> Path:
        """
        Write text, tables and (but for LaTeX) figure to a file whose ending says the format.

        Parameters
        ----------
        path : path-like
            Ends in .html, .tex (a fragment that needs booktabs) or .docx.
        digits : int
            Least number of decimals: estimates have as many as their errors ask for; p-values have
        three.

        Returns
        -------
        pathlib.Path

        Raises
        ------
        ValueError
            If the ending is another one, or a label holds a control character.
        """
        path = Path(path)
        kind = one_of(
            f"the ending of {shown(path.name)}", path.suffix.lower(), (".html", ".tex", ".docx")
        )
        tables = {title: _printed(table, digits) for title, table in self.tables.items()}
        _refuse_control_characters(self.text, tables)
        if kind == ".docx":
            _write_word(path, self, tables)
        else:
            make = _html if kind == ".html" else _latex
            path.write_text(make(self, tables), encoding="utf-8")
        return path

    def _repr_html_(self) -> str:
        return _html(
            self, {title: _printed(table, 2) for title, table in self.tables.items()}, figure=False
        )


def report(
    frame: Any,
    dv: Hashable = None,
    within: Any = None,
    subject: Hashable = None,
    thresholds: Mapping[Hashable, Any] | None = None,
    **options: Any,
) -> StudyReport:
    """
    Analyse one measure and write its Results section; or put any result into the same form.

    Parameters
    ----------
    frame : pandas.DataFrame, result or dict of results
        Long table. Without `dv`: a result of this package with `.table()`, or a table of results,
        as it is; or results by name, as fits by participant, which become one table.
    thresholds : mapping, optional
        With fits by name: what `choose_thresholds` returned for each, printed beside its fit.
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
        As `repeated_measures` does, or if there is neither a measure to analyse nor a result.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> study = tl.report(frame, dv="value", within="condition", subject="subject")
    >>> study.result.n, study.result.k
    (36, 5)
    """
    if isinstance(frame, Mapping):
        return _side_by_side(frame, thresholds or {})
    result = frame if dv is None else repeated_measures(frame, dv, within, subject, **options)
    if isinstance(result, RepeatedMeasures):
        return _section(result)
    if not isinstance(result, pd.DataFrame) and not hasattr(result, "table"):
        raise ValueError(
            "frame must be a table with dv=, within=, subject=, or a result, got "
            f"{type(frame).__name__}"
        )
    table = result if isinstance(result, pd.DataFrame) else result.table()
    title = "Results" if table is result else _words_of(type(result).__name__)
    return StudyReport(result, _sentences(result), {title: table}, _origin(result, table))


def _side_by_side(
    results: Mapping[Hashable, Any], thresholds: Mapping[Hashable, Any]
) -> StudyReport:
    """Return results of one kind as one table, a row for each: estimates with standard errors."""
    if not results:
        raise ValueError("frame is an empty dict: give results by name")
    if thresholds and set(thresholds) != set(results):
        raise ValueError(
            f"thresholds are of {', '.join(map(str, thresholds))}, but the results of "
            f"{', '.join(map(str, results))}: give one for each"
        )
    tables = {name: result.table() for name, result in results.items()}
    rows = {name: table.reset_index() for name, table in tables.items()}
    whole = (
        pd.concat(rows, names=["of"]).reset_index(level="of").drop(columns="index", errors="ignore")
    )
    whole = whole.reset_index(drop=True)
    origins = {_origin(result, tables[name]) for name, result in results.items()} - {""}
    text = " ".join(
        f"{name}: {_sentences(result)}" for name, result in results.items() if _sentences(result)
    )
    title, printed = "Results", whole
    if {"parameter", "value", "stderr"} <= set(whole):
        title = "Estimates ± standard errors"
        estimates = {name: _estimates(result) for name, result in results.items()}
        texts = _printed(pd.concat(estimates, names=["of", "parameter"]), 2)
        errors = texts[_WORDS["stderr"]].replace("", "–")
        texts["cell"] = texts["value"] + " ± " + errors
        by_result = texts.groupby("of", sort=False)
        columns = {name: part.set_index("parameter")["cell"] for name, part in by_result}
        printed = pd.DataFrame(columns).T.rename_axis("of")
        if thresholds:
            title += ", and thresholds"
            printed = printed.join(_chosen(thresholds))
        printed = printed.reset_index().rename_axis(columns=None)
    return StudyReport(whole, text, {title: printed}, ", ".join(origins))


def _estimates(result: Any) -> pd.DataFrame:
    """Return value and stderr by parameter: time constants for a, nothing derived from others."""
    table = result.table()
    if not isinstance(result, FitResult):
        return table[["value", "stderr"]]
    table = table.loc[table["status"] != "derived", ["value", "stderr"]]
    if isinstance(result.model, TscModel | HumanModel | RobotModel):
        for name in table.index.intersection(_TIMES):
            a, error = table.loc[name]
            seconds = -result.runs[0].step / np.log(a)
            table.loc[name] = seconds, -error * seconds / (a * np.log(a))
        table = table.rename(index=_TIMES)
    return table


def _chosen(thresholds: Mapping[Hashable, Any]) -> pd.DataFrame:
    """Return a row of texts for each choice; a fit's has no probability."""
    rows = {}
    for name, choice in thresholds.items():
        rows[name] = {"TSC_l": apa_number(choice.lower, 3), "TSC_u": apa_number(choice.upper, 3)}
        rows[name]["offered"] = "yes" if choice.offered else "no"
        if not np.isnan(choice.probability):
            rows[name]["probability"] = f"{choice.probability:.2f}"
    return pd.DataFrame.from_dict(rows, orient="index")


def _sentences(result: Any) -> str:
    """Return what a result says of itself: its sentences, or that a fit failed, and why."""
    if hasattr(result, "apa"):
        return result.apa()
    if getattr(result, "success", True):
        return ""
    return f"The fit failed, and its estimates are not to be used: {result.message}"


def _origin(result: Any, table: pd.DataFrame) -> str:
    synthetic = "synthetic data" if getattr(result, "synthetic", False) else ""
    return getattr(result, "origin", "") or table.attrs.get("origin", "") or synthetic


def _words_of(name: str) -> str:
    """Return a class's name in words: "FitResult" is "Fit result"."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).capitalize()


def _section(result: RepeatedMeasures) -> StudyReport:
    """Return the Results section of an analysis of variance."""
    if result.design.one_way:
        factors: list[Hashable] = ["condition"]
        pairs = {"Pairwise comparisons": result.pairs()}
    else:
        factors = [*result.within, *result.between]
        pairs = {f"Pairwise comparisons of {name}": result.pairs(name) for name in factors}
    # levels that are numbers are not rounded
    moments = result.descriptives().astype(dict.fromkeys(factors, str))
    columns = [name for name in moments if name in factors or name in _MOMENTS]
    tables = {"Descriptive statistics": moments[columns].rename(columns=_MOMENTS)}
    tables |= {"Analysis of variance": result.table()[list(_TESTS)].rename(columns=_TESTS)}
    tables |= {title: table[list(_PAIRS)] for title, table in pairs.items()}
    return StudyReport(result, " ".join([result.apa(), *result.notes]), tables, result.origin)


def _printed(table: pd.DataFrame, digits: int) -> pd.DataFrame:
    """Return a table with the roundings of a paper; one wide row becomes a column."""
    named = table.reset_index() if table.index.names != [None] else table
    texts = apa_table(named.rename(columns=str).rename_axis(columns=None), digits)
    texts = texts.astype(object).where(texts.notna(), "").map(str)
    texts = texts.rename(columns=lambda name: _WORDS.get(name, name))
    if len(texts) == 1 and texts.shape[1] > _WIDE:
        return texts.T.reset_index().set_axis(["statistic", "value"], axis=1)
    return texts


def _refuse_control_characters(text: str, tables: dict[str, pd.DataFrame]) -> None:
    """Refuse what neither XML nor LaTeX can hold, and what no reader could see."""
    cells = [cell for table in tables.values() for cell in [*table, *table.to_numpy().ravel()]]
    for words in [*cells, *tables, text]:
        if any(unicodedata.category(sign) == "Cc" and sign not in "\n\t" for sign in words):
            raise ValueError(
                f"{words[:60]!r} holds a control character, which no document can show; rename "
                "the level or column in the data"
            )


def _html(study: StudyReport, tables: dict[str, pd.DataFrame], figure: bool = True) -> str:
    parts = [f"<p>{html.escape(study.text)}</p>"] if study.text else []
    for number, (title, table) in enumerate(tables.items(), start=1):
        caption = f"<p><b>Table {number}</b><br><i>{html.escape(_caption(study, title))}</i></p>"
        parts += [caption, _in_words(table).to_html(index=False, border=0)]
    if figure and study.drawn:
        drawing = io.StringIO()
        _drawn(study, drawing, "svg")
        parts.append(drawing.getvalue()[drawing.getvalue().index("<svg") :])
    return "\n".join(parts)


def _in_words(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with heads, and names of parameters, in words instead of identifiers."""
    words = table.rename(columns=_word)
    if "parameter" in table:
        words["parameter"] = table["parameter"].map(_word)
    return words


def _word(name: str) -> str:
    return _PLAIN.get(name, name.replace("_", " "))


def _latex(study: StudyReport, tables: dict[str, pd.DataFrame]) -> str:
    with extra("reports"):
        import jinja2  # noqa: F401  what pandas writes LaTeX with
    parts = [_latex_words(study.text)]
    for title, table in tables.items():
        cells = table.map(lambda cell: cell.translate(_LATEX)).rename(columns=_latex_head)
        if "parameter" in table:
            cells["parameter"] = table["parameter"].map(_latex_head)
        parts.append(
            cells.to_latex(
                index=False, escape=False, caption=_caption(study, title).translate(_LATEX)
            )
        )
    return "\n\n".join(parts)


def _latex_words(text: str) -> str:
    """Return sentences for LaTeX, with effect sizes in mathematics."""
    words = text.translate(_LATEX)
    for name in ("ηp²", "ηG²", "d_z"):
        words = words.replace(name.translate(_LATEX), _MATHEMATICS[name])
    return words


def _latex_head(name: str) -> str:
    """Return the head of a column, in mathematics where it is a symbol, else in words."""
    return _MATHEMATICS.get(name, str(name).replace("_", " ").translate(_LATEX))


def _write_word(path: Path, study: StudyReport, tables: dict[str, pd.DataFrame]) -> None:
    with extra("reports"):
        import docx
    document = docx.Document()
    if study.text:
        document.add_paragraph(study.text)
    for number, (title, table) in enumerate(tables.items(), start=1):
        document.add_paragraph(f"Table {number}. {_caption(study, title)}")
        table = _in_words(table)
        grid = document.add_table(rows=1 + len(table), cols=table.shape[1])
        for i, row in enumerate([list(map(str, table.columns)), *table.to_numpy().tolist()]):
            for j, cell in enumerate(row):
                grid.cell(i, j).text = cell
    if study.drawn:
        picture = io.BytesIO()
        _drawn(study, picture, "png")
        document.add_picture(picture)
    document.save(str(path))


def _caption(study: StudyReport, title: str) -> str:
    origin = f" [{study.origin}]" if study.origin else ""
    return f"{title}{origin}"


def _drawn(study: StudyReport, file: Any, kind: str) -> None:
    """Draw the figure into a file, and close it."""
    import matplotlib.pyplot as plt

    axes = study.plot()
    axes.figure.savefig(file, format=kind, dpi=200)
    plt.close(axes.figure)
