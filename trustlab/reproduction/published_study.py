"""
A within-subject study as printed: every number a string, so that "0.50" keeps its two decimals.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from itertools import permutations
from pathlib import Path
from types import MappingProxyType

import pandas as pd

from trustlab.models.checks import of_class, shown, whole_number
from trustlab.reproduction.printed_number import printed_decimal, printed_interval
from trustlab.reproduction.published import ByName, published_folder

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
    scale: tuple[float, float] = (float("-inf"), float("inf"))
    title: str = ""
    where: str = ""

    how_to_get = (
        "PublishedStudy.from_dict builds one, published_studies() has those of the dissertation"
    )

    def __post_init__(self) -> None:
        try:
            self._freeze()
            for check in (_check_design, _check_scale, _check_numbers, _check_pairs):
                check(self)
        except PublishedStudyError:
            raise
        except ValueError as error:
            raise PublishedStudyError(f"{self.name}: {error}") from None

    def _freeze(self) -> None:
        """Replace mappings by read-only copies and lists by tuples."""
        for key in PRINTED:
            value = getattr(self, key)
            if not isinstance(value, Mapping):
                raise ValueError(
                    f"{key} must be a table of names and printed numbers, got {shown(value)}"
                )
            object.__setattr__(self, key, MappingProxyType(dict(value)))
        for key in ("conditions", "significant_without_p"):
            value = getattr(self, key)
            if isinstance(value, str) or not all(isinstance(item, str) for item in value):
                raise ValueError(f"{key} must be a list of names, got {shown(value)}")
            object.__setattr__(self, key, tuple(value))
        if not self.conditions:
            object.__setattr__(self, "conditions", tuple(dict.fromkeys([*self.mean, *self.sd])))

    def __hash__(self) -> int:
        return hash((self.name, self.n, self.conditions, *self.mean.items(), *self.anova.items()))

    def __reduce__(self) -> tuple:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        plain = {key: dict(values[key]) for key in PRINTED}
        return type(self).from_dict, (values | plain,)

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
        for (i, a), (j, b) in permutations(enumerate(self.conditions), 2):
            if name == f"{a}-{b}":
                return min(i, j), max(i, j)
        raise PublishedStudyError(
            f"{self.name}: pairs: {name!r} does not name two of the conditions "
            f"{', '.join(self.conditions)}, as in {self.conditions[0]}-{self.conditions[1]!s}"
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

    @classmethod
    def from_dict(cls, values: Mapping, name: str = "study") -> "PublishedStudy":
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
            If a field is unknown, missing or no printed number.
        """
        if not isinstance(values, Mapping):
            raise PublishedStudyError(
                f"{name}: a published study must be a table of fields, got {values!r}"
            )
        known = [f.name for f in fields(cls)]
        unknown = [str(key) for key in values if key not in known]
        if unknown:
            raise PublishedStudyError(
                f"{name}: unknown field {unknown[0]!r}; there are {', '.join(known)}"
            )
        missing = [key for key in ("n", "mean", "sd") if key not in values]
        if missing:
            raise PublishedStudyError(f"{name}: {missing[0]} is missing")
        return cls(**{"name": name, **values})

    @classmethod
    def from_toml(cls, path: str | Path) -> "dict[str, PublishedStudy]":
        """
        Read the studies of a TOML file; tables may be nested one level, [group.measure].

        Parameters
        ----------
        path : str or path
            The file.

        Raises
        ------
        PublishedStudyError
            If a field of a study is no printed number; the message names both.
        """
        with Path(path).open("rb") as file:
            groups = tomllib.load(file)
        studies: dict[str, Mapping] = {}
        for group, tables in groups.items():
            if isinstance(tables, Mapping) and "mean" not in tables and "n" not in tables:
                studies |= {f"{group}.{key}": values for key, values in tables.items()}
            else:
                studies[group] = tables
        return {key: cls.from_dict(values, key) for key, values in studies.items()}


def _require(holds: object, message: str) -> None:
    if not holds:
        raise ValueError(message)


def _check_design(study: PublishedStudy) -> None:
    """Check the name, the number of subjects and the conditions."""
    named = isinstance(study.name, str) and study.name
    _require(named, f"name must be a text, got {shown(study.name)}")
    object.__setattr__(study, "n", whole_number("n", study.n, least=3))
    for name in ("listed_only", "not_spherical"):
        of_class(name, getattr(study, name), bool, "it must be true or false")
    k, names = study.k, ", ".join(study.conditions)
    _require(len(set(study.conditions)) == k, f"conditions must differ, got {names}")
    _require(k >= 2, f"at least two conditions are needed, got {k}")
    _require(study.mean, "mean has no condition")
    for key in ("mean", "sd"):
        for condition in getattr(study, key):
            where = f"{key}.{condition} is not among the conditions {names}"
            _require(condition in study.conditions, where)


def _check_scale(study: PublishedStudy) -> None:
    """Check the ends of the scale."""
    scale = study.scale
    numbers = isinstance(scale, tuple | list) and len(scale) == 2
    numbers = numbers and all(isinstance(x, int | float) and not isinstance(x, bool) for x in scale)
    _require(
        numbers and scale[0] < scale[1],
        f"scale must be the lowest and the highest value, in this order, got {shown(scale)}",
    )
    object.__setattr__(study, "scale", (float(scale[0]), float(scale[1])))


def _check_numbers(study: PublishedStudy) -> None:
    """Check that every statistic has a known name and is a number; whether it can be is not."""
    for key in PRINTED:
        allowed = STATISTICS.get(key)
        for name, text in getattr(study, key).items():
            hint = "; give epsilon=... beside it" if name == "epsilon" else ""
            _require(
                allowed is None or name in allowed,
                f"{key}.{name} is unknown; there are {', '.join(allowed or ())}{hint}",
            )
            printed_interval(text, f"{key}.{name}")
    if study.epsilon:
        printed_decimal(study.epsilon, "epsilon")


def _check_pairs(study: PublishedStudy) -> None:
    """Check that each pair is named once."""
    seen: dict[tuple[int, int], str] = {}
    for name in (*study.pairs, *study.significant_without_p):
        pair = study.pair(name)
        _require(pair not in seen, f"pairs: {name} was given already, as {seen.get(pair)}")
        seen[pair] = name


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
    return ByName(PublishedStudy.from_toml(published_folder() / "studies.toml"))
