"""What a user adds to the correction in CasADi: costs, constraints and incentives."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trustlab.allocation.correction.incentive import incentive_box
from trustlab.models.tsc import TscModel


class _UntraceableError(Exception):
    """A user's function does not accept scalar symbols."""


@dataclass(frozen=True)
class Extras:
    """
    What a user adds to (2.43), and the incentives.

    Parameters
    ----------
    cost : callable, optional
        cost(x, u, k), a scalar that is added to (2.43) for k = 0 … N − 1; x = [r, P_r, TSC_u,
        TSC_l] at step k, u = [c_u, c_l].
    constraints : callable, optional
        constraints(x, u, k), one or several expressions, each held at or below 0 for k = 0 … N − 1.
    incentive : callable
        incentive(r, p_r, c_b, p_min, p_max), the least and the greatest correction, in [−c_b, 0]
        and [0, c_b]; (2.42) is `incentive_box`.
    """

    cost: Callable | None = None
    constraints: Callable | None = None
    incentive: Callable = incentive_box

    def __post_init__(self):
        functions = {
            "extra_cost": self.cost,
            "extra_constraints": self.constraints,
            "incentive": self.incentive,
        }
        for name, function in functions.items():
            if not callable(function) and (function is not None or name == "incentive"):
                raise ValueError(f"{name} must be a function, got {type(function).__name__}")

    @property
    def any(self) -> bool:
        """Whether cost or constraints were added."""
        return self.cost is not None or self.constraints is not None


class Additions:
    """
    The user's additions as CasADi functions of state x, corrections u and step k.

    `at(x, u, k)` is the added cost over c_b², the scaled constraints, and the least and greatest
    correction. `cost_slopes(x, u, k)` is the change of the cost over c_b² with x and u, times c_b.

    Parameters
    ----------
    extras : Extras
        The user's functions.
    tsc : TscModel
        The model.
    c_b : float
        Largest correction per step.
    zero, units : numpy.ndarray, shape (4,)
        Origin and unit of each state, where the program scales them.

    Raises
    ------
    ValueError
        If a function fails, or returns a wrong number of values, values that are not finite, or
        bounds that exclude 0.
    """

    def __init__(
        self, extras: Extras, tsc: TscModel, c_b: float, zero: np.ndarray, units: np.ndarray
    ):
        import casadi as ca

        self.extras = extras
        self.c_b = c_b
        self._robot = tsc.robot
        self._units = units
        shares = (0.1, 0.5, 0.9)
        self._states = [zero + units * np.array([r, p, 0.0, 0.0]) for r in shares for p in shares]
        self.symbol = ca.SX
        try:
            self._trace()
        except _UntraceableError:  # interpolants, callbacks and the like take MX only
            self.symbol = ca.MX
            self._trace()
        self.constraints = self.at.size1_out(1)
        self._check()

    def _trace(self) -> None:
        """Call the user's functions with symbols, and keep what they return as functions."""
        import casadi as ca

        x = self.symbol.sym("x", 4)
        u = self.symbol.sym("u", 2)
        k = self.symbol.sym("k")
        cost = self.symbol(0)
        if self.extras.cost is not None:
            cost = self._scalar("extra_cost", self._call("extra_cost", self.extras.cost, x, u, k))
        rows = self._constraints(x, u, k)
        low, high = self._incentives(x)
        try:
            slopes = ca.Function("slopes", [x, u, k], [ca.jacobian(rows, x), ca.jacobian(rows, u)])
            rows = rows / self._row_sizes(slopes) if rows.numel() else rows
            gradients = [ca.gradient(cost, x) / self.c_b, ca.gradient(cost, u) / self.c_b]
            self.cost_slopes = ca.Function("cost_slopes", [x, u, k], gradients)
            self.at = ca.Function("added", [x, u, k], [cost / self.c_b**2, rows, low, high])
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1][-200:]
            raise ValueError(
                "extra_cost, extra_constraints and incentive may depend on their arguments "
                f"alone: {reason}"
            ) from error

    def _constraints(self, x, u, k):
        """Return the user's constraints as one column."""
        import casadi as ca

        if self.extras.constraints is None:
            return self.symbol(0, 1)
        name = "extra_constraints"
        parts = self._call(name, self.extras.constraints, x, u, k)
        parts = parts if isinstance(parts, list | tuple) else [parts]
        rows = ca.vertcat(*(self._column(name, part) for part in parts))
        if rows.numel() == 0:
            raise ValueError(
                "extra_constraints returned nothing; leave it out, or return expressions to be "
                "kept at or below 0"
            )
        return rows

    def _incentives(self, x) -> list:
        """Return the bounds of the corrections."""
        limits = self._robot.p_min, self._robot.p_max
        bounds = self._call("incentive", self.extras.incentive, x[0], x[1], self.c_b, *limits)
        if not isinstance(bounds, list | tuple) or len(bounds) != 2:
            raise ValueError(
                "incentive must return two values, the least and the greatest correction"
            )
        return [self._scalar("incentive", bound) for bound in bounds]

    def _call(self, name: str, function: Callable, *arguments):
        import casadi as ca

        try:
            return function(*arguments)
        except Exception as error:
            if self.symbol is ca.SX:
                raise _UntraceableError from error
            reason = f"{type(error).__name__}: {str(error).strip()[-200:]}"
            raise ValueError(
                f"{name} could not be called with CasADi symbols ({reason}); use arithmetic and "
                "casadi functions, and casadi.if_else in place of if"
            ) from error

    def _row_sizes(self, slopes) -> np.ndarray:
        """Return each constraint's greatest change per scaled unknown, for one tolerance."""
        size = 0.0
        for x in self._states:
            by_x, by_u = (np.abs(np.asarray(value)) for value in slopes(x, [0.0, 0.0], 0))
            size = np.maximum(
                size, np.maximum((by_x * self._units).max(axis=1), by_u.max(axis=1) * self.c_b)
            )
        return np.where(np.isfinite(size) & (size > 0.0), size, 1.0)

    def _check(self) -> None:
        """Check the values at states all over the range."""
        names = ("extra_cost", "extra_constraints", "incentive", "incentive")
        for x in self._states:
            values = [np.asarray(value) for value in self.at(x, [0.0, 0.0], 0)]
            where = f"at r = {x[0]:g}, P_r = {x[1]:.4g}, the target thresholds and no correction"
            for name, value in zip(names, values, strict=True):
                if not np.isfinite(value).all():
                    raise ValueError(f"{name} gives {value.ravel()} {where}; it must be finite")
            low = float(values[2][0, 0])
            high = float(values[3][0, 0])
            if not -self.c_b * (1.0 + 1e-9) <= low <= 0.0 <= high <= self.c_b * (1.0 + 1e-9):
                raise ValueError(
                    f"incentive gives [{low:g}, {high:g}] {where}; as in (2.41), it must bound "
                    f"corrections by c_b = {self.c_b:g} and let thresholds be held"
                )

    def _scalar(self, name: str, value):
        """Return a user's value as one CasADi scalar."""
        out = self._column(name, value)
        if out.numel() != 1:
            raise ValueError(f"{name} must return a scalar, got shape {out.shape}")
        return out

    def _column(self, name: str, value):
        """Return a user's value as a CasADi column."""
        import casadi as ca

        try:
            if isinstance(value, bool):
                raise TypeError
            return ca.vec(self.symbol(value))
        # These are raised by CasADi for a value that it cannot convert.
        except (NotImplementedError, TypeError, RuntimeError):
            raise ValueError(
                f"{name} must return a CasADi expression or a number, got {type(value).__name__}"
            ) from None
