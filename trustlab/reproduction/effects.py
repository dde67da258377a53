"""Every effect that the dissertation prints or claims of people and robots, and what the printed models alone predict."""

import math
from collections.abc import Iterator
from decimal import Decimal
from functools import cache
from typing import NamedTuple

import numpy as np
import pandas as pd

from trustlab.allocation.rules import PerformanceRule
from trustlab.allocation.simulation import simulate_allocation
from trustlab.reproduction.printed_number import printed_decimal, printed_interval
from trustlab.reproduction.published import published_models, published_table
from trustlab.reproduction.published_study import published_studies

COLUMNS = ["id", "where", "measure", "contrast", "printed", "low", "high", "p"]

ALLOCATED = ("C2-C1", "C3-C1", "C4-C1", "C5-C1")
TABLES = {
    "table_2.4": ("Table 2.4", "2.4", {"tlx": "tlx", "satisfaction": "satisfaction", "trust": "trust"}, ALLOCATED[:2]),
    "table_2.5": ("Table 2.5", "2.5", {"p_r": "P_r", "p_h": "P_h", "r": "r"}, (*ALLOCATED, "C5-C3")),
    "table_3.1": (
        "Table 3.1",
        "3.1",
        {"error": "error", "satisfaction": "preference", "tlx": "tlx", "trust": "trust"},
        ("TMIG-M", "TMIG-MMI"),
    ),
}
"""Where, number, measures with the beginnings of their columns, and contrasts of the printed tables of means."""

STUDIES = {
    "uav.robot_performance": ("p_r", (*ALLOCATED, "C4-C2", "C4-C3")),
    "uav.utilization": ("r", ALLOCATED),
    "uav.human_performance": ("p_h", ALLOCATED),
    "uav.tlx": ("tlx", ("C3-C1", "C3-C2", "C3-C4", "C3-C5")),
    "uav.satisfaction": ("satisfaction", ("C3-C1", "C3-C4", "C3-C5")),
    "uav.trust": ("trust", ("C3-C2", "C3-C4", "C3-C5")),
    "uav.followed": ("followed_percent", ("C2-C4",)),
    "teleop.tracking_error": ("error", ("OMI-M", "MMI-M", "TMIG-M", "OMI-MMI", "TMIG-MMI")),
    "teleop.tlx": ("tlx", ("OMI-M", "TMIG-M", "TMIG-MMI")),
    "teleop.satisfaction": ("satisfaction", ("OMI-M", "MMI-M", "TMIG-M", "TMIG-MMI")),
    "teleop.trust": ("trust", ("MMI-M", "TMIG-M", "TMIG-OMI")),
}
"""Measure and contrasts of the studies with printed tests: those of studies.toml."""

CLAIMS = (
    ("abstract", "Abstract", "uav", "p_r", "C3-C1", 1),
    ("abstract", "Abstract", "uav", "tlx", "C3-C1", -1),
    ("abstract", "Abstract", "teleop", "error", "TMIG-M", -1),
    ("section_2.6", "Section 2.6", "uav", "satisfaction", "C3-C5", 1),
    ("section_2.6", "Section 2.6", "uav", "trust", "C3-C5", 1),
    ("section_5.2", "Section 5.2", "uav", "p_r", "C5-C3", 1),
)
"""Claims of a sign without a size: where, in which study, measure, contrast, sign."""


class Effect(NamedTuple):
    """One effect: a difference of two conditions' means in one study, printed in the unit of the measure."""

    id: str
    where: str
    measure: str
    contrast: str
    printed: float
    low: float
    high: float
    p: float
    study: str

    @property
    def conditions(self) -> tuple[str, str]:
        """The condition that is compared, and the one that it is compared with."""
        after, _, before = self.contrast.partition("-")
        return after, before


@cache
def effects() -> tuple[Effect, ...]:
    """Return all effects, in the order of the text."""
    return (*_of_tables(), *_of_studies(), *_of_claims())


def _difference(after: str, before: str) -> tuple[float, float, float]:
    """Return the difference of two printed numbers, and the least and greatest that rounding leaves room for."""
    (low, high), (lowest, highest) = printed_interval(after), printed_interval(before)
    exact: Decimal = printed_decimal(after) - printed_decimal(before)
    return float(exact), low - highest, high - lowest


def _of_tables() -> Iterator[Effect]:
    for study, (where, number, measures, contrasts) in TABLES.items():
        table = published_table(number)
        for measure, column in measures.items():
            for contrast in contrasts:
                after, before = contrast.split("-")
                size = _difference(table.loc[after, f"{column}_mean"], table.loc[before, f"{column}_mean"])
                yield Effect(f"{study}/{measure}/{contrast}", where, measure, contrast, *size, math.nan, study)
    shares = published_table("2.6")["mean"]
    size = _difference(shares["C2"], shares["C4"])
    yield Effect(
        "table_2.6/followed_percent/C2-C4", "Table 2.6", "followed_percent", "C2-C4", *size, math.nan, "table_2.6"
    )


def _of_studies() -> Iterator[Effect]:
    for name, (measure, contrasts) in STUDIES.items():
        study, printed = name.partition(".")[0], published_studies()[name]
        for contrast in contrasts:
            after, before = contrast.split("-")
            text = printed.pairs.get(f"{before}-{after}") or printed.pairs.get(f"{after}-{before}")
            text = text or (printed.t_test or {}).get("p")
            p = printed_interval(text)[1] if text and text.startswith("<") else float(text) if text else math.nan
            size = _difference(printed.mean[after], printed.mean[before])
            yield Effect(f"{study}/{measure}/{contrast}", printed.where, measure, contrast, *size, p, study)


def _of_claims() -> Iterator[Effect]:
    for prefix, where, study, measure, contrast, sign in CLAIMS:
        low, high = (0.0, math.inf) if sign > 0 else (-math.inf, 0.0)
        yield Effect(f"{prefix}/{measure}/{contrast}", where, measure, contrast, math.nan, low, high, math.nan, study)


def printed_effects() -> pd.DataFrame:
    """
    Return every effect that the dissertation prints or claims, a row each.

    Returns
    -------
    pandas.DataFrame
        Columns id; where; measure (p_r, p_h, r, tlx, satisfaction, trust, followed_percent or error [m]); contrast, "C3-C1" for C3 minus
        C1; printed, the difference of the printed means in the unit of the measure, NaN where only a sign is claimed; low, high, what
        rounding leaves room for, or the half-line that is claimed; p, as printed (an inequality's bound), NaN where none is.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.printed_effects().set_index("id").loc["table_2.4/tlx/C2-C1", ["printed", "low", "high"]].round(2).tolist()
    [-3.61, -3.62, -3.6]
    """
    return pd.DataFrame([effect[: len(COLUMNS)] for effect in effects()], columns=COLUMNS)


FREE = "in C2 and C4 it depends on which suggestions people follow, which no model says"
NO_MODEL = "no model of anyone in this study is printed"
NOT_MODELLED = "(2.1)-(2.6) say nothing of this measure"
STEPS = 200_000
"""Samples of the model's motion; the second half counts."""


def model_effects() -> pd.DataFrame:
    """
    Return what the printed models alone predict of every effect: steady motions under (2.8) and Algorithm 2.

    For the five participants of Section 2.4.1, (2.1)-(2.6) with the numbers of Table 2.1 are run under the thresholds captured in C1
    (Table 2.3), under those suggested in C3 (Table 2.2), and under Algorithm 2 (C5), and means of the second half of 200,000
    samples are compared. Model performance is momentary, where the measured one is a mean over 100 s; nobody reacts late.

    Returns
    -------
    pandas.DataFrame
        Columns id, where, measure, contrast, printed, low, high, p as `printed_effects`; model, the mean over the five; model_low,
        model_high, the least and greatest of them; reason, why there is none where they are NaN.

    Examples
    --------
    >>> import trustlab as tl
    >>> effects = tl.model_effects()
    >>> effects.columns[:8].equals(tl.printed_effects().columns)
    True
    """
    rows = []
    for effect in effects():
        found, reason = (math.nan, math.nan, math.nan), ""
        if effect.study != "table_2.5":
            reason = NOT_MODELLED if effect.study in ("table_2.4", "table_2.6") else NO_MODEL
        elif set(effect.conditions) & {"C2", "C4"}:
            reason = FREE
        else:
            after, before = (model_means(condition)[effect.measure] for condition in effect.conditions)
            difference = after - before
            found = float(difference.mean()), float(difference.min()), float(difference.max())
        rows.append((*effect[: len(COLUMNS)], *found, reason))
    return pd.DataFrame(rows, columns=[*COLUMNS, "model", "model_low", "model_high", "reason"])


@cache
def model_means(condition: str) -> pd.DataFrame:
    """Return mean p_r, p_h and r of the five participants' models under C1, C3 or C5: a row each."""
    own, chosen = published_table("2.3"), published_table("2.2")
    rows = []
    for label in "12345":
        model = published_models()[label]
        if condition == "C5":
            motion = simulate_allocation(model, rule=PerformanceRule(model.robot.p_min, model.robot.p_max), steps=STEPS)
        else:
            lower, upper = (
                (own.loc[(name, "mean"), label] if condition == "C1" else chosen.loc[name, label])
                for name in ("TSC_l", "TSC_u")
            )
            motion = simulate_allocation(model, float(lower), float(upper), steps=STEPS)
        rows.append(motion[["p_r", "p_h", "r"]].iloc[STEPS // 2 :].mean())
    return pd.DataFrame(rows, index=list("12345"), dtype=np.float64)
