"""
What the dissertation prints, as strings: models, tables, studies, and what became of each claim.

A within-subject study has every number as a string, so that "0.50" keeps its two decimals.
"""

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import combinations
from typing import Any

import pandas as pd

from trustlab.models.checks import (
    flag,
    list_of,
    one_of,
    set_checked,
    shown,
    table_of,
    text_of,
    whole_number,
)
from trustlab.models.published import (
    ByName,
    published_folder,
    published_models as published_models,
    published_table as published_table,
)
from trustlab.reproduction.printed import printed_decimal, printed_interval


@cache
def published_facts(name: str) -> dict:
    """Return what a TOML file of data/published says; it is read once and must not be changed."""
    return tomllib.loads((published_folder() / f"{name}.toml").read_text(encoding="utf-8"))


# What a study may print of each test.
STATISTICS = {
    "mauchly": ("chi2", "df", "p"),
    "anova": ("F", "df1", "df2", "p", "eta2"),
    "t_test": ("t", "df", "p"),
}

# The fields that hold printed numbers by name.
PRINTED = ("mean", "sd", *STATISTICS, "pairs")


class PublishedStudyError(ValueError):
    """A printed study with a field that is missing or no number; the message names it."""


@dataclass(frozen=True, eq=False)
class PublishedStudy:
    """
    The printed results of one measure in one within-subject study.

    Parameters
    ----------
    name : str
        What to call it, for example "uav.tlx".
    n : int
        Number of subjects (of rows of the analysis).
    mean, sd : mapping of str to str
        Printed means and standard deviations by condition.
    conditions : tuple of str
        All conditions in order; those without a printed mean or standard deviation are inferred.
        Those of `mean`, then those of `sd`, unless given.
    anova : mapping of str to str
        Any of F, df1, df2, p, eta2 (partial).
    mauchly : mapping of str to str
        Any of chi2, df, p.
    epsilon : str
        Greenhouse-Geisser epsilon.
    t_test : mapping of str to str
        Any of t, df, p, for two conditions.
    pairs : mapping of str to str
        p-values of pairwise comparisons, keys such as "C1-C2".
    significant_without_p : tuple of str
        Pairs reported as significant (p < 0.05) without a p-value.
    listed_only : bool
        Whether pairs that are not listed were not reported at all. Otherwise they were reported as
        not significant (p > 0.05).
    not_spherical : bool
        Whether the text says that sphericity was violated, without a number for it. A correction
        alone does not: many papers always correct.
    scale : tuple of float
        Lowest and highest value the measure can take; infinite where there is no limit.
    title, where : str
        What it is and where it is printed.

    Raises
    ------
    PublishedStudyError
        If a field is missing or is no printed number; the message names it. A number that cannot
        be is accepted: `feasibility` says what is wrong with it.

    Examples
    --------
    >>> import trustlab as tl
    >>> means, sds = {"A": "2.31", "B": "3.05"}, {"A": "0.84", "B": "0.79"}
    >>> study = tl.PublishedStudy("mine", n=12, mean=means, sd=sds, t_test={"t": "-3.42"})
    >>> tl.reconstruct(study, seed=0).groupby("condition")["value"].mean().round(2).to_dict()
    {'A': 2.31, 'B': 3.05}
    """

    name: str
    n: int
    mean: Mapping[str, str]
    sd: Mapping[str, str]
    conditions: tuple[str, ...] = ()
    anova: Mapping[str, str] = field(default_factory=dict)
    mauchly: Mapping[str, str] = field(default_factory=dict)
    epsilon: str = ""
    t_test: Mapping[str, str] = field(default_factory=dict)
    pairs: Mapping[str, str] = field(default_factory=dict)
    significant_without_p: tuple[str, ...] = ()
    listed_only: bool = False
    not_spherical: bool = False
    scale: tuple[float, float] = (-math.inf, math.inf)
    title: str = ""
    where: str = ""

    how_to_get = "published_studies() has those of the dissertation"

    def __post_init__(self) -> None:
        try:
            self._check()
        except ValueError as error:
            raise PublishedStudyError(f"{self.name}: {error}") from None

    def _check(self) -> None:
        """Check every field; whether a number can be is not checked."""
        set_checked(self, text_of, "name", "title", "where")
        set_checked(self, lambda name, value: whole_number(name, value, least=3), "n")
        set_checked(self, flag, "listed_only", "not_spherical")
        set_checked(self, _printed, *PRINTED)
        if not self.conditions:
            self.__dict__["conditions"] = dict.fromkeys([*self.mean, *self.sd])
        set_checked(self, _names, "conditions", "significant_without_p")
        if len(set(self.conditions)) != self.k or self.k < 2 or not self.mean:
            raise ValueError(
                f"two or more different conditions and a mean are needed, got {[*self.conditions]}"
            )
        for condition in (*self.mean, *self.sd):
            one_of("a condition of mean and sd", condition, self.conditions)
        if self.epsilon:
            printed_decimal(self.epsilon, "epsilon")
        set_checked(self, _scale, "scale")
        named = [self.pair(name) for name in (*self.pairs, *self.significant_without_p)]
        if len(set(named)) < len(named):
            raise ValueError("pairs: a pair was given twice")

    @property
    def k(self) -> int:
        """Number of conditions."""
        return len(self.conditions)

    @property
    def corrected(self) -> bool:
        """Whether the degrees of freedom were multiplied by a printed epsilon."""
        return bool(self.epsilon) or "." in self.anova.get("df1", "")

    @property
    def missing(self) -> tuple[str, ...]:
        """Conditions without a printed mean or standard deviation."""
        return tuple(c for c in self.conditions if c not in self.mean or c not in self.sd)

    def pair(self, name: str) -> tuple[int, int]:
        """
        Return the positions i < j of a pair's two conditions.

        Parameters
        ----------
        name : str
            For example "C1-C2".

        Raises
        ------
        PublishedStudyError
            If it does not name two different conditions.
        """
        for (i, a), (j, b) in combinations(enumerate(self.conditions), 2):
            if isinstance(name, str) and name in (f"{a}-{b}", f"{b}-{a}"):
                return i, j
        raise PublishedStudyError(
            f"pairs: {name!r} does not name two of the conditions {', '.join(self.conditions)}, as "
            f"in {self.conditions[0]}-{self.conditions[1]}"
        )

    def table(self) -> pd.DataFrame:
        """
        Return what is printed, one row per number: index statistic; columns printed, low, high.
        """
        rows = [
            (f"{key}.{name}", text, *printed_interval(text))
            for key in PRINTED
            for name, text in getattr(self, key).items()
        ]
        if self.epsilon:
            rows.append(("epsilon", self.epsilon, *printed_interval(self.epsilon)))
        columns = ["statistic", "printed", "low", "high"]
        return pd.DataFrame(rows, columns=columns).set_index("statistic")


def _printed(key: str, value: object) -> dict[str, str]:
    """Return printed numbers by name."""
    printed = dict(table_of(key, value))
    for name, text in printed.items():
        if key in STATISTICS:
            one_of(f"a statistic of {key}", name, STATISTICS[key])
        printed_interval(text, f"{key}.{name}")
    return printed


def _names(key: str, value: Iterable[str]) -> tuple[str, ...]:
    """Return a list of names as a tuple."""
    return tuple(text_of(f"a name of {key}", name) for name in list_of(key, value))


def _scale(key: str, value: Any) -> tuple[float, float]:
    """Return the ends of a scale, which may be infinite."""
    try:
        low, high = map(float, value)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low < high:
        raise ValueError(
            f"{key} must be the lowest and the highest value, in this order, got {shown(value)}"
        )
    return low, high


def published_studies() -> "dict[str, PublishedStudy]":
    """
    Return the eleven within-subject results printed in Sections 2.4.2.4 and 3.9.4.

    Returns
    -------
    dict of str to PublishedStudy
        By chapter and measure, for example "uav.tlx" and "teleop.trust". The scales are those of
        the instruments.

    Examples
    --------
    >>> import trustlab as tl
    >>> list(tl.published_studies())[:3]
    ['uav.robot_performance', 'uav.utilization', 'uav.human_performance']
    """
    return ByName(
        {
            f"{chapter}.{measure}": PublishedStudy(f"{chapter}.{measure}", **printed)
            for chapter, measures in published_facts("studies").items()
            for measure, printed in measures.items()
        }
    )


# What became of a claim; data/published/verdicts.toml says what each word means.
VERDICTS = (
    "holds",
    "holds with a condition",
    "fails",
    "reproduced",
    "within rounding",
    "differs",
    "reconstructed",
    "not explained by the models",
    "not checkable",
    "diagram",
)


def verdicts(report: str | None = None) -> pd.DataFrame:
    """
    Return what became of every claim of the dissertation.

    Parameters
    ----------
    report : str, optional
        Only the claims that a report shows, such as "allocation"; without diagrams.

    Returns
    -------
    pandas.DataFrame
        Index `claim` in the order of the text: theorems, equations, figures, tables, studies and
        statements; columns says, verdict, why, instead, report and section, empty where there is
        nothing to say.

    Raises
    ------
    ValueError
        If no claim is shown in a report of this name.

    Examples
    --------
    >>> from trustlab.reproduction import verdicts
    >>> verdicts().loc["Theorem 2", "verdict"]
    'fails'
    """
    table = pd.DataFrame.from_dict(published_facts("verdicts"), orient="index").fillna("")
    table = table.rename_axis("claim")
    if report is None:
        return table
    one_of("report", report, sorted({*table["report"]} - {""}))
    return table[(table["report"] == report) & (table["verdict"] != "diagram")]
