"""A within-subject study as printed: every number a string, so that "0.50" keeps its two decimals."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import MappingProxyType

import pandas as pd

from trustlab.reproduction.published import ByName, published_folder
from trustlab.reproduction.study_checks import PublishedStudyError, check_study, printed_interval

__all__ = ["PublishedStudy", "published_studies"]

CONDITIONS = {
    "uav.satisfaction": ("C1", "C2", "C3", "C4", "C5"),
    "uav.trust": ("C1", "C2", "C3", "C4", "C5"),
}
"""All conditions of the two studies whose printed table lacks one."""

SCALES = {
    "uav.robot_performance": (0.0, 1.0),
    "uav.utilization": (0.0, 1.0),
    "uav.human_performance": (0.0, 1.0),
    "uav.tlx": (0.0, 100.0),
    "uav.satisfaction": (1.0, 7.0),
    "uav.trust": (1.0, 7.0),
    "uav.followed": (0.0, 100.0),
    "teleop.tracking_error": (0.0, float("inf")),
    "teleop.tlx": (0.0, 100.0),
    "teleop.satisfaction": (1.0, 7.0),
    "teleop.trust": (1.0, 7.0),
}
"""Ranges of the measures. The pilot studies name a 1-5 scale for satisfaction; means above 5 need the 1-7 one."""


def _frozen(mapping: Mapping | None) -> Mapping:
    return MappingProxyType(dict(mapping or {}))


@dataclass(frozen=True)
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
        All conditions in order; those without a printed mean or standard deviation are inferred. Those of `mean`, then
        those of `sd`, unless given.
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
        Whether pairs that are not listed were not reported at all. Otherwise they were reported as not significant
        (p > 0.05).
    scale : tuple of float
        Lowest and highest value the measure can take; infinite where there is no limit.
    title, where : str
        What it is and where it is printed.

    Raises
    ------
    PublishedStudyError
        If a field is missing, is no printed number, or cannot be; the message names it.
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
    scale: tuple[float, float] = (float("-inf"), float("inf"))
    title: str = ""
    where: str = ""

    def __post_init__(self) -> None:
        for key in ("mean", "sd", "anova", "mauchly", "t_test", "pairs"):
            value = getattr(self, key)
            if not isinstance(value, Mapping):
                raise PublishedStudyError(
                    f"{self.name}: {key} must be a table of names and printed numbers, got {value!r}"
                )
            object.__setattr__(self, key, _frozen(value))
        for key in ("conditions", "significant_without_p"):
            value = getattr(self, key)
            if isinstance(value, str) or not all(isinstance(item, str) for item in value):
                raise PublishedStudyError(f"{self.name}: {key} must be a list of names, got {value!r}")
            object.__setattr__(self, key, tuple(value))
        if not self.conditions:
            object.__setattr__(self, "conditions", tuple(dict.fromkeys([*self.mean, *self.sd])))
        check_study(self)

    def __hash__(self) -> int:
        return hash((self.name, self.n, self.conditions, tuple(self.mean.items()), tuple(self.anova.items())))

    def __reduce__(self) -> tuple:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        plain = {key: dict(value) if isinstance(value, Mapping) else value for key, value in values.items()}
        return type(self).from_dict, (plain,)

    @property
    def k(self) -> int:
        """Number of conditions."""
        return len(self.conditions)

    @property
    def corrected(self) -> bool:
        """Whether the degrees of freedom were multiplied by a printed epsilon."""
        return bool(self.epsilon) or ("df1" in self.anova and "." in self.anova["df1"])

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
        for i, a in enumerate(self.conditions):
            for j, b in enumerate(self.conditions):
                if i != j and name == f"{a}-{b}":
                    return min(i, j), max(i, j)
        raise PublishedStudyError(
            f"{self.name}: pairs: {name!r} does not name two of the conditions {', '.join(self.conditions)}, as in"
            f" {self.conditions[0]}-{self.conditions[1]!s}"
        )

    def table(self) -> pd.DataFrame:
        """Return what is printed, one row per number: index statistic; columns printed, low, high."""
        rows = [(f"mean.{c}", text) for c, text in self.mean.items()]
        rows += [(f"sd.{c}", text) for c, text in self.sd.items()]
        for key in ("mauchly", "anova", "t_test", "pairs"):
            rows += [(f"{key}.{name}", text) for name, text in getattr(self, key).items()]
        rows += [("epsilon", self.epsilon)] if self.epsilon else []
        table = pd.DataFrame(
            [(name, text, *printed_interval(text)) for name, text in rows],
            columns=["statistic", "printed", "low", "high"],
        )
        return table.set_index("statistic")

    @classmethod
    def from_dict(cls, values: Mapping, name: str = "study") -> PublishedStudy:
        """
        Build a study from a dictionary, such as a table of a TOML file.

        Parameters
        ----------
        values : mapping
            The fields by name; printed numbers as strings.
        name : str
            What to call it, unless `values` has a name.

        Raises
        ------
        PublishedStudyError
            If a field is unknown, missing, or cannot be.
        """
        if not isinstance(values, Mapping):
            raise PublishedStudyError(f"{name}: a published study must be a table of fields, got {values!r}")
        known = [f.name for f in fields(cls)]
        unknown = [str(key) for key in values if key not in known]
        if unknown:
            raise PublishedStudyError(f"{name}: unknown field {unknown[0]!r}; there are {', '.join(known)}")
        for key in ("n", "mean", "sd"):
            if key not in values:
                raise PublishedStudyError(f"{name}: {key} is missing")
        return cls(**{"name": name, **values})

    @classmethod
    def from_toml(cls, path: str | Path) -> dict[str, PublishedStudy]:
        """
        Read the studies of a TOML file; tables may be nested one level, [group.measure].

        Parameters
        ----------
        path : str or path
            The file.

        Raises
        ------
        PublishedStudyError
            If a study cannot be; the message names it and the field.
        """
        with Path(path).open("rb") as file:
            groups = tomllib.load(file)
        studies = {}
        for group, tables in groups.items():
            if isinstance(tables, Mapping) and "mean" not in tables and "n" not in tables:
                studies |= {f"{group}.{key}": values for key, values in tables.items()}
            else:
                studies[group] = tables
        return {key: cls.from_dict(values, key) for key, values in studies.items()}


def published_studies() -> dict[str, PublishedStudy]:
    """
    Return the eleven within-subject results printed in Sections 2.4.2.4 and 3.9.4.

    Returns
    -------
    dict of str to PublishedStudy
        By chapter and measure, for example "uav.tlx" and "teleop.trust". The scales are those of the instruments.
    """
    with (published_folder() / "studies.toml").open("rb") as file:
        groups = tomllib.load(file)
    studies = ByName()
    for group, tables in groups.items():
        for measure, values in tables.items():
            name = f"{group}.{measure}"
            extra = {"scale": SCALES[name]} if name in SCALES else {}
            extra |= {"conditions": CONDITIONS[name]} if name in CONDITIONS else {}
            studies[name] = PublishedStudy.from_dict({**extra, **values}, name)
    return studies
