"""Continuous-time transfer functions of order 1 and 2 from logs, as (A.1) was identified."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, signal

from trustlab.identification.estimate import NOISES
from trustlab.identification.fitting import check_data, estimate_runs
from trustlab.identification.log import Run
from trustlab.identification.model import IdentificationError, Model
from trustlab.identification.result import FitResult, result_of
from trustlab.models.checks import finite_array, one_of, positive, whole_number
from trustlab.models.display import axes_or_new
from trustlab.models.uav import TransferFunction


@dataclass(frozen=True, eq=False, repr=False)
class TransferFunctionFit(FitResult):
    """A `FitResult` with a `TransferFunction`; `sigma` is one number, as there is one output."""

    sigma: float  # type: ignore[assignment]

    @property
    def measured(self) -> list[np.ndarray]:
        """Velocity as logged, per run."""
        return [run.measured["velocity"] for run in self.runs]

    @property
    def fitted(self) -> list[np.ndarray]:
        """Velocity as simulated, per run."""
        return [run.fitted["velocity"] for run in self.runs]

    @property
    def sample_time(self) -> float:
        """T [s]."""
        return float(self.runs[0].t[1])

    def plot(self, ax=None):
        """
        Plot the first run, measured and simulated, on given axes or new ones; return the axes.
        """
        ax = axes_or_new(ax)
        ax.plot(self.runs[0].t, self.measured[0], color="0.6", label="measured")
        ax.plot(self.runs[0].t, self.fitted[0], label=f"fitted, {self.fit_percent:.1f} %")
        ax.set(xlabel="t [s]", ylabel="velocity [m/s]")
        ax.legend()
        return ax


def fit_transfer_function(
    command, velocity, sample_time: float, order: int = 2, noise: str = "auto"
) -> TransferFunctionFit:
    """
    Identify gain/(s + d_0) or gain/(s² + d_1 s + d_0) by output error.

    The command is held over each sample.

    Parameters
    ----------
    command, velocity : array_like, shape (N,), or lists of them
        Logged command and velocity [m/s] per run; every run has initial states of its own.
    sample_time : float
        T [s].
    order : {1, 2}
        Order of the denominator.
    noise : {"auto", "white", "correlated", "hac"}
        What the standard errors allow for; see `fit`.

    Returns
    -------
    TransferFunctionFit
        A `FitResult` with the TransferFunction as `.model`.

    Raises
    ------
    IdentificationError
        If the command does not move, or the data do not determine the parameters.
    ValueError
        If arguments are not understood, lengths differ or samples are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import signal
    >>> import trustlab as tl
    >>> command = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 20), 50)
    >>> t = 0.01 * np.arange(1000)
    >>> _, velocity, _ = signal.lsim(([0.985], [1.0, 0.4952]), command, t, interp=False)
    >>> fit = tl.fit_transfer_function(command, velocity, sample_time=0.01, order=1)
    >>> round(fit.model.gain, 3), round(fit.model.denominator[0], 3)
    (0.985, 0.495)
    """
    sample_time = positive("sample_time", sample_time)
    one_of("noise", noise, NOISES)
    order = whole_number("order", order, 1, 2)
    runs = _runs(command, velocity, sample_time)
    model = transfer_model(order, sample_time)
    unknowns = 1 + order + order * len(runs)
    samples = sum(run.size for run in runs)
    if samples < 2 * unknowns:
        raise IdentificationError(
            f"{samples} samples are too few for {unknowns} unknowns; record longer runs"
        )
    limits = model.limits()
    check_data(model, runs, limits)
    fit = result_of(estimate_runs(model, runs, limits, noise))
    return TransferFunctionFit(**vars(fit) | {"sigma": fit.sigma["velocity"]})


def transfer_model(order: int, sample_time: float) -> Model:
    """Return the model: shared gain and denominator, each run's own initial states."""
    denominator = ("d_0",) if order == 1 else ("d_1", "d_0")
    states = ("velocity_0", "acceleration_0")[:order]

    def simulate(run, gain, **values):
        d = np.array([values[name] for name in denominator])
        weights = np.array([gain, *(values[name] for name in states)])
        return _responses(d, run["command"], sample_time) @ weights

    def check(runs, limits):
        if max(np.ptp(run["command"]) for run in runs) == 0.0:
            raise IdentificationError(
                "the command never changes: it identifies nothing", ("gain", *denominator)
            )

    return Model(
        ("gain", *denominator),
        states,
        ("velocity",),
        simulate=simulate,
        starts=lambda runs, limits: [_guess(runs, denominator, states, sample_time)],
        inputs=("command",),
        build=lambda gain, **values: TransferFunction(
            gain, tuple(values[name] for name in denominator)
        ),
        check=check,
    )


def _responses(denominator: np.ndarray, u: np.ndarray, sample_time: float) -> np.ndarray:
    """Return velocity per unit gain and per unit of each initial state, shape (N, 1 + n)."""
    n = len(denominator)
    # The companion form, with the command as a further, constant state: its exponential holds Φ and
    # Γ of one sample.
    block = np.zeros((n + 1, n + 1))
    block[: n - 1, 1:n] = np.eye(n - 1)
    block[n - 1, :n] = -denominator[::-1]
    block[n - 1, n] = 1.0
    exponential = linalg.expm(block * sample_time)
    phi = exponential[:n, :n]
    gamma = exponential[:n, n]
    # As difference equations: v is the first state, so the first row of (zI − Φ)⁻¹ is written out
    # for n = 1 and 2, its numerators by falling powers of z.
    pulse = np.zeros(u.size)
    pulse[0] = 1.0
    if n == 1:
        poles = np.array([1.0, -phi[0, 0]])
        first_row = np.ones((1, 1))
    else:
        determinant = phi[0, 0] * phi[1, 1] - phi[0, 1] * phi[1, 0]
        poles = np.array([1.0, -(phi[0, 0] + phi[1, 1]), determinant])
        first_row = np.array([[1.0, 0.0], [-phi[1, 1], phi[0, 1]]])
    forced = (np.r_[0.0, (first_row * gamma).sum(axis=1)], u)
    filters = [forced, *((np.r_[state, 0.0], pulse) for state in first_row.T)]
    return np.column_stack([signal.lfilter(top, poles, x) for top, x in filters])


def _guess(
    runs: list[Run], denominator: tuple[str, ...], states: tuple[str, ...], sample_time: float
) -> Mapping:
    """Return starting values: a search over the denominator, the rest by least squares."""
    order = len(denominator)
    target = np.concatenate([run["velocity"] for run in runs])

    def project(d):
        parts = [_responses(d, run["command"], sample_time) for run in runs]
        # The gain is shared; each run's initial states act in that run alone.
        initial = linalg.block_diag(*(part[:, 1:] for part in parts))
        design = np.column_stack([np.concatenate([part[:, 0] for part in parts]), initial])
        if not np.isfinite(design).all():
            return np.zeros(design.shape[1]), np.full(target.size, 1e6)
        weights = np.linalg.lstsq(design, target, rcond=None)[0]
        return weights, design @ weights - target

    def residuals(d):
        with np.errstate(all="ignore"):
            return project(d)[1]

    starts = sorted(
        _denominators(order, runs, sample_time), key=lambda d: float(np.sum(residuals(d) ** 2))
    )
    tight = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14, "max_nfev": 200}
    minima = [
        optimize.least_squares(residuals, start, x_scale="jac", **tight) for start in starts[:2]
    ]
    best = min(minima, key=lambda minimum: minimum.cost).x
    weights = project(best)[0]
    initial = weights[1:].reshape(len(runs), order)
    guess = dict(zip((*denominator, *states), (*best, *initial.T), strict=True))
    return {"gain": weights[0], **guess}


def _denominators(order: int, runs: list[Run], sample_time: float) -> list[np.ndarray]:
    """Return starting denominators, from the sample time to the length of the runs."""
    longest = sample_time * max(run.size for run in runs)
    rates = 1.0 / np.geomspace(2.0 * sample_time, longest / 2.0, 12)
    if order == 1:
        return [np.array([rate]) for rate in rates]
    return [
        np.array([2.0 * damping * rate, rate**2]) for rate in rates for damping in (0.1, 0.5, 2.0)
    ]


def _runs(command, velocity, sample_time: float) -> list[Run]:
    """Check both signals and pair them by run."""
    commands, velocities = (
        list(value)
        if isinstance(value, list | tuple) and np.ndim(value[0] if value else 0)
        else [value]
        for value in (command, velocity)
    )
    if len(commands) != len(velocities):
        raise ValueError(
            f"there are {len(commands)} runs of command but {len(velocities)} of velocity"
        )
    runs = []
    for j, (u, v) in enumerate(zip(commands, velocities, strict=True)):
        u = finite_array(f"command of run {j}", u)
        v = finite_array(f"velocity of run {j}", v, length=u.size)
        runs.append(Run(f"run {j}", sample_time * np.arange(u.size), {"command": u, "velocity": v}))
    return runs
