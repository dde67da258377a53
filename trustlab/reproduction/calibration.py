"""
What must be true of people for a study's printed effects to hold at once: approximate Bayesian
computation over assumptions.

A table of simulated studies, each under assumptions drawn from a prior, is made as a campaign. Each
assumption, on the probit scale of its prior's range, is regressed on all effects over all simulated
studies; the posterior is what the regression says for the printed effects, plus its residuals
(Beaumont, Zhang and Balding 2002, with every simulation accepted). Residuals are scaled to equal
variance, e_i/√(1 − h_i), as they are too small by the coefficients that they were fitted with, and
carry the regression's own error at the printed effects, √(1 + h_0).
Where printed effects lie beyond all that simulated studies give, the regression extrapolates,
and the posterior means nothing (Frazier, Robert and Rousseau 2020): `Calibration.reach` tells, the
table marks such assumptions, and `Calibration.given` conditions on the measures within reach.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, compress
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import special
from scipy.spatial import KDTree

from trustlab.campaign.run import run_campaign
from trustlab.models.checks import (
    between,
    finite_array,
    in_order,
    of_class,
    one_of,
    table_of,
    whole_number,
    whole_seed,
)
from trustlab.models.display import Result
from trustlab.models.files import path_of, write_atomically
from trustlab.operators.ground_robot import checked_assumptions
from trustlab.reproduction.effects import (
    TELEOPERATION,
    UNITS,
    assumptions_about,
    effects_of,
    simulated_effects,
)

# Ranges of the uniform priors.
PRIORS = {
    "attention_cost": (0.0, 0.3),
    "trust_bias": (-0.4, 0.4),
    "take_over_lag": (0.0, 10.0),
    "r0": (0.0, 1.0),
    "load_utilization": (0.0, 1.0),
    "load_switching": (0.0, 0.2),
}

# Of teleoperators, for the studies of Chapter 3.
TELEOPERATOR_PRIORS = {
    "adapting": (0.0, 1.0),
    "gain": (0.4, 1.6),
    "crossover": (0.5, 1.4),
    "lag": (0.0, 0.3),
    "compensation": (0.8, 2.2),
    "allocation_cost": (0.0, 0.6),
    "fatigue_of_hand": (0.0, 0.5),
}

# Simulations for every coefficient of the regression, at the least.
LEAST_PER_COEFFICIENT = 2


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Result):
    """
    Which assumptions about people reproduce a study's printed effects at once, within this model of
    operators.

    Parameters
    ----------
    study : str
        The study.
    priors : dict of str to (float, float)
        Ranges of the uniform priors.
    simulations : pandas.DataFrame
        The simulated studies: a column per assumption and per effect, by id.
    settings : dict
        n (operators of each simulated study), seed, simulations, left_out (failed, or without some
        effect).
    measures : tuple of str
        The measures whose effects the posterior is given; all that simulated studies have, if none.
    """

    study: str
    priors: dict[str, tuple[float, float]]
    simulations: pd.DataFrame
    settings: dict
    measures: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = tuple(self.observed["measure"].unique())
        for name in self.measures:
            one_of("a measure", name, known)
        self.__dict__["measures"] = self.measures or known

    @property
    def observed(self) -> pd.DataFrame:
        """The printed effects that simulated studies have, a row each."""
        printed = observed_effects(self.study)
        return printed[printed["id"].isin(self.simulations.columns)]

    def _beside(self, measures: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return the simulated effects, a row each study, and the printed ones of some measures."""
        chosen = self.observed[self.observed["measure"].isin(measures)]
        return self.simulations[chosen["id"]].to_numpy(float), chosen["printed"].to_numpy()

    @cached_property
    def _sampled(self) -> tuple[pd.DataFrame, np.ndarray]:
        """The posterior, and which assumptions are extrapolated."""
        drawn = self.simulations[list(self.priors)]
        return posterior_sample(drawn, *self._beside(self.measures), self.priors)

    @property
    def posterior(self) -> pd.DataFrame:
        """A sample of assumptions, a row each."""
        return self._sampled[0]

    @property
    def extrapolated(self) -> tuple[str, ...]:
        """
        Assumptions for which the printed effects lie beyond those of all simulated studies: their
        posterior is no estimate.
        """
        return tuple(compress(self.priors, self._sampled[1]))

    @property
    def assumptions(self) -> dict[str, float]:
        """Medians of the posterior, for `simulated_effects`; of `extrapolated` no estimates."""
        return self.posterior.median().to_dict()

    @property
    def title(self) -> str:
        """The study."""
        return f"Calibration of {self.study}"

    @property
    def message(self) -> str:
        """What this is, in a line, and of which assumptions medians are no estimate."""
        extrapolated = ", ".join(self.extrapolated)
        doubt = f"; printed effects lie beyond all, and medians are no estimate of {extrapolated}"
        measures = ", ".join(UNITS.get(name, name) for name in self.measures)
        return (
            f"{len(self.simulations)} simulated studies of {self.settings['n']} simulated "
            f"operators, given {measures}{doubt if extrapolated else ''}"
        )

    def table(self) -> pd.DataFrame:
        """
        Return assumption, prior_low, prior_high, median, low, high (95 %), contraction (1 −
        variance over the prior's), extrapolated.
        """
        table = pd.DataFrame(self.priors, index=["prior_low", "prior_high"]).T
        ends = self.posterior.quantile([0.5, 0.025, 0.975]).T
        table[["median", "low", "high"]] = ends.to_numpy()
        spread = 12.0 * self.posterior.var() / (table["prior_high"] - table["prior_low"]) ** 2
        table["contraction"] = 1.0 - spread
        table["extrapolated"] = table.index.isin(self.extrapolated)
        return table.rename_axis("assumption").reset_index()

    def given(self, *measures: str) -> "Calibration":
        """
        Return the calibration from the same simulated studies that some measures' effects alone
        make.

        Parameters
        ----------
        *measures : str
            Any that `printed_effects` has of the study, for example "p_r", "r".

        Raises
        ------
        ValueError
            If no measure is named, or the simulated studies have no effect of one.
        """
        if not measures:
            raise ValueError(f"name at least one measure, any of {', '.join(self.measures)}")
        return replace(self, measures=measures)

    def reach(self) -> pd.DataFrame:
        """
        Return how near simulated studies come to the printed effects of each measure that was
        given, and of all of them at once.

        Returns
        -------
        pandas.DataFrame
            measures; effects, how many; nearest: distance from the printed effects to the nearest
            simulated study, each effect in standard deviations over all simulated studies; typical:
            the median of that distance from one simulated study to the others; share of the
            simulated studies that are at least as far from the others. A share near 0 says that no
            such study comes out of this model of operators, whatever people are like within the
            priors.
        """
        sets = dict.fromkeys([*((name,) for name in self.measures), self.measures])
        columns = ["measures", "effects", "nearest", "typical", "share"]
        return pd.DataFrame(map(self._reach, sets), columns=columns)

    def _reach(self, measures: tuple[str, ...]) -> tuple[str, int, float, float, float]:
        """Return a row of `reach`."""
        values, printed = self._beside(measures)
        scale = np.maximum(values.std(axis=0), 1e-12)
        tree = KDTree(values / scale)
        nearest, _ = tree.query(printed / scale)
        apart = tree.query(tree.data, 2)[0][:, 1]
        share = (apart >= nearest).mean()
        return " ".join(measures), len(printed), nearest, float(np.median(apart)), share

    def within_reach(self, share: float = 0.05) -> "Calibration":
        """
        Return the calibration given as many measures as simulated studies reach at once, of equally
        many the best reached.

        Parameters
        ----------
        share : float
            The least share of `reach` that counts.

        Raises
        ------
        ValueError
            If no measure is within reach.
        """
        share = between("share", share, 0.0, 1.0)
        for size in range(len(self.measures), 0, -1):
            candidates = [self.given(*measures) for measures in combinations(self.measures, size)]
            shares = [-1.0 if c.extrapolated else c._reach(c.measures)[-1] for c in candidates]
            if max(shares) >= share:
                return candidates[int(np.argmax(shares))]
        raise ValueError(
            f"no measure of {self.study} is within reach of simulated studies, at a share of "
            f"{share:g}"
        )

    def checks(
        self,
        studies: int = 40,
        seed: int = 1,
        *,
        people: pd.DataFrame | None = None,
        n_jobs: int = 1,
    ) -> pd.DataFrame:
        """
        Return every effect beside what simulated studies give, under the prior and under the
        posterior.

        Parameters
        ----------
        studies : int
            How many studies to simulate under assumptions drawn from the posterior; at most as
            many as it has draws.
        seed : int
            Of these.
        people : pandas.DataFrame, optional
            Assumptions to draw from in place of the posterior, a row each.
        n_jobs : int
            Processes, as for `run_campaign`; no effect on results.

        Returns
        -------
        pandas.DataFrame
            id, printed; prior_low, prior_high: the range of all simulated studies; reached: whether
            any of them goes as far as the printed effect. Where none does, it is out of reach
            whatever people are like, within these priors and this model of operators. low, high:
            the central 95 % under the posterior; predicted: whether what is printed lies within.
            Effects that no study simulated under the posterior has are left out.
        """
        seed = whole_seed(seed)
        people = self.posterior if people is None else people
        of_class("people", people, pd.DataFrame, "a row each, a column per assumption")
        studies = whole_number("studies", studies, most=len(people))
        drawn = people.sample(studies, random_state=seed).to_dict("records")
        for each in drawn:
            checked_assumptions(each, assumptions_about([self.study]))
        runs = [{"study": self.study, "n": self.settings["n"]} | row for row in drawn]
        done = run_campaign(simulated_study, runs, seed=seed, progress=False, n_jobs=n_jobs)
        effects = self.observed.set_index("id")
        done = done[effects.index].dropna(axis="columns", how="all").astype(float)
        effects = effects.loc[done.columns]
        table = effects[["printed"]].copy()
        for least, greatest, meets, ends in (
            (
                "prior_low",
                "prior_high",
                "reached",
                self.simulations[done.columns].agg(["min", "max"]),
            ),
            ("low", "high", "predicted", done.quantile([0.025, 0.975])),
        ):
            low, high = table[least], table[greatest] = ends.to_numpy()
            table[meets] = (low <= effects["high"]) & (effects["low"] <= high)
        return table.reset_index()


def calibrate(
    study: str = "uav",
    simulations: int = 1000,
    n: int = 20,
    seed: int = 0,
    *,
    priors: Mapping[str, tuple[float, float]] | None = None,
    out: str | os.PathLike | None = None,
    n_jobs: int = 1,
    progress: bool | None = None,
) -> Calibration:
    """
    Return which assumptions about people reproduce all printed effects of a study at once.

    Parameters
    ----------
    study : {"uav", "ground_robot", "table_2.4", "table_2.5", "table_2.6", "table_3.1", "teleop"}
        The study, or one of the tables of that on the ground robot; "table_3.1" and "teleop" are
        the preliminary and the main study of Chapter 3.
    simulations : int
        How many studies to simulate, each under assumptions drawn from the priors.
    n : int
        Operators of each, as many as people took part in the printed study, under C1–C5 in
        multiples of five: the scatter of small studies is part of what the printed effects are
        compared with.
    seed : int
        Of all draws; simulation i is the same in a larger table.
    priors : mapping of str to (float, float), optional
        Ranges of uniform priors by assumption (`trustlab.operators.ASSUMPTIONS`, or
        `TELEOPERATOR_ASSUMPTIONS` for the studies of Chapter 3).
    out : path-like, optional
        A folder for the finished simulations: a call with the same arguments goes on where a killed
        one stopped, and one with more simulations runs only those that are new.
    n_jobs, progress : int, bool, optional
        As for `run_campaign`; no effect on results.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If an assumption is unknown or out of range, a prior has no mass, or the simulations are
        fewer than two for every effect and one.

    References
    ----------
    M. A. Beaumont, W. Zhang and D. J. Balding, Genetics 162 (2002) 2025-2035. D. T. Frazier, C. P.
    Robert and J. Rousseau, J. R. Stat. Soc. B 82 (2020) 421-444.

    Examples
    --------
    >>> import trustlab as tl
    >>> calibration = tl.calibrate("uav", simulations=400, seed=0)  # doctest: +SKIP
    >>> calibration = tl.reproduction.read_calibration("uav", "data/calibration")  # made before
    >>> calibration.table().columns[:6].tolist()
    ['assumption', 'prior_low', 'prior_high', 'median', 'low', 'high']
    """
    effects = observed_effects(study)
    usual = TELEOPERATOR_PRIORS if study in TELEOPERATION else PRIORS
    ranges = checked_priors(usual if priors is None else priors, study)
    simulations = whole_number("simulations", simulations)
    n = whole_number("n", n, least=3)  # fewer have no spread to test against
    seed = whole_seed(seed)
    _check_enough(simulations, len(effects))
    runs = [{"study": study, "n": n} | draw for draw in prior_draws(ranges, simulations, seed)]
    done = run_campaign(simulated_study, runs, seed=seed, n_jobs=n_jobs, out=out, progress=progress)
    whole = done[~done["failed"].to_numpy(bool)]
    # questionnaires are not answered under all assumptions
    ids = [id for id in effects["id"] if id in whole and whole[id].notna().any()]
    whole = whole.dropna(subset=ids).reset_index(drop=True)
    _check_enough(len(whole), len(ids))
    left_out = simulations - len(whole)
    settings = {"n": n, "seed": seed, "simulations": simulations, "left_out": left_out}
    return Calibration(study, ranges, whole[[*ranges, *ids]].astype(float), settings)


def _check_enough(simulations: int, effects: int) -> None:
    """Refuse fewer simulated studies than a regression on these effects needs."""
    needed = LEAST_PER_COEFFICIENT * (effects + 1)
    if simulations < needed:
        raise ValueError(
            f"{simulations} simulated studies are too few for a regression on {effects} effects: "
            f"{needed} are needed; those that are finished stay in out= for such a call"
        )


def write_calibration(calibration: Calibration, folder: str | os.PathLike) -> None:
    """
    Write a calibration's simulated studies to a folder: <study>.csv, and <study>.json with priors
    and settings.

    Parameters
    ----------
    calibration : Calibration
        What to write.
    folder : path-like
        Where; made if it is not there.
    """
    path = Path(folder) / calibration.study
    path.parent.mkdir(parents=True, exist_ok=True)
    about = {name: getattr(calibration, name) for name in ("study", "priors", "settings")}
    about["origin"] = "simulated operators"
    write_atomically(f"{path}.json", json.dumps(about, indent=1) + "\n")
    write_atomically(f"{path}.csv", calibration.simulations.to_csv(index=False))


def read_calibration(study: str, folder: str | os.PathLike) -> Calibration:
    """
    Return a calibration that `write_calibration` wrote; the posterior is made anew from the
    simulated studies.

    Parameters
    ----------
    study : str
        The study.
    folder : path-like
        Where it was written.

    Raises
    ------
    ValueError
        If the folder has none of this study.
    """
    path = path_of("folder", folder)
    table, about = (path / f"{study}.{ending}" for ending in ("csv", "json"))
    if not (table.is_file() and about.is_file()):
        raise ValueError(
            f"folder {folder} holds no calibration of study {study!r}: `make calibration` writes "
            "data/calibration"
        )
    facts = json.loads(about.read_text(encoding="utf-8"))
    priors = {name: tuple(pair) for name, pair in facts["priors"].items()}
    return Calibration(study, priors, pd.read_csv(table), facts["settings"])


def checked_priors(
    priors: Mapping[str, tuple[float, float]], study: str
) -> dict[str, tuple[float, float]]:
    """Return ranges of priors, each with mass and within what an operator of a study allows."""
    if not table_of("priors", priors):
        raise ValueError("priors must have at least one assumption, got none")
    ranges = {}
    for name, pair in priors.items():
        low, high = finite_array(f"the prior of {name}", pair, length=2)
        ranges[name] = in_order(f"the low end of {name}", low, "its high end", high)
        for end in ranges[name]:
            checked_assumptions({name: end}, assumptions_about([study]))
    return ranges


def prior_draws(
    ranges: dict[str, tuple[float, float]], count: int, seed: int
) -> list[dict[str, float]]:
    """
    Return draws from uniform priors, a dictionary each; the first of a longer list are those of a
    shorter one.
    """
    low, high = np.transpose(list(ranges.values()))
    draws = np.random.default_rng([seed, 0x7072696F]).uniform(low, high, (count, len(ranges)))
    return [dict(zip(ranges, row, strict=True)) for row in draws.tolist()]


def simulated_study(
    study: str, n: int, seed: np.random.SeedSequence, **assumptions: float
) -> dict[str, float]:
    """Simulate one study and return its effects by id: a task of `run_campaign`."""
    frame = simulated_effects(assumptions, n, int(seed.generate_state(1)[0]), only=study)
    return frame.dropna(subset="printed").set_index("id")["simulated"].to_dict()


def posterior_sample(
    drawn: pd.DataFrame,
    simulated: np.ndarray,
    observed: np.ndarray,
    ranges: dict[str, tuple[float, float]],
) -> tuple[pd.DataFrame, np.ndarray]:
    """
    Return a sample of the posterior, a row per simulation, and for which assumptions the observed
    effects lie beyond all simulated ones.

    Parameters
    ----------
    drawn : pandas.DataFrame
        Assumptions of the simulations, a row each.
    simulated : numpy.ndarray, shape (simulations, effects)
        Their effects.
    observed : numpy.ndarray, shape (effects,)
        The effects to explain.
    ranges : dict of str to (float, float)
        Of the uniform priors.
    """
    low, high = np.transpose([ranges[name] for name in drawn])
    eps = 1e-9
    theta = special.ndtri(np.clip((drawn.to_numpy(float) - low) / (high - low), eps, 1.0 - eps))
    scale = np.maximum(simulated.std(axis=0), 1e-12)
    # the observed effects are at zero, so that the first coefficients are what is expected there
    design = np.column_stack([np.ones(len(theta)), (simulated - observed) / scale])
    # effects that are sums of others add nothing
    inverse = np.linalg.pinv(design, rcond=1e-10)
    coefficients = inverse @ theta
    fitted, expected = design @ coefficients, coefficients[0]
    leverage = np.minimum((design * inverse.T).sum(axis=1), 1.0 - eps)
    residuals = (theta - fitted) / np.sqrt(1.0 - leverage)[:, None]
    sample = expected + np.sqrt(1.0 + inverse[0] @ inverse[0]) * residuals
    beyond = (fitted.min(axis=0) > expected) | (fitted.max(axis=0) < expected)
    return pd.DataFrame(low + (high - low) * special.ndtr(sample), columns=drawn.columns), beyond


def observed_effects(study: str) -> pd.DataFrame:
    """Return the effects of a study whose size is printed."""
    return effects_of(study, "study").dropna(subset="printed").drop(columns="place")
