"""Models of trust fitted to a panel: one set of parameters for all people."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import pandas as pd
from scipy.optimize import OptimizeResult, brentq, minimize

from trustlab.models.checks import of_class, one_of
from trustlab.models.display import Result
from trustlab.trust.dynamics import BASELINES, MODELS
from trustlab.trust.interface import TrustDynamics, coordinates_of, values_at, with_parameters
from trustlab.trust.likelihood import log_likelihood, predict
from trustlab.trust.panel import Panel

# The loss at each row of coordinates, shape (rows, parameters).
Loss = Callable[[np.ndarray], np.ndarray]
# Step of the differences behind slopes, in coordinates without bounds.
STEP = 1e-3
# Beyond ±9 a parameter is at its bound for all purposes.
EDGE = 9.0
# Fall of the log-likelihood at the ends of a 95 % interval.
FALL = 1.92
# How much more it may have fallen there.
TOLERANCE = 1e-3
# Ends of intervals so near each other are one.
NEAR = 1e-3
# Least curvature of the loss that a search takes for true.
FLAT = 1.0
# Farther from 0 the loss may be too flat for a search to begin.
STEEP = 4.0
CRITERIA = ("step", "free")
# Points drawn about the defaults, and how many of the best a search begins at.
DRAWN = 40
BEST = 2
# Optima of log-likelihoods so near each other are one.
ALIKE = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class TrustFit(Result):
    """
    A model of trust fitted to a panel.

    Parameters
    ----------
    model : TrustDynamics
        The model.
    panel : Panel
        What it was fitted to.
    criterion : {"step", "free"}
        What it was fitted for, see `fit_trust`.
    coordinates : numpy.ndarray
        Those of the model, without bounds.
    log_likelihood : float
        Of the ratings after the first.
    link : tuple of float
        Bias and slope of the log odds of reliance by the model's preference, fitted afterwards; NaN
        where nobody could rely.
    ratings : int
        Ratings fitted.
    """

    model: TrustDynamics
    panel: Panel
    criterion: str
    coordinates: np.ndarray
    log_likelihood: float
    link: tuple[float, float]
    ratings: int

    @property
    def bic(self) -> float:
        """Schwarz's criterion: smaller is better."""
        return self.coordinates.size * np.log(self.ratings) - 2.0 * self.log_likelihood

    @cached_property
    def ends(self) -> np.ndarray:
        """
        Ends of 95 % intervals of the coordinates by the profile of the likelihood, shape (2,
        parameters).

        Infinite where the data leave a side open, NaN for fits of free runs, which have no
        likelihood.
        """
        if self.criterion == "free" or not self.coordinates.size:
            return np.full((2, self.coordinates.size), np.nan)
        return profile_ends(_loss(self.panel, type(self.model)), self.coordinates)

    @property
    def title(self) -> str:
        """The name of the model."""
        return self.model.name

    @property
    def message(self) -> str:
        """How many people and ratings it was fitted to."""
        return f"{len(self.panel)} people, {self.ratings} ratings"

    def table(self) -> pd.DataFrame:
        """
        Return the parameters with 95 % intervals.

        Returns
        -------
        pandas.DataFrame
            Columns parameter, estimate, ci_low, ci_high, note. An end that the data leave open is
            that of the parameter's range; where both are, there is no interval, and the note says
            so: such an estimate may differ between processors, and the likelihood does not.
        """
        names, rows = list(self.model.parameters()), [self.coordinates, *self.ends]
        table = pd.DataFrame(values_at(type(self.model), np.array(rows)).T)
        table = table.set_axis(["estimate", "ci_low", "ci_high"], axis=1)
        table.insert(0, "parameter", names)
        without = ~np.isfinite(self.ends).any(axis=0)
        table.loc[without, ["ci_low", "ci_high"]] = np.nan
        is_open = self.criterion == "step"
        reason = "the data leave it open" if is_open else "free runs have no likelihood"
        return table.assign(note=np.where(without, reason, ""))


def model_class(model: str | type[TrustDynamics]) -> type[TrustDynamics]:
    """Return a model's class by its name, or a class of a user's own."""
    if isinstance(model, type) and issubclass(model, TrustDynamics):
        return model
    known = MODELS | BASELINES
    return known[one_of("model", model, known, also="a subclass of trustlab.trust.TrustDynamics")]


def fit_trust(
    panel: Panel,
    model: str | type[TrustDynamics] = "asymmetric",
    *,
    criterion: str = "step",
) -> TrustFit:
    """
    Fit a model of trust to people's ratings, by the likelihood of its predictions.

    Parameters
    ----------
    panel : Panel
        See `read_people`; ratings may be missing.
    model : str or subclass of TrustDynamics
        A name in `trust.MODELS` or `trust.BASELINES`, or a model of one's own.
    criterion : {"step", "free"}
        "step": each rating is predicted from all before it, the likelihood; exact for ratings that
        nobody rounds, and in the grid. In linear models what a rounded rating says is normal, with
        its mean and variance. "free": from the first alone, which asks for the course over many
        trials; intervals are then not valid.

    Returns
    -------
    TrustFit

    Raises
    ------
    ValueError
        If the model is unknown or predicts no number, or the panel has no rating after an event.

    Notes
    -----
    All people share their parameters. Reliance is fitted after trust, so that it does not change
    what the ratings say.

    Examples
    --------
    >>> import trustlab as tl
    >>> fit = tl.fit_trust(tl.read_people("hybrid_vr"), "asymmetric")
    >>> fit.model.level_success > fit.model.level_failure
    True
    """
    of_class("panel", panel, Panel, "tl.read_people(…) reads one")
    return fitted(panel, model_class(model), one_of("criterion", criterion, CRITERIA))


def fitted(
    panel: Panel,
    chosen: type[TrustDynamics],
    criterion: str = "step",
    start: np.ndarray | None = None,
) -> TrustFit:
    """Return a fit to a panel, searched from coordinates `start` where they are known."""
    ratings = int(np.isfinite(panel.ratings[:, 1:]).sum())
    if not ratings:
        raise ValueError("the panel has no rating after an event: nothing can be fitted")
    loss = _loss(panel, chosen, criterion)
    starts = _starts(loss, chosen, panel, criterion) if start is None else [start]
    optima = [optimum(loss, each) for each in starts]
    best = min(each.fun for each in optima)
    # The first that is as good as the best: last bits do not decide.
    found = next(each for each in optima if each.fun <= best + ALIKE)
    values = values_at(chosen, found.x).tolist()
    model = chosen(**dict(zip(chosen.parameters(), values, strict=True)))
    if np.isnan(predict(model, panel, criterion == "free").mean).all():
        raise ValueError(f"{model.name} predicts NaN, not a rating, after every event of the panel")
    return TrustFit(
        model=model,
        panel=panel,
        criterion=criterion,
        coordinates=found.x,
        log_likelihood=-float(found.fun),
        link=reliance_link(model, panel),
        ratings=ratings,
    )


def _loss(panel: Panel, chosen: type[TrustDynamics], criterion: str = "step") -> Loss:
    """Return minus the log-likelihood of all people's ratings as a function of coordinates."""
    people = len(panel)

    def loss(x: np.ndarray) -> np.ndarray:
        # Everybody under the first coordinates, then everybody under the second …
        everybody = panel.of(np.tile(np.arange(people), len(x)))
        model = with_parameters(chosen, np.repeat(x, people, axis=0))
        likelihood = log_likelihood(model, everybody, criterion == "free")
        return -likelihood.reshape(len(x), people).sum(axis=1)

    return loss


def _starts(
    loss: Loss, chosen: type[TrustDynamics], panel: Panel, criterion: str
) -> list[np.ndarray]:
    """
    Return where searches begin: at the defaults, at the best of points drawn about them, and where
    the model is (3.2) as fitted, if it contains (3.2).
    """
    first = coordinates_of(chosen())
    drawn = first + 2.0 * np.random.default_rng(0).standard_normal((DRAWN, first.size))
    starts = [first, *drawn[np.argsort(loss(drawn), kind="stable")[:BEST]]]
    if chosen.as_performance:
        simple = fitted(panel, MODELS["performance"], criterion).model
        starts.append(coordinates_of(chosen.as_performance(**vars(simple))))
    return starts


def optimum(loss: Loss, start: np.ndarray) -> OptimizeResult:
    """Return the coordinates of least loss, `x`, and the loss, `fun`."""
    if not start.size:
        return OptimizeResult(x=start, fun=loss(start[None])[0])
    return minimize(
        lambda x: value_and_slope(loss, x),
        np.clip(start, -EDGE, EDGE),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-EDGE, EDGE)] * start.size,
        options={"ftol": 1e-15, "gtol": 1e-6},
    )


def value_and_slope(loss: Loss, x: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the loss and its slope, by differences."""
    step = STEP * np.eye(x.size)
    here, *beside = loss(np.vstack([x, x + step, x - step]))
    ahead, behind = np.split(np.array(beside), 2)
    return here, (ahead - behind) / (2.0 * STEP)


def profile_ends(loss: Loss, centre: np.ndarray) -> np.ndarray:
    """
    Return the ends of 95 % intervals of coordinates, shape (2, parameters).

    They are the least and the greatest value of each coordinate among all points whose
    log-likelihood is at most 1.92 less than that of the centre: the profile of the likelihood, D.
    J. Venzon, S. H. Moolgavkar, Applied Statistics 37(1), 1988. An end is infinite where a
    parameter reaches its bound before.
    """
    step = STEP * np.eye(centre.size)
    ahead, behind = ([value_and_slope(loss, x)[1] for x in centre + s * step] for s in (1, -1))
    curvatures, vectors = np.linalg.eigh(np.subtract(ahead, behind) / (2.0 * STEP))
    # Along these axes the loss is about equally curved near the centre.
    axes = vectors / np.sqrt(np.maximum(curvatures, FLAT))

    def along(z: np.ndarray) -> np.ndarray:
        return loss(centre + z @ axes.T)

    least = loss(centre[None])[0]

    @cache
    def room(*z: float) -> tuple[float, np.ndarray]:
        """Return by how much the log-likelihood may still fall, and its slope."""
        value, slope = value_and_slope(along, np.array(z))
        return least + FALL - value, -slope

    both = np.vstack([axes, -axes])
    offset = np.append(centre, -centre)
    within = [
        {"type": "ineq", "fun": lambda z: room(*z)[0], "jac": lambda z: room(*z)[1]},
        {"type": "ineq", "fun": lambda z: EDGE - offset - both @ z, "jac": lambda _: -both},
    ]

    def farthest(way: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return a point within, far along a way."""
        z = minimize(
            lambda z: -way @ z,
            start,
            jac=lambda _: -way,
            method="SLSQP",
            constraints=within,
            options={"ftol": 1e-7},
        ).x
        # A search may stop outside: back towards the centre then.
        z = np.linalg.solve(axes, np.clip(centre + axes @ z, -EDGE, EDGE) - centre)
        if room(*z)[0] < -TOLERANCE:
            z = z * brentq(lambda share: least + FALL - along(share * z[None])[0], 0.0, 1.0)
        return z

    def reach(way: np.ndarray) -> float:
        """Return how far the points within lie along a way, at the most."""
        # From where the end would be were the loss quadratic, then anew while that leads on, as a
        # search may stop at a bend.
        start = centre + axes @ way * np.sqrt(2.0 * FALL) / np.linalg.norm(way)
        behind = np.zeros(way.size)
        end = farthest(way, np.linalg.solve(axes, np.clip(start, -STEEP, STEEP) - centre))
        while way @ (end - behind) > NEAR:
            behind, end = end, max(end, farthest(way, end), key=way.dot)
        return way @ end

    signs = np.array([[-1.0], [1.0]])
    ends = centre + signs * [[reach(sign * way) for way in axes] for sign in signs]
    return np.where(np.abs(ends) < EDGE - STEP, ends, np.copysign(np.inf, ends))


def reliance_link(model: TrustDynamics, panel: Panel) -> tuple[float, float]:
    """Return the link of reliance that is likeliest, given what a model says of trust."""
    asked = np.isfinite(panel.events.followed)
    if not asked.any():
        return np.nan, np.nan
    preference = predict(model, panel).preference[asked]
    relied = panel.events.followed[asked]

    def loss(x: np.ndarray) -> float:
        odds = x[0] + x[1] * preference
        # A weak prior: where trust and reliance are one step the slope has no maximum.
        return np.mean(np.logaddexp(0.0, odds) - relied * odds) + 1e-5 * x @ x

    return tuple(minimize(loss, np.zeros(2), jac="3-point", method="BFGS").x.tolist())
