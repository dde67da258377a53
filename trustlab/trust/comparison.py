"""Which model of trust predicts people best: held-out scores, paired by person; and recovery."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import list_of, of_class, one_of, spawned, whole_number
from trustlab.models.display import Result
from trustlab.trust.dynamics import BASELINES, MODELS
from trustlab.trust.fitting import CRITERIA, TrustFit, fitted, model_class
from trustlab.trust.interface import TrustDynamics, cell
from trustlab.trust.likelihood import predict, simulate_ratings
from trustlab.trust.panel import Panel, panel_until

# Of every person: squared errors, less is better; log score in nats a rating, more is better; log
# loss of reliance in nats a decision, less is better; ratings within the 90 % interval.
MEASURES = ("free_error", "step_error", "log_score", "reliance_loss", "coverage")
Models = Sequence | Mapping | None


@dataclass(frozen=True, eq=False, repr=False)
class TrustComparison(Result):
    """
    Scores of models of trust on ratings that they were not fitted to.

    Parameters
    ----------
    scores : pandas.DataFrame
        A row per split, model and person: split, model, person and the measures.
    against : str
        The model that others are compared with.
    source : str
        Where the data are from.
    cautions : tuple of str
        What must be said of the data.
    """

    scores: pd.DataFrame
    against: str
    source: str
    cautions: tuple[str, ...]

    @property
    def title(self) -> str:
        """What is compared."""
        return f"Models of trust against {self.against}"

    @property
    def message(self) -> str:
        """Where the data are from, and what must be said of them."""
        return " ".join((self.source, *self.cautions))

    def table(self) -> pd.DataFrame:
        """
        Return the scores of every model: means over people.

        Returns
        -------
        pandas.DataFrame
            Columns split, model, free_rmse (from no rating but the first; of the last third, but
            those before it), step_rmse (from all so far), log_score, reliance_loss, coverage (of
            90 % intervals).
        """
        means = self.scores.groupby(["split", "model"], sort=False)[list(MEASURES)].mean()
        errors = list(MEASURES[:2])
        means[errors] = np.sqrt(means[errors])
        return means.reset_index().rename(columns=lambda name: name.replace("error", "rmse"))

    def paired(self, against: str | None = None) -> pd.DataFrame:
        """
        Return differences from a model, paired by person, with 95 % intervals.

        Parameters
        ----------
        against : str, optional
            The model that is subtracted; `against` of the comparison when not given.

        Returns
        -------
        pandas.DataFrame
            Columns split, measure, model, difference (of squared errors, not of their roots), se,
            ci_low, ci_high (Student's t over people), people.
        """
        reference = one_of(
            "against", self.against if against is None else against, self.scores["model"].unique()
        )
        long = self.scores.melt(["split", "person", "model"], MEASURES[:4], "measure", "score")
        wide = long.pivot_table("score", ["split", "measure", "person"], "model", sort=False)
        apart = wide.drop(columns=reference).sub(wide[reference], axis=0)
        values = apart.stack()  # noqa: PD013 (melting would lose the order)
        table = values.groupby(["split", "measure", "model"], sort=False)
        table = table.agg(difference="mean", se="sem", people="count").query("people > 1")
        table = table.reindex(self.scores["split"].unique(), level="split")
        half = special.stdtrit(table["people"] - 1, 0.975) * table["se"]
        table.insert(2, "ci_low", table["difference"] - half)
        table.insert(3, "ci_high", table["difference"] + half)
        return table.reset_index()


def named_models(models: Models) -> dict[str, type[TrustDynamics]]:
    """Return classes by name: all models and baselines when none are chosen."""
    if models is None:
        return MODELS | BASELINES
    if not isinstance(models, Mapping):
        models = list_of("models", models)
        models = {str(getattr(model, "__name__", model)): model for model in models}
    if not models:
        raise ValueError("models must be several, or [one], got none")
    return {str(name): model_class(model) for name, model in models.items()}


def compare_trust_models(
    panel: Panel,
    models: Models = None,
    *,
    folds: int = 5,
    against: str | None = None,
    criterion: str = "step",
    seed: int = 0,
) -> TrustComparison:
    """
    Score models of trust on people left out, and on the last third of every person.

    Parameters
    ----------
    panel : Panel
        See `read_people`.
    models : sequence or mapping, optional
        Names or classes, or classes by name; the seven models and the baselines when not given.
    folds : int
        Groups of people, each left out once.
    against : str, optional
        The model that others are compared with; performance, or the first where that is not among
        them, when not given.
    criterion : {"step", "free"}
        What models are fitted for, see `fit_trust`.
    seed : int
        Of the division into groups.

    Returns
    -------
    TrustComparison

    Raises
    ------
    ValueError
        If a model is unknown or there are fewer people than folds.

    Notes
    -----
    Parameters are pooled. People left out of the same fold share the fitted parameters, so that
    intervals leave out what fitting adds.

    Examples
    --------
    >>> import trustlab as tl
    >>> result = tl.compare_trust_models(tl.read_people("hybrid_vr"), ["beta", "persistence"])
    >>> result.table().shape
    (4, 7)
    """
    of_class("panel", panel, Panel, "tl.read_people(…) reads one")
    chosen = named_models(models)
    usual = "performance" if "performance" in chosen else next(iter(chosen))
    against = one_of("against", usual if against is None else against, list(chosen))
    one_of("criterion", criterion, CRITERIA)
    folds = whole_number("folds", folds, least=2)
    if len(panel) < folds:
        raise ValueError(
            f"people are left out, and {folds} folds need as many, got {len(panel)}; take fewer "
            "folds, two or more, or tl.fit_trust(…), which needs one person"
        )
    order = np.random.default_rng(spawned(seed, 1)[0]).permutation(len(panel))
    groups = np.array_split(order, folds)
    # What is fitted, what is scored, and after which event of every person.
    splits: list[tuple[str, Panel, Panel, Any]] = [
        ("people", panel.of(np.setdiff1d(order, group)), panel.of(group), 0) for group in groups
    ]
    events = np.isfinite(panel.events.dt).sum(axis=1)
    later = events - events // 3
    earlier = panel_until(panel, later)
    if events.max() > 2 and np.isfinite(earlier.ratings[:, 1:]).any():
        splits.append(("last third", earlier, panel, later))
    # Where all people are fitted best is a good place to start from, and nothing more.
    starts = {name: fitted(panel, model, criterion).coordinates for name, model in chosen.items()}
    tables = []
    for split, seen, unseen, since in splits:
        for name, model in chosen.items():
            fit = fitted(seen, model, criterion, starts[name])
            tables.append(_scores(fit, unseen, since).assign(split=split, model=name))
    scores = pd.concat(tables, ignore_index=True)[["split", "model", "person", *MEASURES]]
    return TrustComparison(scores, against, panel.source, panel.cautions)


def _scores(fit: TrustFit, panel: Panel, since: int | np.ndarray) -> pd.DataFrame:
    """Return every person's measures on the events from one on."""
    scored = np.arange(panel.trials) >= np.reshape(since, (-1, 1))
    actual = panel.ratings[:, 1:]
    steps = predict(fit.model, panel)
    free = predict(fit.model, panel, free=True, known=since)
    inside = [
        _in_central_interval(rating, actual[:, k], panel.resolution)
        for k, rating in enumerate(steps.distributions)
    ]
    bias, slope = fit.link
    odds = bias + slope * steps.preference
    values = {
        "free_error": np.square(free.mean - actual),
        "step_error": np.square(steps.mean - actual),
        "log_score": np.log(steps.probability(panel)),
        "reliance_loss": -special.log_expit(-odds) - panel.events.followed * odds,
        "coverage": np.where(np.isnan(actual), np.nan, np.transpose(inside)),
    }
    means = {
        name: pd.DataFrame(np.where(scored, value, np.nan)).mean(axis=1)
        for name, value in values.items()
    }
    return pd.DataFrame({"person": panel.people} | means)


def _in_central_interval(rating: Any, actual: np.ndarray, resolution: float) -> np.ndarray:
    """
    Return whether ratings lie in the 90 % in the middle; at an end of the scale, whether what is
    rounded to it does.
    """
    low, high = cell(actual, resolution)
    inner = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(inner, actual, low), np.where(inner, actual, high)
    return (rating.mass(-np.inf, low) <= 0.95) & (rating.mass(-np.inf, high) >= 0.05)


def recover_trust_models(
    panel: Panel, models: Models = None, *, n: int = 1, seed: int = 0
) -> pd.DataFrame:
    """
    Return which models can be told apart: each is fitted, simulated, and looked for by all.

    Parameters
    ----------
    panel : Panel
        Events, first ratings and what models are fitted to.
    models : sequence or mapping, optional
        As of `compare_trust_models`; the seven models when not given.
    n : int
        Simulated panels of each model.
    seed : int
        Of the simulations.

    Returns
    -------
    pandas.DataFrame
        A row per model simulated, a column per model chosen (least BIC), shares of the n panels.

    Examples
    --------
    >>> import trustlab as tl
    >>> panel = tl.read_people("hybrid_vr")
    >>> tl.trust.recover_trust_models(panel, ["beta", "persistence"]).to_numpy().tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    chosen = MODELS if models is None else named_models(models)
    n = whole_number("n", n)
    names = list(chosen)
    shares = pd.DataFrame(0.0, index=pd.Index(names, name="simulated"), columns=names)
    fits = {name: fitted(panel, model) for name, model in chosen.items()}
    for (name, truth), stream in zip(fits.items(), spawned(seed, len(names)), strict=True):
        for child in stream.spawn(n):
            drawn = simulate_ratings(truth.model, panel, np.random.default_rng(child))
            # The search starts where people are fitted best.
            bic = {
                candidate: fitted(drawn, chosen[candidate], start=fit.coordinates).bic
                for candidate, fit in fits.items()
            }
            shares.loc[name, min(bic, key=bic.__getitem__)] += 1.0 / n
    return shares
