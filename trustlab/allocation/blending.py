"""Optimal mixed initiative (OMI, Appendix A): a share α that weighs error against departure."""

import numpy as np
import scipy

from trustlab.models.checks import between, finite_array, finite_numbers, in_order, positive
from trustlab.models.compiled import njit
from trustlab.models.uav import TransferFunction, three_axes

# Degree of the interpolation of the cost in α; its error over 0.2 s is below rounding (a test
# checks it).
DEGREE = 10

# The vehicle as the state equations of Appendix A have it; (A.1) prints 1.475 and 0.4952 for the
# same numbers.
APPENDIX_A = (
    TransferFunction(9.22, (1.473, 0.2214)),
    TransferFunction(3.806, (0.4706, 2.457)),
    TransferFunction(0.985, (0.495,)),
)


@njit
def best_share(weights, states, low, high, series):
    """
    Return the α in [low, high] of least cost.

    weights, shape (DEGREE + 1, 3, 5, 5): the cost's matrices as power series in 2α − 1, per axis.
    states, shape (3, 5): command of the operator and of the controller, error, its first and second
    derivative, per axis. series, shape (DEGREE + 1,): room for the cost as a series, as the loops
    allocate nothing.
    """
    terms = series.size
    series[:] = 0.0
    for axis in range(3):
        for i in range(5):
            for j in range(5):
                pair = states[axis, i] * states[axis, j]
                if pair != 0.0:
                    for m in range(terms):
                        series[m] += pair * weights[m, axis, i, j]
    # The best of a grid that is finer than the polynomial can turn; then the root beside it.
    spacing = (high - low) / (4 * terms)
    best, least = low, np.inf
    for k in range(4 * terms + 1):
        cost, _ = _polynomial(series, 2.0 * (low + k * spacing) - 1.0)
        if cost < least:
            best, least = low + k * spacing, cost
    a, b = max(best - spacing, low), min(best + spacing, high)
    for _ in range(60):
        middle = 0.5 * (a + b)
        if _polynomial(series, 2.0 * middle - 1.0)[1] < 0.0:
            a = middle
        else:
            b = middle
    return a


@njit
def _polynomial(series, x):
    """Return Σ c_m x^m and its derivative, by Horner's rule."""
    value = slope = 0.0
    for m in range(series.size - 1, -1, -1):
        slope = slope * x + value
        value = value * x + series[m]
    return value, slope


class OptimalBlending:
    """
    The allocation of Appendix A: the share α that minimises (A.3) over a short horizon.

    The cost is ∫ 200‖e‖² + (1 − α)²‖u_a − u_h‖² dτ.

    Every axis has the states u_h (held), u_a (following its PD law), e and its derivatives; u = α
    u_h + (1 − α) u_a drives the vehicle. For α held over the horizon the cost is, up to rounding, a
    polynomial in α with coefficients quadratic in the state; its global minimum is found from all
    sign changes of its derivative.

    Parameters
    ----------
    vehicle : three TransferFunction
        Command to velocity on x, y and z; Appendix A's when not given.
    gains : three pairs of float
        Proportional and derivative gain of the autonomous controller per axis, as the prediction
        has them.
    alpha_min, alpha_max : float
        Bounds of α, 0 ≤ alpha_min < alpha_max ≤ 1.
    horizon : float
        Length of the prediction [s], in (0, 2].

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    Saeidi, Appendix A.

    Examples
    --------
    >>> import trustlab as tl
    >>> blending = tl.OptimalBlending(alpha_min=0.2)
    >>> still = [0.0, 0.0, 0.0]
    >>> commands = {"u_h": [0.1, 0, 0], "u_a": [0.3, 0, 0]}
    >>> alpha = blending.step(**commands, e=[1.0, 0, 0], rate=still, acceleration=still)
    >>> 0.2 <= alpha <= 1.0
    True
    """

    def __init__(
        self,
        vehicle: tuple[TransferFunction, ...] = APPENDIX_A,
        gains: tuple[tuple[float, float], ...] = ((0.5, 0.02), (0.5, 0.02), (1.5, 0.0)),
        alpha_min: float = 0.2,
        alpha_max: float = 1.0,
        horizon: float = 0.2,
    ):
        self.vehicle = three_axes(vehicle)
        self.gains = finite_numbers("gains", gains)
        if self.gains.shape != (3, 2):
            raise ValueError(f"gains must be three pairs (proportional, derivative), got {gains}")
        between("alpha_min", alpha_min, 0.0, 1.0)
        between("alpha_max", alpha_max, 0.0, 1.0)
        self.alpha_min, self.alpha_max = in_order("alpha_min", alpha_min, "alpha_max", alpha_max)
        self.horizon = between("horizon", positive("horizon", horizon), 0.0, 2.0)
        count = DEGREE + 1
        nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        costs = [[self._cost(axis, 0.5 * (x + 1.0)) for axis in range(3)] for x in nodes]
        series = np.linalg.solve(np.vander(nodes, increasing=True), np.reshape(costs, (count, -1)))
        self.weights = series.reshape(count, 3, 5, 5)

    def _cost(self, axis: int, alpha: float) -> np.ndarray:
        """
        Return the cost of an α that is held, a quadratic form of an axis' states: u_h, u_a, e,
        de/dt, d²e/dt².

        An axis of order one has no fifth state.
        """
        motion, drive = self.vehicle[axis].matrices()
        own = slice(3, 3 + len(drive))
        p, d = self.gains[axis]
        a = np.zeros((5, 5))
        a[2, 3] = 1.0
        a[own, own] = motion
        a[own, :2] = -np.outer(drive, (alpha, 1.0 - alpha))
        a[1] = p * a[2] + d * a[3]
        q = np.zeros((5, 5))
        q[2, 2] = 200.0
        q[:2, :2] = (1.0 - alpha) ** 2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
        block = np.block([[-a.T, q], [np.zeros((5, 5)), a]])
        whole = scipy.linalg.expm(block * self.horizon)  # Van Loan
        return whole[5:, 5:].T @ whole[:5, 5:]

    def step(self, u_h, u_a, e, rate, acceleration) -> float:
        """
        Return the optimal α for this sample.

        Parameters
        ----------
        u_h, u_a : array_like, shape (3,)
            Commands of the operator and of the autonomous controller.
        e, rate, acceleration : array_like, shape (3,)
            Tracking error [m], its first and second derivative; the last is not used on an axis of
            order one.

        Raises
        ------
        ValueError
            If an argument is not three finite numbers.
        """
        signals = {"u_h": u_h, "u_a": u_a, "e": e, "rate": rate, "acceleration": acceleration}
        columns = [finite_array(name, value, length=3) for name, value in signals.items()]
        bounds = self.alpha_min, self.alpha_max
        return best_share(self.weights, np.column_stack(columns), *bounds, np.empty(DEGREE + 1))
