"""Continuous-time transfer functions of order 1 and 2 from logs, as (A.1) was identified."""

import re
from dataclasses import replace

import numpy as np

from trustlab.identification.fit import fit_runs
from trustlab.identification.log import Run, joined
from trustlab.identification.model import IdentificationError, Model
from trustlab.identification.regression import paired_runs
from trustlab.identification.result import FitResult
from trustlab.models.checks import positive, whole_number
from trustlab.models.compiled import njit
from trustlab.models.uav import TransferFunction

# Remedies of `fit` whose arguments this function does not have.
FOREIGN = r", or fix (it|a parameter, for example fixed=\{.*?\})|, robust=False keeps them"

# Denominators of the grid from which a search starts.
STARTS = 3


def fit_transfer_function(
    command, velocity, sample_time: float, order: int = 2, noise: str = "auto"
) -> FitResult:
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
    FitResult
        With a TransferFunction.

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
    order = whole_number("order", order, 1, 2)
    runs = [
        Run(f"run {j}", sample_time * np.arange(u.size), {"command": u, "velocity": v})
        for j, (u, v) in enumerate(paired_runs(command=command, velocity=velocity))
    ]
    model = transfer_model(order, sample_time)
    unknowns = 1 + order + order * len(runs)
    samples = sum(run.size for run in runs)
    if samples < 2 * unknowns:
        raise IdentificationError(
            f"{samples} samples are too few for {unknowns} unknowns; record longer runs"
        )
    try:
        result = fit_runs(model, runs, noise, model.limits())
    except IdentificationError as error:
        raise IdentificationError(re.sub(FOREIGN, "", str(error)), error.parameters) from error
    return replace(result, message=re.sub(FOREIGN, "", result.message))


def transfer_model(order: int, sample_time: float) -> Model:
    """Return the model: shared gain and denominator, each run's own initial states."""
    denominator = ("d_0",) if order == 1 else ("d_1", "d_0")
    states = ("velocity_0", "acceleration_0")[:order]

    def response(run, d, gain, begin):
        phi, gamma = TransferFunction(1.0, d).discrete(sample_time)
        return respond(run["command"], phi, gain * gamma, np.array(begin))

    def simulate(run, gain, **values):
        d, begin = ([values[name] for name in names] for names in (denominator, states))
        return response(run, d, gain, begin)

    def starts(runs, limits):
        velocity = joined(runs, "velocity")
        first = dict(zip(states, ([run["velocity"][0] for run in runs], 0.0), strict=False))
        ways = []
        for d in _grid(order, runs, sample_time):
            # With the gain that suits the command's response best.
            of_one = np.concatenate([response(run, d, 1.0, np.zeros(order)) for run in runs])
            gain = np.linalg.lstsq(of_one[:, None], velocity)[0].item()
            values = {"gain": gain, **dict(zip(denominator, d, strict=True)), **first}
            ways.append((np.sum((velocity - gain * of_one) ** 2), values))
        return [values for _, values in sorted(ways, key=lambda way: way[0])[:STARTS]]

    def check(runs, limits):
        if max(np.ptp(run["command"]) for run in runs) == 0.0:
            raise IdentificationError(
                "the command never changes: it identifies nothing", ("gain", *denominator)
            )

    return Model(
        ("gain", *denominator),
        states,
        ("velocity",),
        # A gain whose interval holds 0 says that the command may do nothing.
        size=lambda values: {"gain": abs(values["gain"])},
        simulate=simulate,
        starts=starts,
        inputs=("command",),
        build=lambda gain, **values: TransferFunction(
            gain, tuple(values[name] for name in denominator)
        ),
        check=check,
    )


@njit
def respond(command, phi, gamma, state):
    """Return velocity, the first of the states, under a command that is held over each sample."""
    velocity = np.empty(command.size)
    for k in range(command.size):
        velocity[k] = state[0]
        before = state.copy()
        for i in range(state.size):
            state[i] = gamma[i] * command[k]
            for j in range(state.size):
                state[i] += phi[i, j] * before[j]
    return velocity


def _grid(order: int, runs: list[Run], sample_time: float) -> list[np.ndarray]:
    """Return denominators of time constants from the sample time to the length of the runs."""
    longest = sample_time * max(run.size for run in runs)
    rates = 1.0 / np.geomspace(2.0 * sample_time, longest / 2.0, 12)
    if order == 1:
        return [np.array([rate]) for rate in rates]
    return [
        np.array([2.0 * damping * rate, rate**2]) for rate in rates for damping in (0.1, 0.5, 2.0)
    ]
