"""The robot's model, (2.3): parameters, sensitivities, linear form, initial guess."""

from collections.abc import Mapping

import numpy as np

from trustlab.identification.human import (
    decay_rates,
    range_parameters,
    rate_parameter,
    solve_pair,
    undo_blocks,
)
from trustlab.identification.regression import equations
from trustlab.identification.runs import Run, as_columns, block_means, joined
from trustlab.identification.structure import (
    MODEL_STEP,
    POSTERIOR,
    IdentificationError,
    LinearForm,
    Parameter,
    Structure,
)
from trustlab.models.checks import positive
from trustlab.models.compiled import njit
from trustlab.models.tsc import RobotModel

SLOPES = np.dtype([(name, float) for name in ("a", "p_min", "p_max", "p_r0")])


@njit
def _simulate_with_slopes(mode, p_h, a, p_min, p_max, p_h_max, p_r0, p_r, by):
    """Run (2.3) under a known P_h and its derivatives, into `p_r` and the records `by`."""
    performance = p_r0
    by_a = 0.0
    by_min = 0.0
    by_max = 0.0
    by_0 = 1.0
    gain = (p_max - p_min) / p_h_max
    loss = 1.0 - a
    for k in range(mode.size):
        p_r[k] = performance
        row = by[k]
        row.a = by_a
        row.p_min = by_min
        row.p_max = by_max
        row.p_r0 = by_0
        drive = mode[k] * p_h[k]
        share = drive / p_h_max
        # (2.3) as P_r(k+1) = a P_r(k) + (1 − a)(p_min + gain M(k) P_h(k)), differentiated by
        by_a = a * by_a + performance - p_min - gain * drive  # a
        by_min = a * by_min + loss * (1.0 - share)  # p_min
        by_max = a * by_max + loss * share  # p_max
        by_0 = a * by_0  # P_r(0)
        performance = a * performance + loss * (p_min + gain * drive)  # (2.3)


def simulate_robot(run: Run, p_h: np.ndarray, p_h_max: float, a, p_min, p_max, p_r0):
    """Return P_r under a known P_h and its derivatives by a, p_min, p_max and p_r0 as records."""
    p_r, by = run.scratch("P_r"), run.scratch("of P_r", SLOPES)
    _simulate_with_slopes(run["mode"], p_h, a, p_min, p_max, p_h_max, p_r0, p_r, by)
    return p_r, by


def robot_parameters(prefix: str = "") -> tuple[Parameter, ...]:
    """Return a, p_min and p_max of (2.3)."""
    return (rate_parameter(prefix), *range_parameters(prefix))


def robot_structure(p_h_max: float) -> Structure:
    """
    Return the robot's structure, (2.3), driven by the measured P_h.

    For `fit` where the operator does not follow (2.5)-(2.6); `fit_robot` fits the operator, too.

    Parameters
    ----------
    p_h_max : float
        Greatest human performance, to which p_max refers.

    Returns
    -------
    Structure
        With parameters a, p_min and p_max, and P_r at the start of every session.

    Raises
    ------
    ValueError
        If p_h_max is not positive.

    Notes
    -----
    Noise in P_h drives the simulation: white noise in P_h adds noise to the residuals of P_r that
    is correlated over 1/(1 − a) samples. In 12 simulated sessions of the pilot operator with
    noise of 0.1 in P_h and 0.003 in P_r, standard errors were four to seven times those of
    `fit_robot`; a came out too high, by one of its standard errors, and p_max − p_min without bias.

    Examples
    --------
    >>> import trustlab as tl
    >>> pilot = tl.read_session("data/sessions/pilot.csv")
    >>> fit = tl.fit(tl.identification.robot_structure(0.46), pilot)
    >>> round(fit.model.a, 3)
    0.996
    """
    p_h_max = positive("p_h_max", p_h_max)

    def sensitivities(run, a, p_min, p_max, p_r0):
        p_r, by = simulate_robot(run, run["p_h"], p_h_max, a, p_min, p_max, p_r0)
        return [p_r], [as_columns(by)]

    def from_coefficients(a1, b, c):
        a = -a1
        p_min = c / (1.0 - a)
        return a, p_min, p_min + b / (1.0 - a) * p_h_max

    linear = LinearForm(
        coefficients=("a1", "b1", "c"),
        equations=lambda run: equations(
            run["p_r"], (run["mode"] * run["p_h"])[:, None], 1, (1,), (1,), True
        ),
        parameters=from_coefficients,
        initial=lambda run: (float(run["p_r"][0]),),
        caution=(
            "Least squares on one-step predictions: measurement noise on p_r biases a towards 0, "
            "and these standard errors do not show it; compare output_error."
        ),
    )
    return Structure(
        f"robot model (2.3) for p_h_max = {p_h_max:g}",
        parameters=robot_parameters(),
        initial=(Parameter("p_r0"),),
        inputs=("mode", "p_h"),
        outputs=("p_r",),
        sensitivities=sensitivities,
        guess=lambda runs, limits: robot_guess(runs, limits, p_h_max),
        model=lambda **values: build_robot(**values, p_h_max=p_h_max),
        check=check_excitation,
        step=MODEL_STEP,
        linear=linear,
        remedy=POSTERIOR,
    )


def build_robot(a: float, p_min: float, p_max: float, p_h_max: float) -> RobotModel:
    """Return the model, or say what about the data contradicts (2.3)."""
    if not p_max > p_min:
        raise IdentificationError(
            "robot performance does not rise under manual control in these data (the fit has "
            f"p_max = {p_max:.4g}, not above p_min = {p_min:.4g}), so (2.3) does not describe them",
            ("p_min", "p_max"),
        )
    return RobotModel(float(a), float(p_min), float(p_max), float(p_h_max))


def check_excitation(
    runs: list[Run], limits: Mapping, low: str = "p_min", high: str = "p_max"
) -> None:
    """Refuse data in which nothing separates the least from the greatest robot performance."""
    modes = joined(runs, "mode")
    fixed = {name for name in (low, high) if limits[name][0] == limits[name][1]}
    # A mode that never changes leaves one steady state: under manual control either limit fixes the
    # other, but an autonomous robot says nothing of p_max.
    if np.ptp(modes) > 0.0 or (fixed and (modes[0] > 0.0 or high in fixed)):
        return
    lost = (high,) if modes[0] == 0.0 else (low, high)
    raise IdentificationError(
        f"these data do not determine {' and '.join(lost)}: mode never changes (it is "
        f"{modes[0]:g} throughout); log at least one switch between manual and autonomous "
        f"control, or fix a parameter, for example fixed={{{lost[0]!r}: ...}}",
        lost,
    )


# --- the initial guess ----------------------------------------------------------------------------


@njit
def _best_rate(mode, p_h, p_r, starts, rates, p_h_max):
    """Return the best of some rates, with p_min and p_max; NaN where no rate determines them."""
    least = np.inf
    best_a = np.nan
    best_min = np.nan
    best_max = np.nan
    for a in rates:
        # By (2.3) P_r = p_min low + p_max high + the rest of the first sample: linear in p_min and
        # p_max, which are solved for.
        s11 = s12 = s22 = t1 = t2 = total = 0.0
        for i in range(starts.size - 1):
            low = 0.0
            high = 0.0
            left = p_r[starts[i]]
            for k in range(starts[i], starts[i + 1]):
                y = p_r[k] - left
                s11 += low * low
                s12 += low * high
                s22 += high * high
                t1 += low * y
                t2 += high * y
                total += y * y
                share = mode[k] * p_h[k] / p_h_max
                low += (1.0 - a) * (1.0 - share - low)
                high += (1.0 - a) * (share - high)
                left *= a
        p_min, p_max = solve_pair(s11, s12, s22, t1, t2)
        squares = total - p_min * t1 - p_max * t2
        if np.isfinite(p_min) and squares < least:
            least = squares
            best_a = a
            best_min = p_min
            best_max = p_max
    return best_a, best_min, best_max


def robot_guess(runs: list[Run], limits: Mapping, p_h_max: float) -> dict[str, float | np.ndarray]:
    """Return starting values from a coarse search on block means; p_r0 for every run."""
    means, length = block_means(runs)
    starts = np.cumsum([0, *(run.size for run in means)])
    rates = decay_rates(max(run.size for run in runs), length, limits["a"])
    mode, p_h, p_r = (joined(means, name) for name in ("mode", "p_h", "p_r"))
    a, p_min, p_max = _best_rate(mode, p_h, p_r, starts, rates, p_h_max)
    if not np.isfinite(a):
        a = rates[rates.size // 2]
        p_min = p_r.min()
        p_max = p_r.max()
    first = np.array([run["p_r"][0] for run in means])
    return {"a": undo_blocks(a, length), "p_min": p_min, "p_max": p_max, "p_r0": first}
