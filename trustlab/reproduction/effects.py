"""
Every effect that the dissertation prints or claims: as printed, as the printed models alone
predict, and in simulated people under named assumptions about them.
"""

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from trustlab.allocation.rules import PerformanceRule
from trustlab.allocation.simulation import simulate_allocation
from trustlab.campaign.run import run_campaign
from trustlab.models.checks import one_of, shown, whole_number
from trustlab.operators.answers import simulated_answers
from trustlab.operators.ground_robot import ASSUMPTIONS, checked_assumptions
from trustlab.operators.teleoperator import TELEOPERATOR_ASSUMPTIONS
from trustlab.reproduction.printed_number import printed_decimal, printed_interval
from trustlab.reproduction.published import published_facts, published_models, published_table
from trustlab.reproduction.published_study import published_studies
from trustlab.studies.questionnaires import NASA_TLX
from trustlab.studies.virtual_study import virtual_study
from trustlab.testbeds.deciding import CONDITIONS
from trustlab.testbeds.populations import TeleoperatorPopulation
from trustlab.testbeds.uav_tracking import simulate_teleoperation
from trustlab.trust.driving import TrustInLoop
from trustlab.trust.interface import TrustDynamics


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


# What every table of effects begins with.
COLUMNS = list(Effect._fields[:-1])


@cache
def effects() -> tuple[Effect, ...]:
    """Return all effects that data/published/effects.toml lists."""
    listed = published_facts("effects")
    return (
        *(effect for table in listed["tables"] for effect in _of_table(**table)),
        *(effect for study in listed["studies"] for effect in _of_study(**study)),
        *(_claimed(**claim) for claim in listed["claims"]),
    )


def _sized(
    where: str, measure: str, contrast: str, means: Mapping[str, str], p: float, study: str
) -> Effect:
    """Return the effect of two printed means, and its ends within their rounding."""
    after, before = (means[condition] for condition in contrast.split("-"))
    (low, high), (lowest, highest) = printed_interval(after), printed_interval(before)
    exact = float(printed_decimal(after) - printed_decimal(before))
    ends = low - highest, high - lowest
    return Effect(f"{study}/{measure}/{contrast}", where, measure, contrast, exact, *ends, p, study)


def _of_table(
    table: str, study: str, measures: dict[str, str], contrasts: list[str]
) -> Iterator[Effect]:
    for measure, column in measures.items():
        means = published_table(table)[column]
        for contrast in contrasts:
            yield _sized(f"Table {table}", measure, contrast, means, math.nan, study)


def _of_study(name: str, measure: str, contrasts: list[str]) -> Iterator[Effect]:
    study = published_studies()[name]
    for contrast in contrasts:
        after, before = contrast.split("-")
        text = study.pairs.get(f"{before}-{after}") or study.pairs.get(contrast)
        p = float((text or study.t_test.get("p", "nan")).removeprefix("<"))
        yield _sized(study.where, measure, contrast, study.mean, p, name.partition(".")[0])


def _claimed(id: str, where: str, measure: str, contrast: str, sign: int, study: str) -> Effect:
    ends = (0.0, math.inf) if sign > 0 else (-math.inf, 0.0)
    about = f"{id}/{measure}/{contrast}", where, measure, contrast
    return Effect(*about, math.nan, *ends, math.nan, study)


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
        reason, difference = "", np.array([math.nan])
        if effect.study != "table_2.5":
            reason = NOT_MODELLED if effect.study in ("table_2.4", "table_2.6") else NO_MODEL
        elif set(effect.conditions) & {"C2", "C4"}:
            reason = FREE
        else:
            after, before = (model_means(name)[effect.measure] for name in effect.conditions)
            difference = (after - before).to_numpy()
        ends = difference.min(), difference.max()
        rows.append((*effect[: len(COLUMNS)], difference.mean(), *ends, reason))
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
        thresholds = captured.xs("mean", level=1) if condition == "C1" else chosen
        if condition == "C5":
            rule = PerformanceRule(model.robot.p_min, model.robot.p_max)
            motion = simulate_allocation(model, rule=rule, steps=STEPS)
        else:
            lower, upper = (float(thresholds.loc[name, label]) for name in ("TSC_l", "TSC_u"))
            motion = simulate_allocation(model, lower, upper, steps=STEPS)
        rows.append(motion[["p_r", "p_h", "r"]].iloc[STEPS // 2 :].mean())
    return pd.DataFrame(rows, index=list("12345"), dtype=np.float64)


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
        where nothing is simulated); reason, why not. `attrs["origin"]` says that it is simulated.

    Raises
    ------
    ValueError
        If an assumption is unknown or out of range, or n is below 3.

    Examples
    --------
    >>> import trustlab as tl
    >>> assumptions = {"attention_cost": 0.05}
    >>> effects = tl.simulated_effects(assumptions, n=4, seed=0, only="table_2.6", n_jobs=1)
    >>> effects["id"].tolist()
    ['table_2.6/followed_percent/C2-C4']
    """
    assumed = all_checked({} if assumptions is None else assumptions)
    n, seed = whole_number("n", n, least=3), whole_number("seed", seed, least=0)
    measures: dict[str, pd.DataFrame] = {}
    rows = []
    for effect in effects_of(only):
        place = ALLOCATION.get(effect.study, effect.study)
        if place not in measures:
            measures[place] = _measured(place, assumed, n, seed, trust, n_jobs)
        rows.append((*effect[: len(COLUMNS)], *_compared(effect, measures[place])))
    frame = pd.DataFrame(rows, columns=[*COLUMNS, *SIMULATED])
    frame["agrees"] = frame["agrees"].astype("boolean")
    frame.attrs = {"origin": "simulated operators", "assumptions": assumed, "n": n, "seed": seed}
    return frame


def all_checked(assumptions: Mapping[str, float]) -> dict[str, float]:
    """Return assumptions about operators of both chapters, each within its range."""
    if not isinstance(assumptions, Mapping):
        raise ValueError(f"assumptions must map names to numbers, got {shown(assumptions)}")
    return checked_assumptions(assumptions, {**ASSUMPTIONS, **TELEOPERATOR_ASSUMPTIONS})


def _among(names: Iterable[str], assumptions: Mapping[str, float]) -> dict[str, float]:
    """Return the assumptions of these names."""
    return {name: assumptions[name] for name in names if name in assumptions}


def effects_of(study: str | None, name: str = "only") -> list[Effect]:
    """Return the effects of a study, of all studies on the ground robot, or all."""
    if study is None:
        return list(effects())
    one_of(name, study, [*dict.fromkeys([*ALLOCATION.values(), *ALLOCATION, *TELEOPERATION])])
    return [effect for effect in effects() if study in (effect.study, ALLOCATION.get(effect.study))]


def _measured(
    place: str, assumed: dict[str, float], n: int, seed: int, trust: Any, n_jobs: int
) -> pd.DataFrame:
    """Return a study's measures by participant (the operator's number) and condition."""
    if place in TELEOPERATION:
        population = TeleoperatorPopulation(TELEOPERATION[place][0])
        people = population.draw(n, seed, _among(TELEOPERATOR_ASSUMPTIONS, assumed))
        return _teleoperated(place, people, seed, trust, n_jobs)
    n = len(CONDITIONS) * math.ceil(n / len(CONDITIONS))
    with warnings.catch_warnings():
        # Carry-over, which half squares leave unbalanced, is not estimated.
        warnings.filterwarnings("ignore", f"{n} participants fill half")
        study = virtual_study(
            n=n,
            seed=seed,
            testbed=place,
            assumptions=_among(ASSUMPTIONS, assumed),
            n_jobs=n_jobs,
            progress=False,
        )
    frame = study.measures.astype({"condition": str})
    if place == "ground_robot" and "satisfaction" in frame:
        frame["satisfaction"] = 1.0 + FIVE_POINTS * (frame["satisfaction"] - 1.0)
    return frame


def _teleoperated(
    place: str, people: pd.DataFrame, seed: int, trust: Any, n_jobs: int
) -> pd.DataFrame:
    """Return error and answers of teleoperators under all schemes of a study of Chapter 3."""
    study, schemes, points = TELEOPERATION[place]
    fixed = {"study": study, "schemes": " ".join(schemes), "points": points, "answers": seed}
    task = teleoperate if trust is None else partial(teleoperate, trust=trust)
    plans = [fixed | row for row in people.to_dict("records")]
    done = run_campaign(task, plans, seed=seed, n_jobs=n_jobs, progress=False)
    done = done[~done["failed"].to_numpy(bool)]
    names = ["error", "tlx", "satisfaction", "trust"]
    flown = [
        done[["participant", *(f"{scheme}/{name}" for name in names)]]
        .set_axis(["participant", *names], axis=1)
        .assign(condition=scheme)
        for scheme in schemes
    ]
    return pd.concat(flown)


def teleoperate(
    study: str,
    schemes: str,
    points: int,
    answers: int,
    seed: np.random.SeedSequence,
    trust: Any = None,
    **person: Any,
) -> dict[str, float]:
    """Fly all schemes on one path and answer after each: a task of `run_campaign`."""
    operator = TeleoperatorPopulation.person(person)
    measures: dict[str, float] = {}
    for scheme in schemes.split():
        session = simulate_teleoperation(scheme, operator, study, seed=seed, trust=trust)
        answered = simulated_answers(session, study, int(person["participant"]), answers, points)
        measures |= {
            f"{scheme}/error": float(session["path_error"].mean()),
            f"{scheme}/tlx": float(np.mean([answered[scale] for scale in NASA_TLX.items])),
            f"{scheme}/satisfaction": float(
                np.mean([answered[item] for item in ("satisfaction", "comfort", "control")])
            ),
            f"{scheme}/trust": answered["trust"],
        }
    return measures


def _compared(
    effect: Effect, measures: pd.DataFrame
) -> tuple[float, float, int, float, object, str]:
    """Return mean difference, standard error, count, p, agreement, and why there is none."""
    count, reason = 0, SILENT
    if effect.measure in measures:
        names = {"index": "participant", "columns": "condition", "values": effect.measure}
        wide = measures.pivot(**names)  # noqa: PD010 (a repeat is an error)
        after, before = wide.reindex(columns=effect.conditions).T.to_numpy(float)
        difference = pd.Series(after - before).dropna()
        count = len(difference)
        reason = f"only {count} operators have the measure in both conditions" if count < 3 else ""
    if reason:
        return math.nan, math.nan, count, math.nan, pd.NA, reason
    mean, se = float(difference.mean()), float(difference.sem())
    p = float(2.0 * special.stdtr(count - 1, -abs(mean) / se)) if se > 0.0 else math.nan
    agrees = effect.low <= mean + 2.0 * se and mean - 2.0 * se <= effect.high
    return mean, se, count, p, agrees, ""
