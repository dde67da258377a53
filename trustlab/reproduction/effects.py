"""
Every effect that the dissertation prints or claims: as printed, as the printed models alone
predict, and in simulated people under named assumptions about them.
"""

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.allocation.rules import PerformanceRule, simulate_allocation
from trustlab.campaign.run import run_campaign
from trustlab.models.checks import of_class, one_of, whole_number, whole_seed
from trustlab.operators.answers import simulated_answers
from trustlab.operators.ground_robot import ASSUMPTIONS, checked_assumptions
from trustlab.operators.teleoperator import TELEOPERATOR_ASSUMPTIONS
from trustlab.reproduction.printed import printed_decimal, printed_interval
from trustlab.reproduction.published import (
    published_facts,
    published_models,
    published_studies,
    published_table,
)
from trustlab.studies.questionnaires import NASA_TLX
from trustlab.studies.virtual_study import virtual_study
from trustlab.testbeds.deciding import CONDITIONS
from trustlab.testbeds.populations import TeleoperatorPopulation
from trustlab.testbeds.uav_tracking import simulate_teleoperation
from trustlab.trust.driving import TrustInLoop
from trustlab.trust.interface import TrustDynamics

# What every table of effects begins with.
COLUMNS = ["id", "where", "measure", "contrast", "printed", "low", "high", "p"]


@cache
def _effects() -> pd.DataFrame:
    """Return all effects that data/published/effects.toml lists, with their study and testbed."""
    rows: list[tuple] = []
    for study, where, measure, contrasts, means, tests in _compared_means():
        for contrast in contrasts:
            after, before = contrast.split("-")
            (low, high), (least, most) = map(printed_interval, (means[after], means[before]))
            size = float(printed_decimal(means[after]) - printed_decimal(means[before]))
            p = tests.get(f"{before}-{after}") or tests.get(contrast) or tests.get("p", "nan")
            ends = size, low - most, high - least, float(p.removeprefix("<"))
            rows.append((study, where, measure, contrast, *ends, study))
    for claim in published_facts("effects")["claims"]:
        about = claim["where"], claim["measure"], claim["contrast"]
        half_line = sorted((0.0, claim["sign"] * math.inf))
        rows.append((claim["id"], *about, math.nan, *half_line, math.nan, claim["study"]))
    listed = pd.DataFrame(rows, columns=[*COLUMNS, "study"])
    listed["id"] += "/" + listed["measure"] + "/" + listed["contrast"]
    return listed.assign(place=listed["study"].replace(ALLOCATION))


def _compared_means() -> Iterator[tuple]:
    """
    Return study, where, measure, contrasts, printed means and p-values of effects with a size.
    """
    facts = published_facts("effects")
    for table in facts["tables"]:
        printed, where = published_table(table["table"]), f"Table {table['table']}"
        for measure, column in table["measures"].items():
            yield table["study"], where, measure, table["contrasts"], printed[column], {}
    for each in facts["studies"]:
        study, chapter = published_studies()[each["name"]], each["name"].partition(".")[0]
        tests = {**study.t_test, **study.pairs}
        yield chapter, study.where, each["measure"], each["contrasts"], study.mean, tests


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
    return _effects()[COLUMNS].copy()


FREE = "in C2 and C4 it depends on which suggestions people follow, which no model says"
NO_MODEL = "no model of anyone in this study is printed"
NOT_MODELLED = "(2.1)-(2.6) say nothing of this measure"
# Why the models predict nothing of a study, where they do.
WITHOUT = {"table_2.4": NOT_MODELLED, "table_2.5": "", "table_2.6": NOT_MODELLED}
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
    for effect in _effects().itertuples():
        conditions, difference = effect.contrast.split("-"), np.array([math.nan])
        reason = WITHOUT.get(effect.study, NO_MODEL)
        if not reason and {"C2", "C4"} & {*conditions}:
            reason = FREE
        if not reason:
            after, before = (model_means(name)[effect.measure] for name in conditions)
            difference = (after - before).to_numpy()
        rows.append((difference.mean(), difference.min(), difference.max(), reason))
    return printed_effects().join(
        pd.DataFrame(rows, columns=["model", "model_low", "model_high", "reason"])
    )


@cache
def model_means(condition: str) -> pd.DataFrame:
    """
    Return mean p_r, p_h and r of the five participants' models under C1, C3 or C5: a row each.
    """
    thresholds = {"C1": published_table("2.3").xs("mean", level=1), "C3": published_table("2.2")}
    rows = {}
    for label in "12345":
        model = published_models()[label]
        if condition == "C5":
            rule = PerformanceRule(model.robot.p_min, model.robot.p_max)
            motion = simulate_allocation(model, rule=rule, steps=STEPS)
        else:
            lower, upper = thresholds[condition].loc[["TSC_l", "TSC_u"], label].astype(float)
            motion = simulate_allocation(model, lower, upper, steps=STEPS)
        rows[label] = motion[["p_r", "p_h", "r"]].iloc[STEPS // 2 :].mean()
    return pd.DataFrame(rows).T


# Testbeds of the studies under C1–C5.
ALLOCATION = {
    "table_2.4": "ground_robot",
    "table_2.5": "ground_robot",
    "table_2.6": "ground_robot",
    "uav": "uav_following",
}

# Settings, schemes and points of the scale of satisfaction of the studies of Chapter 3.
TELEOPERATION = {
    "table_3.1": ("preliminary", ("M", "MI", "MMI", "TMIG", "TMIS"), 5),
    "teleop": ("main", ("M", "OMI", "MMI", "TMIG"), 7),
}

# The answers that each measure is the mean of.
ANSWERED = {
    "tlx": NASA_TLX.items,
    "satisfaction": ("satisfaction", "comfort", "control"),
    "trust": ("trust",),
}

SIMULATED = ["simulated", "se", "operators", "p_simulated", "agrees", "reason"]
SILENT = (
    "simulated operators answer no questionnaire unless load_utilization or load_switching "
    "is assumed"
)
# Satisfaction was answered from 1 to 5 in Section 2.4.1, and is simulated from 1 to 7.
FIVE_POINTS = 4.0 / 6.0
UNITS = {
    "p_r": "robot performance",
    "p_h": "human performance",
    "r": "utilization",
    "tlx": "task load",
    "error": "tracking error [m]",
    "followed_percent": "suggestions followed [%]",
}


def simulated_effects(
    assumptions: Mapping[str, float] | None = None,
    n: int = 20,
    seed: int = 0,
    *,
    only: str | None = None,
    trust: TrustDynamics | TrustInLoop | None = None,
    n_jobs: int = 1,
) -> pd.DataFrame:
    """
    Return every printed effect beside what simulated people do under named assumptions.

    Studies under C1–C5 are virtual studies on the two testbeds; those of Chapter 3 are runs of
    `simulate_teleoperation` with `simulated_answers`, where an operator flies every scheme on the
    same path, with the same losses of the target. All conditions are within subjects.

    Parameters
    ----------
    assumptions : mapping of str to float, optional
        Any of `trustlab.operators.ASSUMPTIONS`, for the studies under C1–C5, and of
        `TELEOPERATOR_ASSUMPTIONS` beside them, for those of Chapter 3; none, everything off, by
        default.
    n : int
        Operators of every study; under C1–C5 the next multiple of five, so that every condition
        comes equally often first, second …
    seed : int
        Of all operators and runs.
    only : str, optional
        "ground_robot", "uav", "table_2.4", "table_2.5", "table_2.6", "table_3.1" or "teleop".
        The study to simulate, "ground_robot" for that of Tables 2.4 to 2.6; all of them when not
        given. Rows of other studies are then left out.
    trust : TrustDynamics or TrustInLoop, optional
        A model of `trustlab.trust` in place of (3.2) in the runs of Chapter 3.
    n_jobs : int
        Processes, as for `run_campaign`; no effect on results.

    Returns
    -------
    pandas.DataFrame
        Columns id, where, measure, contrast, printed, low, high, p as `printed_effects`; simulated,
        the mean difference; se, its standard error over operators; operators, how many have the
        measure in both conditions; p_simulated, of the paired t-test, not adjusted for the number
        of pairs; agrees, whether simulated ± 2 se meets what is printed, from low to high (missing
        where nothing is simulated); reason, why not. `attrs["origin"]` says that it is simulated,
        `attrs["n"]` how many operators were, by study.

    Raises
    ------
    ValueError
        If an assumption is unknown or out of range, n is below 3, or no chosen study depends on an
        assumption or on a model of trust.

    Examples
    --------
    >>> import trustlab as tl
    >>> assumptions = {"attention_cost": 0.05}
    >>> effects = tl.simulated_effects(assumptions, n=4, seed=0, only="table_2.6", n_jobs=1)
    >>> effects["id"].tolist()
    ['table_2.6/followed_percent/C2-C4']
    """
    n, seed = whole_number("n", n, least=3, most=1_000_000), whole_seed(seed)
    chosen = effects_of(only)
    places = chosen["place"].unique()
    assumed = checked_assumptions(assumptions, assumptions_about(places))
    if trust is not None:
        of_class("trust", TrustInLoop.of(trust), TrustInLoop, "see trust.MODELS")
        if not {*places} & {*TELEOPERATION}:
            raise ValueError(f"trust has no effect on {only}, a study under C1–C5; leave it out")
    squares = len(CONDITIONS) * math.ceil(n / len(CONDITIONS))
    people = {place: n if place in TELEOPERATION else squares for place in places}
    measured = {
        place: _measured(place, assumed, people[place], seed, trust, n_jobs) for place in places
    }
    rows = [_compared(effect, measured[effect.place]) for effect in chosen.itertuples()]
    frame = chosen[COLUMNS].reset_index(drop=True).join(pd.DataFrame(rows, columns=SIMULATED))
    frame["agrees"] = frame["agrees"].astype("boolean")
    about = {"assumptions": assumed, "n": people, "seed": seed}
    frame.attrs = {"origin": "simulated operators", **about}
    return frame


def assumptions_about(studies: Iterable[str]) -> dict[str, tuple]:
    """Return the ranges of all assumptions that have an effect on some of these studies."""
    ranges: dict[str, tuple] = {}
    for study in studies:
        ranges |= TELEOPERATOR_ASSUMPTIONS if study in TELEOPERATION else ASSUMPTIONS
    return ranges


def effects_of(study: str | None, name: str = "only") -> pd.DataFrame:
    """Return the effects of a study, of all studies on the ground robot, or all."""
    listed = _effects()
    if study is None:
        return listed
    one_of(name, study, sorted({*listed["place"], *listed["study"]}))
    return listed[(listed["study"] == study) | (listed["place"] == study)]


def _measured(
    place: str, assumed: dict[str, float], n: int, seed: int, trust: Any, n_jobs: int
) -> pd.DataFrame:
    """Return a study's measures, a row per operator; columns are measure and condition."""
    names = assumptions_about([place])
    assumptions = {name: value for name, value in assumed.items() if name in names}
    if place in TELEOPERATION:
        people = TeleoperatorPopulation(TELEOPERATION[place][0]).draw(n, seed, assumptions)
        task = partial(teleoperate, place=place, trust=trust, answers=seed)
        done = run_campaign(
            task, people.to_dict("records"), seed=seed, n_jobs=n_jobs, progress=False
        )
        flown = done[~done["failed"].to_numpy(bool)].filter(like="/")
        return flown.set_axis(flown.columns.str.split("/", expand=True), axis=1)
    with warnings.catch_warnings():
        # Carry-over, which half squares leave unbalanced, is not estimated.
        warnings.filterwarnings("ignore", f"{n} participants fill half")
        study = virtual_study(
            n=n, seed=seed, testbed=place, assumptions=assumptions, n_jobs=n_jobs, progress=False
        )
    frame = study.measures.astype({"condition": str})
    if place == "ground_robot" and "satisfaction" in frame:
        frame["satisfaction"] = 1.0 + FIVE_POINTS * (frame["satisfaction"] - 1.0)
    return frame.pivot(index="participant", columns="condition")  # noqa: PD010 (no repeats)


def teleoperate(
    place: str, answers: int, seed: np.random.SeedSequence, trust: Any = None, **person: Any
) -> dict[str, float]:
    """Fly all schemes on one path and answer after each: a task of `run_campaign`."""
    operator = TeleoperatorPopulation.person(person)
    study, schemes, points = TELEOPERATION[place]
    measures: dict[str, float] = {}
    for scheme in schemes:
        session = simulate_teleoperation(scheme, operator, study, seed=seed, trust=trust)
        measures[f"error/{scheme}"] = float(session["path_error"].mean())
        answered = simulated_answers(session, study, int(person["participant"]), answers, points)
        for name, items in ANSWERED.items():
            measures[f"{name}/{scheme}"] = float(np.mean([answered[item] for item in items]))
    return measures


def _compared(effect: Any, measured: pd.DataFrame) -> tuple[float, float, int, float, Any, str]:
    """Return mean difference, standard error, count, p, agreement, and why there is none."""
    pair = [(effect.measure, condition) for condition in effect.contrast.split("-")]
    difference = measured.reindex(columns=pair).astype(float).diff(-1, axis=1).iloc[:, 0].dropna()
    count = difference.size
    if count < 3:
        reason = f"only {count} operators have the measure in both conditions"
        reason = reason if effect.measure in measured else SILENT
        return math.nan, math.nan, count, math.nan, pd.NA, reason
    mean, se = float(difference.mean()), float(difference.sem())
    p = float(2.0 * special.stdtr(count - 1, -abs(mean) / se)) if se > 0.0 else math.nan
    agrees = effect.low <= mean + 2.0 * se and mean - 2.0 * se <= effect.high
    return mean, se, count, p, agrees, ""
