"""
What identification reads from sessions, and how a log shows a model.

Columns become arrays; outputs may be means over a window, and the mode may act later than its stamp
says. What a log shows beyond the simulated outputs, e = y − ŷ, is noise: white, or an AR(1) process
plus white noise, whose Kalman filter leaves prediction errors; Newey and West's sum of scores
allows for any other. Samples far outside of it are left out.

[L] Ljung, *System Identification: Theory for the User*, 2nd ed., 1999.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from trustlab.identification.model import COORDINATES, IdentificationError, Model
from trustlab.models.checks import (
    Checked,
    NotNegative,
    did_you_mean,
    not_negative,
    of_class,
    warn,
)
from trustlab.models.compiled import njit
from trustlab.sessions.session import Session

HOW_TO_GET = (
    "pass a session or a list of them; read a file with trustlab.read_session(path), or make one "
    'of a table: trustlab.Session(frame.set_index("t"))'
)


@dataclass(frozen=True)
class LogSettings(Checked):
    """
    How a log shows the model: averaging, errors of the time stamps, outliers.

    Every fit takes these settings as keywords, or a `LogSettings` as `log`.

    Parameters
    ----------
    window : float, optional
        Length W [s] of the moving window over which p_r and p_h were averaged, as
        `with_performance` does, a whole number of samples; 0 if they were not averaged. By default
        each session's metadata decide. Other columns are no means.
    mode_delay : bool
        Whether to estimate the delay between the logged time of a change of mode and its effect
        [s], as a further parameter `mode_delay`.
    stamp_error : float, optional
        Standard deviation of the errors in the logged times of switches [s], independent from
        switch to switch. They widen the intervals, and so does an error that all switches share, as
        far as the residuals allow for one. By default the session's metadata decide
        (`stamp_error`); else 0.29 samples, the error of a time that is rounded to a sample, and 0
        for simulated sessions that were not resampled.
    robust : bool
        Whether to leave out samples that lie far from the model, such as dropouts; the message
        counts them.

    Raises
    ------
    ValueError
        If a value is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> log = tl.LogSettings(window=0.0, stamp_error=0.05)
    >>> tl.fit_human(session, log=log).success
    True
    """

    window: NotNegative | None = None
    mode_delay: bool = False
    stamp_error: NotNegative | None = None
    robust: bool = True


def log_settings(log: LogSettings | None, changes: Mapping[str, Any]) -> LogSettings:
    """Return a user's settings of the log: an object, keywords, or an object changed by them."""
    known = LogSettings.__dataclass_fields__
    for name in changes:
        if name not in known:
            hint = did_you_mean(name, known)
            raise TypeError(f"{name!r} is no argument, nor a setting ({', '.join(known)}){hint}")
    return replace(LogSettings() if log is None else of_class("log", log, LogSettings), **changes)


@dataclass(frozen=True, eq=False)
class Run:
    """
    One session as arrays: columns of shape (N,) by name, and facts that messages need.

    Outputs that are performance are means over `window` samples; where these are undone, they were
    over `undone`.
    """

    label: str
    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    synthetic: bool = False
    participant: object = None
    window: int = 1
    undone: int = 1
    stamp_error: float = 0.0

    def __getitem__(self, name: str) -> np.ndarray:
        column = self.columns[name].view()
        column.flags.writeable = False  # no simulation changes what it is compared with
        return column

    @property
    def size(self) -> int:
        """Number of samples."""
        return next(iter(self.columns.values())).size

    @property
    def sample_time(self) -> float:
        """Time between samples [s]."""
        return float(self.t[-1] - self.t[0]) / (self.size - 1)

    def changed(self, columns: Mapping[str, np.ndarray], **fields: Any) -> "Run":
        """Return the run with some columns, and perhaps fields, changed."""
        return replace(self, columns={**self.columns, **columns}, **fields)

    def mapped(self, names: Iterable[str], change: Callable) -> "Run":
        """Return the run with some columns changed by `change(values, window)`."""
        return self.changed({name: change(self[name], self.window) for name in names})


def read_runs(
    sessions: Session | Iterable[Session], *columns: str, log: LogSettings | None = None
) -> list[Run]:
    """
    Take the columns that a fit needs out of one or several sessions with the same sample time.

    Where `log` leaves the window or the error of the stamps open, each session's metadata decide.
    """
    log = log or LogSettings()
    sessions = each_once(as_list(sessions))
    for session in sessions:
        session.require(*columns)
        if abs(session.sample_time - sessions[0].sample_time) > 1e-6 * sessions[0].sample_time:
            raise IdentificationError(
                f"the parameters belong to one sample time, but {sessions[0].label} has "
                f"{sessions[0].sample_time:g} s and {session.label} has {session.sample_time:g} s; "
                "resample by name when reading"
            )
    means = averaged(columns)
    if log.window is not None and not means:
        raise ValueError("window is that of p_r and p_h, which this model lacks; leave it out")
    windows = [_window(session, log.window) if means else 1 for session in sessions]
    if None in windows:
        warn(
            f"{sessions[windows.index(None)].label}: nothing says whether p_r and p_h are means "
            "over a moving window, as (2.4) and (2.7) are, and a fit that takes means for the "
            "values themselves is wrong: state window=… [s], or window=0 if they are no means (in "
            "a recipe: performance_window = …; Session.with_performance notes its own)"
        )
    return [
        Run(
            session.label,
            session.t,
            {name: session[name].copy() for name in columns},
            session.metadata.synthetic,
            session.metadata.participant,
            window or 1,
            stamp_error=_stamp_error(session, log.stamp_error),
        )
        for session, window in zip(sessions, windows, strict=True)
    ]


def as_list(sessions: Any) -> list:
    """Return one or several sessions as a list."""
    if isinstance(sessions, Session | Mapping | pd.DataFrame) or not isinstance(sessions, Iterable):
        return [sessions]
    sessions = list(sessions)
    if not sessions:
        raise IdentificationError("no session was given; pass one or a list of them")
    return sessions


def each_once(sessions: list) -> list[Session]:
    """Return a list of sessions; refuse what is none, and the same samples twice."""
    seen: dict[str, list[Session]] = {}
    for session in sessions:
        of_class("sessions", session, Session, HOW_TO_GET)
        others = seen.setdefault(session.label, [])
        if any(session.data.equals(other.data) for other in others):
            raise IdentificationError(
                f"{session.label} occurs twice, with equal samples: they would count as twice the "
                "data; pass every run once"
            )
        others.append(session)
    return sessions


def _stamp_error(session: Session, stated: float | None) -> float:
    """Return the standard deviation of the mode's time stamps [s]."""
    metadata = session.metadata
    error = metadata.more.get("stamp_error") if stated is None else stated
    if error is not None:
        return not_negative("stamp_error", error)
    # People switch at any time between two samples, simulations on one.
    exact = metadata.synthetic and "resampled" not in metadata.more
    return 0.0 if exact else session.sample_time / np.sqrt(12.0)


def _window(session: Session, stated: float | None) -> int | None:
    """Return the window of a session's means in samples, 1 for none; None where nobody says."""
    more = session.metadata.more
    window = more.get("performance_window") if stated is None else stated
    if window and more.get("performance_cut"):
        raise IdentificationError(
            f"{session.label} was cut after its performance was averaged, so that its first means "
            "hold what is no longer there; cut the log first, then call with_performance"
        )
    if window is None and not session.metadata.synthetic:
        return None
    step, window = session.sample_time, not_negative("window", window or 0.0)
    samples = round(window / step)
    if abs(samples * step - window) > 0.01 * window:
        raise ValueError(
            f"window = {window:g} s is no whole number of samples of {session.label} (of {step:g} "
            f"s); state {max(1, samples) * step:g} s, or 0 if p_r and p_h are no means"
        )
    return max(1, samples)


def joined(runs: list[Run], name: str) -> np.ndarray:
    """Return one column of all runs, one after the other."""
    return np.concatenate([run[name] for run in runs])


def never_switches(runs: list[Run]) -> bool:
    """Return whether there is a mode, and it never changes within any run."""
    return all(np.ptp(run.columns.get("mode", [0.0, 1.0])) == 0.0 for run in runs)


def in_rows(values: np.ndarray, length: int) -> np.ndarray:
    """Return values in rows of so many; what does not fill a row is left out."""
    return values[: values.size // length * length].reshape(-1, length)


# Block means that a rough search looks at.
BLOCKS = 500


def block_means(runs: list[Run]) -> tuple[list[Run], int]:
    """
    Return block means of all columns, and the block length.

    There are about `BLOCKS` in all, and at least eight per run.
    """
    sizes = [run.size for run in runs]
    length = max(1, min(sum(sizes) // BLOCKS, min(sizes) // 8))
    means = []
    for run in runs:
        columns = {n: in_rows(values, length).mean(axis=1) for n, values in run.columns.items()}
        means.append(Run(run.label, in_rows(run.t, length)[:, 0], columns))
    return means, length


# --- means over a window -------------------------------------------------------------------------


def averaged(names: Iterable[str]) -> list[str]:
    """Return those of some columns that a window may average: performance."""
    return [name for name in names if name in ("p_r", "p_h")]


def counts(size: int, window: int) -> np.ndarray:
    """Return each window's sample count; windows at the start are shorter."""
    return np.minimum(np.arange(1.0, size + 1.0), window)


def window_means(values: np.ndarray, window: int) -> np.ndarray:
    """Return the means over the last `window` samples, down the columns."""
    sums = np.cumsum(values, axis=0)
    sums[window:] -= sums[:-window].copy()
    return (sums.T / counts(len(values), window)).T


def undo_window(means: np.ndarray, window: int) -> np.ndarray:
    """Return the values that `window_means` was made of."""
    sums = means * counts(means.size, window)
    # Each sample the window gains the new value and loses the oldest: z(k) = Δs(k) + z(k − W).
    gained = np.pad(np.diff(sums, prepend=0.0), (0, -means.size % window))
    return gained.reshape(-1, window).cumsum(axis=0).ravel()[: means.size]


def undone(run: Run, names: Iterable[str]) -> Run:
    """Return a run with the values that the means in these columns were made of."""
    return run.mapped(averaged(names), undo_window).changed({}, window=1, undone=run.window)


# --- a mode that acts late ------------------------------------------------------------------------


def delayed(model: Model) -> Model:
    """Return a model with one more unknown: how much later [s] the mode acts than it is stamped."""

    def simulate(run: Run, mode_delay, **values):
        outputs = model.outputs_of(late(run, mode_delay[0]), values)
        moved = np.flatnonzero(mode_delay != mode_delay[0])
        if moved.size == 0:
            return tuple(outputs)
        # Simulations bend where a delay takes in another sample: the slope over a whole sample
        # takes the place of that at a point.
        of_moved = {name: column[moved] for name, column in values.items()}
        halves = mode_delay[0] + run.sample_time * np.array([0.5, -0.5])
        ends = [model.outputs_of(late(run, delay), of_moved) for delay in halves]
        for out, high, low in zip(outputs, *ends, strict=True):
            out[:, moved] += (high - low) / run.sample_time * (mode_delay[moved] - mode_delay[0])
        return tuple(outputs)

    def starts(runs: list[Run], limits: Mapping):
        own = model.starts(runs, limits) if model.starts else [{}]
        return [{**values, "mode_delay": 0.0} for values in own]

    return replace(
        model,
        names=("mode_delay", *model.names),
        low=(-np.inf, *model.low),
        high=(np.inf, *model.high),
        size=model.useful,
        simulate=simulate,
        starts=starts,
        lanes=True,
    )


def late(run: Run, delay: float) -> Run:
    """Return a run whose mode acts later by `delay` [s]; part of a sample becomes a share of it."""
    if delay == 0.0 or "mode" not in run.columns:
        return run
    at = np.arange(run.size, dtype=float)
    return run.changed({"mode": np.interp(at - delay / run.sample_time, at, run["mode"])})


# --- noise ----------------------------------------------------------------------------------------

# Lags of the Ljung–Box test that chooses what the noise model and standard errors allow for.
LAGS = 25

# p value of the Ljung–Box test below which residuals do not count as white.
NOT_WHITE = 1e-3

# Standard errors from the middle of a 95 % interval to its end.
HALF_WIDTH = float(special.ndtri(0.975))

# Robust standard deviations beyond which a sudden residual counts as an outlier: of white noise one
# sample in 5·10⁸ is.
FAR = 6.0


def pooled_correlation(errors: list[np.ndarray], others: list[np.ndarray], lags: int) -> np.ndarray:
    """
    Return the correlation of e(k) with u(k − lag), lag = 0, 1, …, pooled over runs.

    Means are those of all runs, as in statsmodels. 0 where one of them never moves.
    """

    def apart(runs: list[np.ndarray]) -> np.ndarray:
        """Return deviations from the mean, with zeros between runs, so that no product crosses."""
        mean = np.concatenate(runs).mean()
        return np.concatenate([np.pad(run - mean, (0, lags)) for run in runs])

    e, u = apart(errors), apart(others)
    sums = np.array([e[lag:] @ u[: u.size - lag] for lag in range(lags + 1)])
    scale = np.sqrt((e @ e) * (u @ u))
    return sums / scale if scale > 0.0 else sums


def ljung_box(residuals: list[np.ndarray], lags: int) -> tuple[float, int, float]:
    """
    Return Q = n(n + 2) Σ ρ²(l)/(n − l) over lags l, its degrees of freedom and its p value.
    """
    samples = sum(map(len, residuals))
    lags = min(lags, samples - 1)
    terms = pooled_correlation(residuals, residuals, lags)[1:] ** 2 / (
        samples - np.arange(1, lags + 1)
    )
    q = samples * (samples + 2.0) * np.sum(terms)
    return float(q), lags, float(special.chdtrc(lags, q))


def whiteness_p(residuals: list[np.ndarray]) -> float:
    """Return the p value of the Ljung–Box test."""
    return ljung_box(residuals, LAGS)[2]


def hac_lags(residuals: list[np.ndarray]) -> int:
    """
    Return the bandwidth of the Bartlett window for residuals, by Andrews' rule for an AR(1).

    The rule, 1.1447 (α n)^(1/3) with α = 4ρ²/((1 − ρ)²(1 + ρ)²), is equations (6.2) and (6.4) of
    Andrews (1991), *Econometrica* 59, 817-858; here at most a quarter of the shortest run.
    """
    # White noise on top hides slow noise from the first autocorrelation, but averages out in
    # blocks: the rule is applied to the means over 1, 2, 4, 8 … samples too, and the widest result
    # taken.
    shortest = min(map(len, residuals))
    widest = 0.0
    length = 1
    while length == 1 or shortest // length >= 50:
        means = [in_rows(run, length).mean(axis=1) for run in residuals]
        total = sum(map(len, means))
        rho = min(abs(float(pooled_correlation(means, means, 1)[1])), 0.9999)
        if length == 1 or rho > 3.0 / np.sqrt(total):
            alpha = 4.0 * rho**2 / (1.0 - rho**2) ** 2
            widest = max(widest, length * 1.1447 * (alpha * total) ** (1.0 / 3.0))
        length *= 2
    return int(min(widest, shortest // 4))


def hac_matrix(scores: np.ndarray, lags: int) -> np.ndarray:
    """
    Return the Bartlett-weighted sum of products of scores, shape (n, p), over lags (Newey–West).
    """
    # Sums over lags + 1 scores in a row hold each product at lag l in lags + 1 − l places: as
    # Bartlett weights it.
    total = np.cumsum(np.pad(scores, ((lags + 1, lags), (0, 0))), axis=0)
    sums = total[lags + 1 :] - total[: -lags - 1]
    return sums.T @ sums / (lags + 1)


class Noise(NamedTuple):
    """AR(1) noise under white noise: share of the variance, correlation of successive samples."""

    share: float = 0.0
    memory: float = 0.0


class Process(NamedTuple):
    """
    Noise y = c x + v of a first-order process x and white noise v, from one value to the next.

    x becomes φ x + w; `drive`, `error` and `both` are the variance of w, that of v, and their
    covariance; `variance` is that of x.
    """

    phi: float
    c: float
    drive: float
    error: float
    both: float
    variance: float


@njit
def process(white, slow, memory, samples):
    """
    Return the noise of means over `samples`.

    Of each sample, `white` and `slow` are the deviations of white and AR(1) noise; `memory` is the
    correlation of successive samples of the latter.
    """
    total = 0.0
    power = 1.0
    error = 0.0
    both = 0.0
    # After m samples a shock has added `total` = 1 + … + φ^(m − 1) to the sum.
    for m in range(samples):
        if m > 0:
            error += total * total
            both += total * power
        total += power
        power *= memory
    shock = slow * slow * (1.0 - memory * memory)
    return Process(
        power,
        total / samples,
        slow * slow * (1.0 - power * power),
        (shock * error / samples + white * white) / samples,
        shock * both / samples,
        slow * slow,
    )


@njit
def filter_columns(columns, known, noise, errors):
    """
    Write the prediction errors of a Kalman filter, scaled to variance one; return Σ ln variance.

    Columns, shape (N, p), are filtered alike; where nothing is known the noise is only predicted
    (Kailath, Sayed and Hassibi, *Linear Estimation*, 2000, Section 9.5: correlated noises).
    """
    state = np.zeros(columns.shape[1])
    variance = noise.variance
    before = -1.0
    scale = 1.0
    gain = 0.0
    after = 0.0
    logarithm = 0.0
    logs = 0.0
    for k in range(columns.shape[0]):
        if not known[k]:
            for j in range(state.size):
                errors[k, j] = 0.0
                state[j] *= noise.phi
            variance = noise.phi * noise.phi * variance + noise.drive
            continue
        if abs(variance - before) > 1e-14 * variance:  # the filter settles within some samples
            before = variance
            total = noise.c * noise.c * variance + noise.error
            scale = 1.0 / np.sqrt(total)
            gain = (noise.phi * noise.c * variance + noise.both) / total
            after = noise.phi * noise.phi * variance + noise.drive - gain * gain * total
            logarithm = np.log(total)
        for j in range(state.size):
            error = columns[k, j] - noise.c * state[j]
            errors[k, j] = scale * error
            state[j] = noise.phi * state[j] + gain * error
        variance = after
        logs += logarithm
    return logs


def whiten(columns: np.ndarray, known: np.ndarray, noise: Noise) -> tuple[np.ndarray, float]:
    """
    Return columns, shape (N, p), whitened by a Kalman filter, and the log-determinant.

    Errors and their derivatives are filtered alike ([L] Section 4.3). Where nothing is known the
    columns are 0, so that white noise leaves them as they are.
    """
    if noise == Noise():
        return columns, 0.0
    errors = np.empty(columns.shape)
    of_samples = process(np.sqrt(1.0 - noise.share), np.sqrt(noise.share), noise.memory, 1)
    return errors, filter_columns(columns, known, of_samples, errors)


def scaled_roots(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return scales of the unknowns, and eigenvalues and -vectors with these at unit diagonal."""
    # Units of the unknowns do not decide what is singular.
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return scale, *np.linalg.eigh(matrix / np.outer(scale, scale))


def fitted_noise(products: Callable, samples: float, before: Noise) -> Noise:
    """
    Return the noise model of greatest restricted likelihood, near that of the round before.

    Restricted (Patterson & Thompson 1971, *Biometrika* 58, 545-554): the parameters are solved for
    at every noise model, and what they take from the residuals is allowed for. `products(noise)`
    are [e J]ᵀ[e J], whitened, and the log-determinant.
    """
    from scipy import optimize

    rate, odds = COORDINATES["rate"], COORDINATES["odds"]

    def noise_at(x: np.ndarray) -> Noise:
        memory = float(np.clip(rate.back(x[0]), 0.0, 1.0 - 1e-6))
        return Noise(float(odds.back(np.clip(x[1], -12.0, 12.0))), memory)

    def deviance(x: np.ndarray) -> float:
        gram, log_determinant = products(noise_at(x))
        scale, roots, vectors = scaled_roots(gram[1:, 1:])
        regular = roots > 1e-10
        along = (gram[0, 1:] / scale) @ vectors[:, regular]
        squares = max(gram[0, 0] - along @ (along / roots[regular]), 1e-300)
        value = (samples - regular.sum()) * np.log(squares) + log_determinant
        return value + np.log(roots[regular]).sum() + 2.0 * np.log(scale).sum()

    memories, shares, size = [0.3, 0.9, 0.99, 0.999], [0.05, 0.5, 0.95], 1.0
    if before != Noise():
        memories, shares, size = [before.memory], [before.share], 0.3
    starts = [np.array([rate.to(m), odds.to(s)]) for m in memories for s in shares]
    best = min(starts, key=deviance)
    simplex = best + size * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.5]])
    options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.02, "maxfev": 80}
    return noise_at(optimize.minimize(deviance, best, method="Nelder-Mead", options=options).x)


def outliers(errors: list[np.ndarray], known: list[np.ndarray]) -> list[np.ndarray]:
    """Return which residuals are far off and begin or end with a jump, as dropouts do."""
    sizes = np.abs(np.concatenate(errors)[np.concatenate(known)])
    # The standard deviation of Gaussian residuals with this median; a few thousand of those that
    # count so far tell it to a few per cent.
    limit = FAR * 1.4826 * float(np.median(sizes[:: 1 + sizes.size // 4000]))
    marks = []
    for error in errors:
        mark = np.abs(error) > limit
        jumps = np.abs(np.diff(error, prepend=0.0, append=0.0)) > limit
        ends = np.flatnonzero(np.diff(mark, prepend=False, append=False))
        for first, stop in ends.reshape(-1, 2):
            mark[first:stop] = jumps[first] or jumps[stop]
        marks.append(mark)
    return marks
