"""One step of the correction (2.43)-(2.44) as CasADi expressions, with what a user adds, and the hard rule (2.8) over the horizon."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trustlab.allocation.incentive import incentive_box
from trustlab.models.tsc import TscModel

__all__ = ["Extras", "Rolled", "Shooting"]

TINY = 1e-100
"""Utilization below which (2.6) is at P_h,min; its second derivative is still finite there."""


@dataclass(frozen=True)
class Extras:
    """
    What a user adds to (2.43).

    Parameters
    ----------
    cost : callable, optional
        cost(x, u, k), a scalar that is added to (2.43) for k = 0 … N − 1; x = [r, P_r, TSC_u, TSC_l] at step k, u = [c_u, c_l].
    constraints : callable, optional
        constraints(x, u, k), one or several expressions, each held at or below 0 for k = 0 … N − 1.
    incentive : callable
        incentive(r, p_r, c_b, p_min, p_max), the least and the greatest correction, in [−c_b, 0] and [0, c_b]; (2.42) is
        `incentive_box`.
    """

    cost: Callable | None = None
    constraints: Callable | None = None
    incentive: Callable = incentive_box

    def __post_init__(self):
        for name, given in (
            ("extra_cost", self.cost),
            ("extra_constraints", self.constraints),
            ("incentive", self.incentive),
        ):
            if not callable(given) and (given is not None or name == "incentive"):
                raise ValueError(f"{name} must be a function, got {type(given).__name__}")

    @property
    def any(self) -> bool:
        """Whether cost or constraints were added."""
        return self.cost is not None or self.constraints is not None


class Shooting:
    """
    Expressions of one step, and the hard rule (2.8) run over the horizon.

    Inputs are c = c̲ + w (c̄ − c̲) with w in [0, 1], so that (2.41) is a constant box; with (2.42), where c̄ − c̲ = c_b, this is
    w = c/c_b + s. Thresholds are z = (threshold − target)/c_b, robot performance is (P_r − P_min)/(P_max − P_min), cost is in c_b².

    Parameters
    ----------
    tsc : TscModel
        The model.
    target : tuple of float
        TSC_ld and TSC_ud.
    c_b : float
        Largest correction per step.
    horizon : int
        N, steps.
    extras : Extras
        What a user adds.

    Raises
    ------
    ValueError
        If an added function fails, returns the wrong number of values, values that are not finite, or bounds that exclude 0.
    """

    def __init__(self, tsc: TscModel, target: tuple[float, float], c_b: float, horizon: int, extras: Extras):
        import casadi as ca

        self.tsc, self.target, self.c_b, self.horizon, self.extras = tsc, target, c_b, horizon, extras
        robot = tsc.robot
        self.units = np.array([1.0, robot.p_max - robot.p_min, c_b, c_b])
        self.zero = np.array([0.0, robot.p_min, target[1], target[0]])
        self.symbol = ca.SX
        try:
            self.added = self._added()
        except _UntraceableError:  # functions of matrices (interpolants, callbacks) know MX alone
            self.symbol = ca.MX
            self.added = self._added()
        self.constraints = self.added.size1_out(1)
        self._check()
        rule = self._rule()
        x, k = self.symbol.sym("x", 4), self.symbol.sym("k")
        box = ca.Function("box", [x, k], self.added(x, ca.DM.zeros(2), k)[2:])
        self._bounds = box.map(horizon)
        self._slopes_over_horizon = self._slopes.map(horizon) if extras.cost is not None else None
        self._over_horizon = rule if horizon == 1 else rule.mapaccum("rule_over_horizon", horizon)
        self._steps = np.arange(horizon, dtype=float)[None, :]

    def _added(self):
        """Return (x, u, k) → (cost over c_b², scaled constraints, c̲, c̄), x and u in the user's units."""
        import casadi as ca

        symbol, extras, robot = self.symbol, self.extras, self.tsc.robot
        x, u, k = symbol.sym("x", 4), symbol.sym("u", 2), symbol.sym("k")
        cost, rows = symbol(0), symbol(0, 1)
        if extras.cost is not None:
            cost = _scalar(symbol, "extra_cost", self._call("extra_cost", extras.cost, x, u, k))
        if extras.constraints is not None:
            given = self._call("extra_constraints", extras.constraints, x, u, k)
            parts = given if isinstance(given, list | tuple) else [given]
            rows = ca.vertcat(*(_column(symbol, "extra_constraints", part) for part in parts))
            if rows.numel() == 0:
                raise ValueError(
                    "extra_constraints returned nothing; leave it out, or return expressions to hold at or below 0"
                )
        bounds = self._call("incentive", extras.incentive, x[0], x[1], self.c_b, robot.p_min, robot.p_max)
        if not isinstance(bounds, list | tuple) or len(bounds) != 2:
            raise ValueError("incentive must return two values, the least and the greatest correction")
        low, high = (_scalar(symbol, "incentive", bound) for bound in bounds)
        try:
            slopes = ca.Function("slopes", [x, u, k], [ca.jacobian(rows, x), ca.jacobian(rows, u)])
            rows = rows / self._row_sizes(slopes) if rows.numel() else rows
            self._slopes = ca.Function(
                "cost_slopes", [x, u, k], [ca.gradient(cost, x) / self.c_b, ca.gradient(cost, u) / self.c_b]
            )
            return ca.Function("added", [x, u, k], [cost / self.c_b**2, rows, low, high])
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1][-200:]
            raise ValueError(
                f"extra_cost, extra_constraints and incentive may depend on their arguments alone: {reason}"
            ) from error

    def _call(self, name: str, function: Callable, *arguments):
        import casadi as ca

        try:
            return function(*arguments)
        except Exception as error:
            if self.symbol is ca.SX:
                raise _UntraceableError from error
            reason = f"{type(error).__name__}: {str(error).strip()[-200:]}"
            raise ValueError(
                f"{name} could not be called with CasADi symbols ({reason}); use arithmetic and casadi functions, "
                "and casadi.if_else in place of if"
            ) from error

    def _row_sizes(self, slopes) -> np.ndarray:
        """Return by how much each constraint changes over the scaled unknowns, at most, so that tolerances mean the same for all."""
        size = 0.0
        for x in self._places():
            by_x, by_u = (np.abs(np.asarray(value)) for value in slopes(x, [0.0, 0.0], 0))
            size = np.maximum(size, np.maximum((by_x * self.units).max(axis=1), by_u.max(axis=1) * self.c_b))
        return np.where(np.isfinite(size) & (size > 0.0), size, 1.0)

    def _places(self):
        for r in (0.1, 0.5, 0.9):
            for share in (0.1, 0.5, 0.9):
                yield self.zero + self.units * np.array([r, share, 0.0, 0.0])

    def _check(self) -> None:
        names = ("extra_cost", "extra_constraints", "incentive", "incentive")
        for x in self._places():
            values = [np.asarray(value) for value in self.added(x, [0.0, 0.0], 0)]
            where = f"at r = {x[0]:g}, P_r = {x[1]:.4g}, the target thresholds and no correction"
            for name, value in zip(names, values, strict=True):
                if not np.isfinite(value).all():
                    raise ValueError(f"{name} gives {value.ravel()} {where}; it must be finite")
            low, high = float(values[2][0, 0]), float(values[3][0, 0])
            if not -self.c_b * (1.0 + 1e-9) <= low <= 0.0 <= high <= self.c_b * (1.0 + 1e-9):
                raise ValueError(
                    f"incentive gives [{low:g}, {high:g}] {where}; as in (2.41), it must bound corrections by "
                    f"c_b = {self.c_b:g} and let thresholds be held"
                )

    def physical(self, z):
        """
        Return [r, P_r, TSC_u, TSC_l] from the scaled state.

        Parameters
        ----------
        z : casadi.SX, casadi.MX or numpy.ndarray, shape (4,)
            r, scaled P_r, scaled TSC_u and TSC_l.
        """
        return self.zero + self.units * z

    def performance(self, r):
        """
        Return human performance (2.6).

        Parameters
        ----------
        r : casadi.SX or casadi.MX
            Utilization.
        """
        import casadi as ca

        human = self.tsc.human
        rest, load = ca.fmax(r, TINY), ca.fmax(1.0 - r, TINY)
        bell = human.beta * ca.log(rest / human.beta) + (1.0 - human.beta) * ca.log(load / (1.0 - human.beta))
        bell = ca.if_else(ca.fmin(rest, load) > TINY, ca.exp(bell), 0.0)
        return (human.p_max - human.p_min) * bell + human.p_min

    def _rule(self):
        """Return (state and mode before; w and where thresholds may go; k) → (state and mode after; what was seen)."""
        import casadi as ca

        symbol, robot, human = self.symbol, self.tsc.robot, self.tsc.human
        state, given, k = symbol.sym("state", 5), symbol.sym("given", 6), symbol.sym("k")
        x, before = state[:4], state[4]
        p_h = self.performance(x[0])
        tsc = self.tsc.a_T * x[1] - self.tsc.b_T * p_h
        mode = ca.if_else(tsc >= x[2], 0.0, ca.if_else(tsc <= x[3], 1.0, before))
        _, _, low, high = self.added(x, ca.DM.zeros(2), k)
        # A threshold that is already where it may not go is held there, so that corrections never leave (2.41).
        least, most = ca.fmin(given[2:4], x[2:]), ca.fmax(given[4:6], x[2:])
        moved = ca.fmin(ca.fmax(x[2:] + low + given[:2] * (high - low), least), most)
        u = moved - x[2:]
        cost, rows, _, _ = self.added(x, u, k)
        worst = ca.mmax(rows) if self.constraints else symbol(-1.0)
        after = ca.vertcat(
            human.a * x[0] + human.b * mode,
            robot.a * x[1] + (1.0 - robot.a) * robot.p_min + mode * robot.b * p_h,
            moved,
            mode,
        )
        return ca.Function("rule", [state, given, k], [after, ca.vertcat(u, tsc, cost, worst, low, high)])

    def steepness(self, run: Rolled) -> float:
        """
        Return by how much the cost over c_b² changes with one correction at most, at least 1: the objective's scale.

        Parameters
        ----------
        run : Rolled
            Where the cost is looked at.
        """
        by_threshold = 2.0 * (run.states[2:, 1:] - self.zero[2:, None]) / self.c_b
        by_input = 0.0
        if self._slopes_over_horizon is not None:
            by_x, by_u = self._slopes_over_horizon(run.states[:, :-1], run.inputs, self._steps)
            by_threshold[:, :-1] += np.asarray(by_x)[2:, 1:]
            by_input = np.asarray(by_u)
        by_input = by_input + np.cumsum(by_threshold[:, ::-1], axis=1)[:, ::-1]
        return max(1.0, float(np.nan_to_num(np.abs(by_input)).max()))

    def bounds(
        self, r: np.ndarray, p_r: np.ndarray, upper: np.ndarray, lower: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the least and the greatest correction over the horizon.

        Parameters
        ----------
        r, p_r, upper, lower : numpy.ndarray, shape (N,)
            States of (2.44) at steps 0 … N − 1.
        """
        low, high = self._bounds(np.stack([r, p_r, upper, lower]), self._steps)
        return np.asarray(low).ravel(), np.asarray(high).ravel()

    def hull(self, upper: float, lower: float) -> np.ndarray:
        """
        Return where TSC_u and TSC_l may go, between their values now and their targets: least, then greatest, at each step.

        Parameters
        ----------
        upper, lower : float
            TSC_u and TSC_l now.
        """
        ends = np.array([[upper, lower], [self.target[1], self.target[0]]])
        return np.repeat(np.stack([ends.min(axis=0), ends.max(axis=0)])[:, :, None], self.horizon, axis=2)

    def roll(self, state: np.ndarray, w: np.ndarray, hull: np.ndarray) -> Rolled:
        """
        Run the model under the hard rule (2.8), with the corrections that `w` means along the way.

        Parameters
        ----------
        state : numpy.ndarray, shape (5,)
            r, P_r, TSC_u, TSC_l and the mode before.
        w : numpy.ndarray, shape (2, N)
            c_u and c_l as shares of what (2.41) allows.
        hull : numpy.ndarray, shape (2, 2, N)
            Where the thresholds may go, see `hull`.
        """
        given = np.concatenate([w, hull[0], hull[1]])
        states, seen = (np.asarray(value) for value in self._over_horizon(state, given, self._steps))
        error = (states[2:4] - self.zero[2:, None]) / self.c_b
        base = float(np.sum(error * error))
        low, high = seen[5], seen[6]
        width = high - low
        used = np.where(width > 0.0, (seen[:2] - low) / np.where(width > 0.0, width, 1.0), 0.0)
        return Rolled(
            states=np.hstack([state[:4, None], states[:4]]),
            mode=states[4],
            tsc=seen[2],
            inputs=seen[:2],
            w=np.clip(used, 0.0, 1.0),
            low=low,
            high=high,
            cost=base + float(seen[3].sum()),
            size=base + float(np.abs(seen[3]).sum()),
            worst=float(seen[4].max()),
        )


@dataclass(frozen=True, eq=False)
class Rolled:
    """
    One run under the hard rule.

    Parameters
    ----------
    states : numpy.ndarray, shape (4, N + 1)
        r, P_r, TSC_u, TSC_l.
    mode, tsc : numpy.ndarray, shape (N,)
        Mode and TSC at each step.
    inputs, w : numpy.ndarray, shape (2, N)
        c_u and c_l, and the same as shares of what (2.41) allows.
    low, high : numpy.ndarray, shape (N,)
        Least and greatest correction (2.42).
    cost, size : float
        (2.43) and what the user added, over c_b²; and the same with every term counted as positive.
    worst : float
        Greatest of the user's constraints, scaled; −1 where there are none.
    """

    states: np.ndarray
    mode: np.ndarray
    tsc: np.ndarray
    inputs: np.ndarray
    w: np.ndarray
    low: np.ndarray
    high: np.ndarray
    cost: float
    size: float
    worst: float

    @property
    def sound(self) -> bool:
        """Whether all is finite, thresholds never cross, and corrections may be 0 throughout."""
        finite = np.isfinite(self.states).all() and np.isfinite(self.cost)
        apart = (self.states[3, 1:] < self.states[2, 1:]).all()
        return bool(finite and apart and (self.low <= 0.0).all() and (self.high >= 0.0).all())


class _UntraceableError(Exception):
    """A user's function that does not take scalar symbols."""


def _scalar(symbol, name: str, value):
    """Return a user's value as one CasADi scalar."""
    out = _column(symbol, name, value)
    if out.numel() != 1:
        raise ValueError(f"{name} must return a scalar, got shape {out.shape}")
    return out


def _column(symbol, name: str, value):
    """Return a user's value as a CasADi column."""
    import casadi as ca

    if value is None or isinstance(value, bool | str | bytes):
        raise ValueError(f"{name} must return a CasADi expression or a number, got {value!r}")
    try:
        return ca.vec(symbol(value))
    except (NotImplementedError, TypeError, RuntimeError):  # what CasADi raises for a value it cannot convert
        raise ValueError(
            f"{name} must return a CasADi expression or a number, got {type(value).__name__}"
        ) from None
