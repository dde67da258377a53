"""The Results section of a paper: sentences, tables and a figure, written to HTML or LaTeX."""

import html
import io
import os
import re
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.thresholds import ThresholdChoice
from trustlab.models.checks import of_class, one_of, shown
from trustlab.models.display import Result
from trustlab.models.extras import extra
from trustlab.models.files import path_of, writing
from trustlab.studies.repeated_measures import RepeatedMeasures, repeated_measures
from trustlab.studies.words import apa_number, in_words, left_out, printed

# What LaTeX has no letter for, or would misread; longer signs first.
_LATEX = {"ηp²": r"$\eta_p^2$", "ηG²": r"$\eta_G^2$", "d_z": "$d_z$", "²": "$^2$", "−": "$-$"}
_LATEX |= {"±": r"$\pm$", "≥": r"$\geq$", "×": r"$\times$", "η": r"$\eta$", "χ": r"$\chi$"}
_LATEX |= {"ε": r"$\varepsilon$", "τ": r"$\tau$", "α": r"$\alpha$", "β": r"$\beta$"}
_LATEX |= {"–": "--", "≤": r"$\leq$"}
_LATEX |= {"<": "$<$", ">": "$>$", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_LATEX |= {"\\": r"\textbackslash "} | {sign: f"\\{sign}" for sign in "&%$#_{}"}
# What is printed of an analysis of variance.
DESCRIBED = ["n", "mean", "sd", "ci_low", "ci_high"]
TESTED = ["effect", "F", "df1_corrected", "df2_corrected", "p_corrected", "eta2_partial"]
TESTED += ["eta2_partial_low", "eta2_partial_high", "eta2_generalized", "correction"]
# Columns beyond which the one row of a result is printed as a column.
_WIDE = 8


@dataclass(frozen=True, eq=False, repr=False)
class StudyReport(Result):
    """
    The Results section of one measure, or any result in the form of one.

    Parameters
    ----------
    result : object
        The analysis, or a table.
    message : str
        Its sentences: test with its correction, effect sizes, means, pairs, exclusions, and what to
        know before using them; empty where the result has none.
    tables : dict of str to pandas.DataFrame
        Descriptive statistics, analysis of variance and pairwise comparisons by title; or the
        result's own table; unrounded.
    origin : str
        What kind of data these are where they were not measured; else empty.
    """

    result: Any
    message: str
    tables: dict[str, pd.DataFrame]
    origin: str

    @property
    def title(self) -> str:
        """The origin, where data were not measured."""
        return f"Report [{self.origin}]" if self.origin else "Report"

    def table(self) -> pd.DataFrame:
        """Return what `result.table()` does, or the table itself."""
        return _table_of(self.result)

    def write(self, path: str | os.PathLike) -> Path:
        """
        Write text, tables and (in HTML, of an analysis of variance) the figure to a file.

        Estimates have as many decimals as their errors ask for, at least two; p-values have three.

        Parameters
        ----------
        path : path-like
            Ends in .html, or .tex (a fragment that needs booktabs).

        Returns
        -------
        pathlib.Path

        Raises
        ------
        ValueError
            If the ending is another one, or the place cannot be written to.
        """
        path = path_of("path", path)
        kind = one_of(f"the end of path {shown(path.name)}", path.suffix.lower(), (".html", ".tex"))
        tables = {
            title if self.origin in title else f"{title} [{self.origin}]": printed(table)
            for title, table in self.tables.items()
        }
        if kind == ".html":
            parts = ['<meta charset="utf-8">', f"<p>{html.escape(self.message)}</p>"]
            for number, (title, table) in enumerate(tables.items(), start=1):
                caption = f"<p><b>Table {number}</b><br><i>{html.escape(title)}</i></p>"
                parts += [caption, table.to_html(index=False, border=0)]
            if isinstance(self.result, RepeatedMeasures):
                import matplotlib.pyplot as plt

                drawing, figure = io.StringIO(), self.result.plot().figure
                figure.savefig(drawing, format="svg")
                plt.close(figure)
                # Without the declarations of a file.
                parts.append("".join(drawing.getvalue().partition("<svg")[1:]))
        else:
            with extra("reports"):
                import jinja2  # noqa: F401  what pandas writes LaTeX with
            parts = [_in_latex(self.message)]
            for title, table in tables.items():
                cells = table.map(_in_latex).rename(columns=_in_latex)
                parts += ["", cells.to_latex(index=False, caption=_in_latex(title))]
        with writing(path):
            path.write_text("\n".join(parts), encoding="utf-8")
        return path


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
        Passed on to `repeated_measures`: between, covariates, missing, order, correction, alpha.

    Returns
    -------
    StudyReport

    Raises
    ------
    ValueError
        As `repeated_measures` does, if there is neither a measure to analyse nor a result, or if
        thresholds are given beside other results than fits.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> study = tl.report(frame, dv="value", within="condition", subject="subject")
    >>> study.result.n, study.result.k
    (36, 5)
    """
    several = isinstance(frame, Mapping)
    given = {"dv": dv, "within": within, "subject": subject, **options}
    unused = [name for name, value in given.items() if value is not None]
    if unused and (several or dv is None):
        raise ValueError(
            f"{', '.join(unused)}: a result is printed as it is; these are for a table with dv="
        )
    if several:
        return _side_by_side(frame, of_class("thresholds", thresholds or {}, dict))
    if thresholds is not None:
        raise ValueError("thresholds are printed beside fits by name: give frame={name: fit, …}")
    result = frame if dv is None else repeated_measures(frame, dv, within, subject, **options)
    if isinstance(result, RepeatedMeasures):
        labels = ["condition"] if result.one_way else [*result.between, *result.within]
        tables = {
            "Descriptive statistics": result.descriptives()[[*labels, *DESCRIBED]],
            "Analysis of variance": result.tests[TESTED],
        }
        for factor in (*result.within, *result.between):
            of_factor = "" if result.one_way else f" of {factor}"
            pairs = result.pairs(factor).drop(columns=["level", "d_av"], errors="ignore")
            tables[f"Pairwise comparisons{of_factor}"] = pairs
        return StudyReport(result, result.message, tables, result.origin)
    table = _table_of(result)
    origin, title = _origin(result, table), getattr(result, "title", "Results")
    if len(table) == 1 and table.shape[1] > _WIDE:
        table = printed(table).T.reset_index().set_axis(["statistic", "value"], axis=1)
    return StudyReport(result, _sentences(result), {title: table}, origin)


def _table_of(result: Any) -> pd.DataFrame:
    if isinstance(result, pd.DataFrame):
        return result
    if not hasattr(result, "table"):
        raise ValueError(
            "frame must be a table with dv=, within=, subject=, or a result, got "
            f"{type(result).__name__}"
        )
    return result.table()


def _side_by_side(
    results: Mapping[Hashable, Any], thresholds: Mapping[Hashable, Any]
) -> StudyReport:
    """Return results of one kind as one table; of fits a row for each: estimates with errors."""
    if not results or (thresholds and set(thresholds) != set(results)):
        raise ValueError(
            f"frame is a dict of results, {shown([*results])}, and thresholds must have one for "
            f"each, got {shown([*thresholds])}"
        )
    tables = {name: _table_of(result) for name, result in results.items()}
    whole = pd.concat(tables, names=["of"])
    origins = {_origin(result, whole) for result in results.values()} - {""}
    said = {name: _sentences(result) for name, result in results.items()}
    text = " ".join(f"{name}: {sentences}" for name, sentences in said.items() if sentences)
    analyses = all(isinstance(result, RepeatedMeasures) for result in results.values())
    title, table = "Results", whole[TESTED] if analyses else whole
    if table.index.names[-1] is None:
        table = table.droplevel(-1)
    fits = {"value", "stderr"} <= {*whole}
    if thresholds and not fits:
        raise ValueError("thresholds are printed beside fits; frame holds other results")
    if fits:
        title = "Estimates ± standard errors" + (", and thresholds" if thresholds else "")
        rows = []
        for name, fit in results.items():
            failed = " (the fit failed)" * (not getattr(fit, "success", True))
            row, estimates = {"of": f"{name}{failed}"}, tables[name]
            names = estimates.index[estimates.get("status", estimates["value"]) != "derived"]
            # Time constants, in the place of what they are derived from.
            times = {name: f"{name.removesuffix('a')}time_constant" for name in names}
            names = [time if time in estimates.index else name for name, time in times.items()]
            texts = printed(estimates.loc[names, ["value", "stderr"]]).replace("", "–")
            cells = texts["value"] + " ± " + texts["standard error"]
            row |= dict(zip(map(in_words, names), cells, strict=True))
            if thresholds:
                choice = of_class("thresholds", thresholds[name], ThresholdChoice)
                row["TSC_l"] = apa_number(choice.lower, 3)
                row["TSC_u"] = apa_number(choice.upper, 3)
                row["offered"] = "yes" if choice.offered else "no"
                if not np.isnan(choice.probability):  # a fit has none
                    row["probability"] = f"{choice.probability:.2f}"
            rows.append(row)
        table = pd.DataFrame(rows).fillna("")
    return StudyReport(whole, text, {title: table}, ", ".join(sorted(origins)))


def _sentences(result: Any) -> str:
    """
    Return what a result says of itself: its sentences, whom a table leaves out, or that a fit
    failed, and why.
    """
    if isinstance(result, pd.DataFrame):
        return left_out(result.attrs.get("excluded", ())).strip()
    if hasattr(result, "apa"):
        return result.apa()
    if getattr(result, "success", True):
        return ""
    return f"The fit failed, and its estimates are not to be used: {result.message}"


def _origin(result: Any, table: pd.DataFrame) -> str:
    origin = getattr(result, "origin", "") or table.attrs.get("origin", "")
    return origin or ("synthetic data" if getattr(result, "synthetic", False) else "")


def _in_latex(text: str) -> str:
    """Return words for LaTeX."""
    return re.sub("|".join(map(re.escape, _LATEX)), lambda sign: _LATEX[sign[0]], text)
