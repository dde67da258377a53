"""Effects that the dissertation prints or claims, and what the printed models alone predict."""

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
from trustlab.reproduction.published import published_facts, published_models, published_table
from trustlab.reproduction.published_study import published_studies

COLUMNS = ["id", "where", "measure", "contrast", "printed", "low", "high", "p"]


class Effect(NamedTuple):
    """One effect: a difference of two conditions' means, in the unit of the measure."""

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
    """Return all effects that data/published/effects.toml lists."""
    listed = published_facts("effects")
    return (
        *_of_tables(listed["tables"]),
        *_of_studies(listed["studies"]),
        *_of_claims(listed["claims"]),
    )


def _difference(after: str, before: str) -> tuple[float, float, float]:
    """Return the difference of two printed numbers, and its ends within their rounding."""
    (low, high), (lowest, highest) = printed_interval(after), printed_interval(before)
    exact: Decimal = printed_decimal(after) - printed_decimal(before)
    return float(exact), low - highest, high - lowest


def _of_tables(tables: list[dict]) -> Iterator[Effect]:
    for table in tables:
        means = published_table(table["table"])
        where = f"Table {table['table']}"
        study = table["study"]
        for measure, column in table["measures"].items():
            for contrast in table["contrasts"]:
                after, before = contrast.split("-")
                size = _difference(means.loc[after, column], means.loc[before, column])
                yield Effect(
                    f"{study}/{measure}/{contrast}",
                    where,
                    measure,
                    contrast,
                    *size,
                    math.nan,
                    study,
                )


def _of_studies(studies: list[dict]) -> Iterator[Effect]:
    for named in studies:
        study = named["name"].partition(".")[0]
        printed = published_studies()[named["name"]]
        measure = named["measure"]
        for contrast in named["contrasts"]:
            after, before = contrast.split("-")
            text = printed.pairs.get(f"{before}-{after}") or printed.pairs.get(f"{after}-{before}")
            text = text or (printed.t_test or {}).get("p")
            p = (
                printed_interval(text)[1]
                if text and text.startswith("<")
                else float(text)
                if text
                else math.nan
            )
            size = _difference(printed.mean[after], printed.mean[before])
            yield Effect(
                f"{study}/{measure}/{contrast}", printed.where, measure, contrast, *size, p, study
            )


def _of_claims(claims: list[dict]) -> Iterator[Effect]:
    for claim in claims:
        low, high = (0.0, math.inf) if claim["sign"] > 0 else (-math.inf, 0.0)
        where = claim["where"]
        measure = claim["measure"]
        contrast = claim["contrast"]
        id = f"{claim['id']}/{measure}/{contrast}"
        yield Effect(id, where, measure, contrast, math.nan, low, high, math.nan, claim["study"])


def printed_effects() -> pd.DataFrame:
    """
    Return every effect that the dissertation prints or claims, a row each.

    Returns
    -------
    pandas.DataFrame
        Columns id; where; measure (p_r, p_h, r, tlx, satisfaction, trust, followed_percent or error
        [m]); contrast, "C3-C1" for C3 minus C1; printed, the difference of the printed means in the
        unit of the measure, NaN where only a sign is claimed; low, high, what rounding leaves room
        for, or the half-line that is claimed; p, as printed (an inequality's bound), NaN where none
        is.

    Examples
    --------
    >>> import trustlab as tl
    >>> effect = tl.printed_effects().set_index("id").loc["table_2.4/tlx/C2-C1"]
    >>> effect[["printed", "low", "high"]].astype(float).round(2).tolist()
    [-3.61, -3.62, -3.6]
    """
    return pd.DataFrame([effect[: len(COLUMNS)] for effect in effects()], columns=COLUMNS)


FREE = "in C2 and C4 it depends on which suggestions people follow, which no model says"
NO_MODEL = "no model of anyone in this study is printed"
NOT_MODELLED = "(2.1)-(2.6) say nothing of this measure"
# Samples of the model's motion; the second half counts.
STEPS = 200_000


def model_effects() -> pd.DataFrame:
    """
    Return what the printed models predict of every effect, by (2.8) and Algorithm 2.

    For the five participants of Section 2.4.1, (2.1)-(2.6) with the numbers of Table 2.1 are run
    under the thresholds captured in C1 (Table 2.3), under those suggested in C3 (Table 2.2), and
    under Algorithm 2 (C5), and means of the second half of 200,000 samples are compared. Model
    performance is momentary, where the measured one is a mean over 100 s; nobody reacts late.

    Returns
    -------
    pandas.DataFrame
        Columns id, where, measure, contrast, printed, low, high, p as `printed_effects`; model, the
        mean over the five; model_low, model_high, the least and greatest of them; reason, why there
        is none where they are NaN.

    Examples
    --------
    >>> import trustlab as tl
    >>> effects = tl.model_effects()
    >>> effects.columns[:8].equals(tl.printed_effects().columns)
    True
    """
    rows = []
    for effect in effects():
        predicted, reason = (math.nan, math.nan, math.nan), ""
        if effect.study != "table_2.5":
            reason = NOT_MODELLED if effect.study in ("table_2.4", "table_2.6") else NO_MODEL
        elif set(effect.conditions) & {"C2", "C4"}:
            reason = FREE
        else:
            after, before = (
                model_means(condition)[effect.measure] for condition in effect.conditions
            )
            difference = after - before
            predicted = float(difference.mean()), float(difference.min()), float(difference.max())
        rows.append((*effect[: len(COLUMNS)], *predicted, reason))
    return pd.DataFrame(rows, columns=[*COLUMNS, "model", "model_low", "model_high", "reason"])


@cache
def model_means(condition: str) -> pd.DataFrame:
    """
    Return mean p_r, p_h and r of the five participants' models under C1, C3 or C5: a row each.
    """
    captured, chosen = published_table("2.3"), published_table("2.2")
    rows = []
    for label in "12345":
        model = published_models()[label]
        if condition == "C5":
            motion = simulate_allocation(
                model, rule=PerformanceRule(model.robot.p_min, model.robot.p_max), steps=STEPS
            )
        else:
            lower, upper = (
                (
                    captured.loc[(name, "mean"), label]
                    if condition == "C1"
                    else chosen.loc[name, label]
                )
                for name in ("TSC_l", "TSC_u")
            )
            motion = simulate_allocation(model, float(lower), float(upper), steps=STEPS)
        rows.append(motion[["p_r", "p_h", "r"]].iloc[STEPS // 2 :].mean())
    return pd.DataFrame(rows, index=list("12345"), dtype=np.float64)
