"""The operator's model, (2.5)-(2.6): `fit_human`, structure, sensitivities, initial guess."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from trustlab.identification.fit_result import FitResult
from trustlab.identification.fitting import fit, refuse_options
from trustlab.identification.output_error import SHALLOW, Problem
from trustlab.identification.regression import LeastSquares, regression, simulated_result
from trustlab.identification.runs import (
    LogSettings,
    Run,
    as_columns,
    block_means,
    joined,
    log_settings,
    read_runs,
)
from trustlab.identification.structure import (
    MODEL_STEP,
    POSTERIOR,
    UNIT_MARGIN,
    Coordinate,
    IdentificationError,
    Parameter,
    Structure,
)
from trustlab.models.compiled import njit
from trustlab.models.tsc import (
    HumanModel,
    next_utilization,
    performance_curve,
    yerkes_dodson,
)
from trustlab.sessions.session import Session

EDGE = 1e-9
"""(2.6) has an infinite slope at r = 0 and r = 1; its slope is taken this far inside."""

GRID_R0 = np.array([0.03, 0.3, 0.6, 0.9, 0.999])
GRID_BETA = np.linspace(0.15, 0.95, 9)


def fit_human(
    sessions: Session | Iterable[Session],
    method: str = "output_error",
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    log: LogSettings | None = None,
    **settings: Any,
) -> FitResult:
    """
    Identify the human model (2.5)-(2.6): a, beta, p_min, p_max, and r0 of every session.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode and p_h; parameters are shared, initial utilizations are not.
    method : {"output_error", "regression"}
        "output_error" minimises Σ (p_h − P_h(k))² of the simulated model (what the dissertation
        calls PEM). "regression" needs the logged utilization, column r: a by linear regression on
        (2.5), the rest by least squares of p_h on (2.6) at the logged r.
    fixed : mapping, optional
        Values to hold, by name: a, beta, p_min, p_max, r0.
    bounds : mapping, optional
        Bounds (low, high) by name; None leaves a side open.
    noise : {"auto", "white", "correlated", "hac"}
        What the standard errors allow for; see `fit`.
    log : LogSettings, optional
        How the log shows the model: window, step, mode_delay, stamp_error, robust.
    **settings : float or bool
        Fields of `LogSettings` as keywords; they replace those of `log`.

    Returns
    -------
    FitResult
        With a HumanModel.

    Raises
    ------
    IdentificationError
        If the data do not determine a parameter; it is named.
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> fit = tl.fit_human(tl.read_session("data/sessions/pilot.csv"))
    >>> round(fit.model.beta, 2), fit.success
    (0.74, True)
    """
    if method == "regression":
        log = log_settings(log, settings)
        refuse_options(fixed, bounds, noise, log)
        return _fit_at_logged_utilization(sessions, log)
    return fit(HUMAN, sessions, method, fixed, bounds, noise, log=log, **settings)


# --- the structure --------------------------------------------------------------------------------


@njit(inline="always")
def performance_slopes(r, beta):
    """Return the Yerkes–Dodson shape of (2.6) and its derivatives by r and β."""
    shape = yerkes_dodson(r, beta)
    by_beta = 0.0
    if 0.0 < r < 1.0:
        by_beta = shape * (np.log(r / beta) - np.log((1.0 - r) / (1.0 - beta)))
    inside = min(max(r, EDGE), 1.0 - EDGE)
    steep = shape if inside == r else yerkes_dodson(inside, beta)
    return shape, steep * (beta / inside - (1.0 - beta) / (1.0 - inside)), by_beta


SLOPES = np.dtype([(name, float) for name in ("a", "beta", "p_min", "p_max", "r0")])


@njit
def _simulate_with_slopes(mode, a, beta, p_min, p_max, r0, p_h, by):
    """Run (2.5)-(2.6) and their derivatives by every parameter, into `p_h` and the records `by`."""
    r = r0
    r_a = 0.0  # ∂r/∂a
    r_0 = 1.0  # ∂r/∂r0
    span = p_max - p_min
    for k in range(mode.size):
        shape, slope, by_beta = performance_slopes(r, beta)  # (2.6)
        p_h[k] = p_min + span * shape
        row = by[k]
        row.a = span * slope * r_a
        row.beta = span * by_beta
        row.p_min = 1.0 - shape
        row.p_max = shape
        row.r0 = span * slope * r_0
        # (2.5) differentiated by a: ∂r(k+1) = a ∂r(k) + r(k) − M(k).
        r_a = a * r_a + r - mode[k]
        # (2.5) differentiated by r0: ∂r(k+1) = a ∂r(k).
        r_0 = a * r_0
        r = next_utilization(r, mode[k], a)  # (2.5)


def simulate_human(run: Run, *parameters: float) -> tuple[np.ndarray, np.ndarray]:
    """Return P_h and its derivatives by a, beta, p_min, p_max and r0 as records, shape (N,)."""
    p_h, by = run.scratch("P_h"), run.scratch("of P_h", SLOPES)
    _simulate_with_slopes(run["mode"], *parameters, p_h, by)
    return p_h, by


def _sensitivities(run: Run, a, beta, p_min, p_max, r0):
    p_h, by = simulate_human(run, a, beta, p_min, p_max, r0)
    return [p_h], [as_columns(by)]


def rate_parameter(prefix: str = "") -> Parameter:
    """Return the parameter a: the share kept over one sample."""
    hint = "record a rise or a decay long enough to show its curvature"
    return Parameter(f"{prefix}a", search="rate", hint=hint)


def range_parameters(prefix: str = "") -> tuple[Parameter, Parameter]:
    """Return p_min and p_max, each judged by the distance between them."""
    span = (f"{prefix}p_min", f"{prefix}p_max")
    begin = "record a phase long enough to"
    return (
        Parameter(span[0], span=span, hint=f"{begin} settle at the least performance"),
        Parameter(span[1], span=span, hint=f"{begin} come near the greatest performance"),
    )


def human_parameters(prefix: str = "") -> tuple[Parameter, ...]:
    """Return a, beta, p_min and p_max of (2.5)-(2.6)."""
    hint = "record phases that take utilization to both sides of the best one"
    beta = Parameter(f"{prefix}beta", search="logit", hint=hint)
    return (rate_parameter(prefix), beta, *range_parameters(prefix))


def initial_utilization(beta: str = "beta") -> Parameter:
    """Return r0; `beta` is the name of the parameter β of the same operator."""

    def coordinate(guess: Mapping) -> Coordinate:
        # Close to rest (2.6) grows as r^β, with infinite slope: in x = r0^β the likelihood is
        # smooth there.
        power = guess[beta]
        return Coordinate(
            lambda r: r**power,
            lambda x: x ** (1.0 / power),
            lambda x: max(x, EDGE**power) ** (1.0 / power - 1.0) / power,
            0.0,
            1.0,
        )

    return Parameter(
        "r0",
        0.0,
        1.0,
        search=coordinate,
        ends={0.0: "a rested operator", 1.0: "an operator at full load"},
    )


def build_human(a: float, beta: float, p_min: float, p_max: float) -> HumanModel:
    """Return the model, or say what about the data contradicts (2.6)."""
    if not p_max > p_min:
        raise IdentificationError(
            "human performance is not greatest between rest and full load in these data (the fit "
            f"has p_max = {p_max:.4g} below p_min = {p_min:.4g}), so (2.6) does not describe them",
            ("p_min", "p_max"),
        )
    return HumanModel(float(a), float(beta), float(p_min), float(p_max))


# --- the initial guess ----------------------------------------------------------------------------


@njit
def solve_pair(s11, s12, s22, t1, t2):
    """Solve normal equations of two unknowns; NaN where they are singular."""
    determinant = s11 * s22 - s12 * s12
    if determinant <= 1e-12 * s11 * s22:
        return np.nan, np.nan
    return (s22 * t1 - s12 * t2) / determinant, (s11 * t2 - s12 * t1) / determinant


GRID_POINT = np.dtype([(name, float) for name in ("squares", "a", "beta", "p_min", "p_max", "r0")])


@njit
def _search_grid(mode, p_h, starts, rates, betas, rests, out):
    """
    Fill Σ e² and parameters at every grid point with p_max > p_min.

    `starts` are the first samples of the runs, and the end of the last one.
    """
    total = np.sum(p_h**2)
    log_r = np.empty(p_h.size)  # ln r and ln(1 − r) of (2.6), shared by all beta
    log_q = np.empty(p_h.size)
    number = 0
    for a in rates:
        for rest in rests:
            for i in range(starts.size - 1):
                r = rest
                for k in range(starts[i], starts[i + 1]):
                    after = next_utilization(r, mode[k], a)  # (2.5)
                    middle = 0.5 * (r + after)
                    inside = 0.0 < middle < 1.0
                    log_r[k] = np.log(middle) if inside else -np.inf
                    log_q[k] = np.log(1.0 - middle) if inside else -np.inf
                    r = after
            for beta in betas:
                # P_h = p_min (1 − shape) + p_max shape, (2.6), is linear in p_min and p_max: they
                # are solved for.
                s11 = s12 = s22 = t1 = t2 = 0.0
                top = beta * np.log(beta) + (1.0 - beta) * np.log(1.0 - beta)
                for k in range(starts[0], starts[-1]):
                    high = np.exp(beta * log_r[k] + (1.0 - beta) * log_q[k] - top)
                    low = 1.0 - high
                    s11 += low * low
                    s12 += low * high
                    s22 += high * high
                    t1 += low * p_h[k]
                    t2 += high * p_h[k]
                p_min, p_max = solve_pair(s11, s12, s22, t1, t2)
                if p_max > p_min:
                    point = out[number]
                    point.squares = total - p_min * t1 - p_max * t2
                    point.a = a
                    point.beta = beta
                    point.p_min = p_min
                    point.p_max = p_max
                    point.r0 = rest
                number += 1


def decay_rates(longest: int, length: int, limits: tuple[float, float]) -> np.ndarray:
    """Return shares kept over a block, for time constants from a few samples to many runs."""
    time_constants = np.geomspace(min(20.0, 0.2 * longest), 4.0 * longest, 18)
    return np.unique(np.clip(1.0 - 1.0 / time_constants, *limits)) ** length


def undo_blocks(rate: float, length: int) -> float:
    """Return the share kept over one sample, of that kept over a block."""
    return min(max(rate ** (1.0 / length), UNIT_MARGIN), 1.0 - UNIT_MARGIN)


def human_guess(
    runs: list[Run], limits: Mapping[str, tuple[float, float]]
) -> list[dict[str, float]]:
    """Return starting values from a coarse search on block means, the best first."""
    means, length = block_means(runs)
    starts = np.cumsum([0, *(run.size for run in means)])
    betas = np.unique(np.clip(GRID_BETA, *limits["beta"]))
    rests = np.unique(np.clip(GRID_R0, *limits["r0"]))
    rates = decay_rates(max(run.size for run in runs), length, limits["a"])
    p_h = joined(means, "p_h")
    grid = np.full(rates.size * rests.size * betas.size, np.inf, GRID_POINT)
    _search_grid(joined(means, "mode"), p_h, starts, rates, betas, rests, grid)
    if not np.isfinite(grid["squares"]).any():
        high = p_h.max() + (1e-3 * max(abs(p_h.max()), 1.0) if np.ptp(p_h) == 0.0 else 0.0)
        middle = (0.0, rates[rates.size // 2], betas[betas.size // 2], p_h.min(), high, rests[0])
        grid = np.array([middle], GRID_POINT)
    # The likelihood of (2.6) has several optima (a slow operator beyond the best utilization looks
    # like a quick one below it): the best points of different rates and initial utilizations are
    # refined, and optima as good kept.
    points = [_refined(means, point, limits, length) for point in _best_apart(grid, rates)]
    floor = 1e-12 * float(p_h @ p_h)
    deep: list[tuple[float, ...]] = []
    for point in sorted(points, key=lambda point: point[0]):
        if not deep or _another_optimum(point, deep, p_h.size, floor):
            deep.append(point)
    guesses = []
    for _, rate, *others in deep:
        values = (undo_blocks(rate, length), *others)
        guesses.append(dict(zip(HUMAN.names, values, strict=True)))
    return guesses


def _another_optimum(point: tuple, deep: list[tuple], samples: int, floor: float) -> bool:
    """Return whether a point is nearly as deep as the best, and apart from all `deep` ones."""
    squares, _, beta, *_ = point
    if samples * np.log((squares + floor) / (deep[0][0] + floor)) >= SHALLOW:
        return False
    return not any(
        abs(squares / optimum[0] - 1.0) < 1e-4 and abs(beta - optimum[2]) < 0.01 for optimum in deep
    )


def _best_apart(grid: np.ndarray, rates: np.ndarray, most: int = 6) -> list[np.void]:
    """Return the best grid points, one for each initial utilization and third of the rates."""
    grid = grid[np.argsort(grid["squares"], kind="stable")]
    grid = grid[np.isfinite(grid["squares"])]
    thirds = np.searchsorted(rates, grid["a"]) * 3 // max(rates.size, 1)
    _, first = np.unique(np.column_stack([thirds, grid["r0"]]), axis=0, return_index=True)
    return list(grid[np.sort(first)[:most]])


def _refined(means: list[Run], point: np.void, limits: Mapping, length: int) -> tuple[float, ...]:
    """Search from one grid point on block means, with p_min and p_max free even if fixed."""
    guess = {name: float(point[name]) for name in HUMAN.names}
    problem = Problem(HUMAN, means, guess)
    rate = [min(max(bound**length, UNIT_MARGIN), 1.0 - UNIT_MARGIN) for bound in limits["a"]]
    free = (-np.inf, np.inf)
    wide = {"a": rate, "beta": limits["beta"], "p_min": free, "p_max": free, "r0": limits["r0"]}
    low, high = problem.ends(wide)
    start = np.clip(problem.vector(guess), low, high)
    minimum = problem.search(start, low, high, tolerance=1e-2, max_iterations=25)
    a, beta, p_min, p_max, *states = problem.from_search(minimum.x)
    if not p_max > p_min:
        return tuple(map(float, point.tolist()))
    return (minimum.equations.squares.sum(), a, beta, p_min, p_max, np.median(states))


HUMAN = Structure(
    "human model (2.5)-(2.6)",
    parameters=human_parameters(),
    initial=(initial_utilization(),),
    outputs=("p_h",),
    sensitivities=_sensitivities,
    guess=human_guess,
    model=build_human,
    derived={"b": lambda at: 1.0 - at["a"]},
    step=MODEL_STEP,
    remedy=POSTERIOR,
)


# --- least squares at the logged utilization ------------------------------------------------------


def _fit_at_logged_utilization(sessions: Any, log: LogSettings) -> FitResult:
    """Fit (2.5) to the logged utilization and (2.6) to performance against it."""
    from scipy import linalg

    try:
        runs = read_runs(sessions, "mode", "p_h", "r", log=log)
    except ValueError as error:
        raise IdentificationError(
            'method "regression" needs the logged utilization, column r, because (2.6) is not '
            f'linear in its parameters: {error}; without it use method="output_error", as the '
            "dissertation does",
            ("a", "beta"),
        ) from error
    # (2.5) as a regression without constant: r(k+1) − M(k) = a (r(k) − M(k)).
    design = np.concatenate([run["r"][:-1] - run["mode"][:-1] for run in runs])[None, :]
    target = np.concatenate([run["r"][1:] - run["mode"][:-1] for run in runs])
    rate = regression(design, target, ("a",))
    curve = _fit_curve(joined(runs, "r"), joined(runs, "p_h"))
    estimate = curve._replace(
        values=np.r_[rate.values, curve.values],
        covariance=linalg.block_diag(rate.covariance, curve.covariance),
    )
    initial = [(float(run["r"][0]),) for run in runs]
    caution = "Least squares at the logged utilization: noise in column r biases a and beta."
    return simulated_result(HUMAN, runs, estimate, initial, caution)


def _fit_curve(r: np.ndarray, p_h: np.ndarray) -> LeastSquares:
    """Fit beta, p_min and p_max of (2.6) to performance against utilization."""
    from scipy import optimize

    # (2.6) is linear in p_min and p_max: a search over beta alone, the other two by regression at
    # each.
    def at(beta: float) -> LeastSquares:
        shape = performance_curve(r, beta, 0.0, 1.0)
        return regression(np.stack([1.0 - shape, shape]), p_h, ("p_min", "p_max"))

    def squares(beta: float) -> float:
        residuals = at(beta).residuals
        return float(residuals @ residuals)

    search = optimize.minimize_scalar(
        squares, bounds=(1e-4, 1.0 - 1e-4), method="bounded", options={"xatol": 1e-10}
    )
    beta = float(search.x)
    best = at(beta)
    # Regressing the residuals on the derivatives by all three moves nothing, but yields their joint
    # covariance.
    step = 1e-6 * min(beta, 1.0 - beta)
    above = performance_curve(r, beta + step, *best.values)
    below = performance_curve(r, beta - step, *best.values)
    shape = performance_curve(r, beta, 0.0, 1.0)
    slopes = np.stack([(above - below) / (2.0 * step), 1.0 - shape, shape])
    joint = regression(slopes, best.residuals, ("beta", "p_min", "p_max"))
    return joint._replace(values=np.r_[beta, best.values], residuals=best.residuals)
