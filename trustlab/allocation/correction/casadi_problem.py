"""The correction (2.43)-(2.44) in CasADi: one step, runs under the rule (2.8), and the program."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.allocation.correction.incentive import incentive_box
from trustlab.models.human import next_utilization
from trustlab.models.robot import next_performance
from trustlab.models.tsc import TscModel, tsc_at

# Utilization below which (2.6) is taken as P_h,min; its second derivative is still finite there.
TINY = 1e-100

TOLERANCE = 1e-8
QUIET: dict[str, Any] = {"print_time": False, "error_on_fail": False}
QUIET_SQP = {"print_header": False, "print_iteration": False, "print_status": False}

# Solvers by name: interior-point methods for the program as it is, and sequential quadratic
# programming with an interior-point method for each quadratic program.
INTERIOR: dict[str, dict] = {
    "fatrop": {"print_level": 0, "tol": TOLERANCE},
    "ipopt": {"print_level": 0, "sb": "yes", "tol": TOLERANCE, "max_wall_time": 2.0},
}
SEQUENTIAL: dict[str, dict] = {
    "piqp": {"piqp": {"max_iter": 60}},
    "hpipm": {"hpipm.mode": "robust", "hpipm.iter_max": 60},
}
SOLVERS = (*SEQUENTIAL, *INTERIOR)

# How far, in units of c_b, thresholds may leave their intervals in the program; the hard run clips
# them.
SLACK = 1e-6


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


class CorrectionModel:
    """
    Expressions of one step, and runs under the hard rule (2.8) over the horizon.

    Inputs are c = c̲ + w (c̄ − c̲) with w in [0, 1], so that (2.41) is a constant box; with (2.42),
    where c̄ − c̲ = c_b, this is w = c/c_b + s. Thresholds are z = (threshold − target)/c_b, robot
    performance is (P_r − P_min)/(P_max − P_min), cost is in c_b².

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
        The user's additions.

    Raises
    ------
    ValueError
        If an added function fails, or returns a wrong number of values, values that are not finite,
        or bounds that exclude 0.
    """

    def __init__(
        self, tsc: TscModel, target: tuple[float, float], c_b: float, horizon: int, extras: Extras
    ):
        import casadi as ca

        self.tsc = tsc
        self.target = target
        self.c_b = c_b
        self.horizon = horizon
        self.extras = extras
        robot = tsc.robot
        self.units = np.array([1.0, robot.p_max - robot.p_min, c_b, c_b])
        self.zero = np.array([0.0, robot.p_min, target[1], target[0]])
        self.symbol = ca.SX
        try:
            self.added = self._added()
        except _UntraceableError:  # interpolants, callbacks and the like take MX only
            self.symbol = ca.MX
            self.added = self._added()
        self.constraints = self.added.size1_out(1)
        self._check()
        rule = self._rule()
        self._slopes_over_horizon = self._slopes.map(horizon) if extras.cost is not None else None
        self._over_horizon = rule if horizon == 1 else rule.mapaccum("rule_over_horizon", horizon)
        self._steps = np.arange(horizon, dtype=float)[None, :]

    def _added(self):
        """Return (x, u, k) → (cost over c_b², scaled constraints, c̲, c̄), in the user's units."""
        import casadi as ca

        symbol = self.symbol
        extras = self.extras
        robot = self.tsc.robot
        x = symbol.sym("x", 4)
        u = symbol.sym("u", 2)
        k = symbol.sym("k")
        cost = symbol(0)
        rows = symbol(0, 1)
        if extras.cost is not None:
            cost = _scalar(symbol, "extra_cost", self._call("extra_cost", extras.cost, x, u, k))
        if extras.constraints is not None:
            rows = self._call("extra_constraints", extras.constraints, x, u, k)
            parts = rows if isinstance(rows, list | tuple) else [rows]
            rows = ca.vertcat(*(_column(symbol, "extra_constraints", part) for part in parts))
            if rows.numel() == 0:
                raise ValueError(
                    "extra_constraints returned nothing; leave it out, or return expressions to "
                    "be kept at or below 0"
                )
        bounds = self._call(
            "incentive", extras.incentive, x[0], x[1], self.c_b, robot.p_min, robot.p_max
        )
        if not isinstance(bounds, list | tuple) or len(bounds) != 2:
            raise ValueError(
                "incentive must return two values, the least and the greatest correction"
            )
        low, high = (_scalar(symbol, "incentive", bound) for bound in bounds)
        try:
            slopes = ca.Function("slopes", [x, u, k], [ca.jacobian(rows, x), ca.jacobian(rows, u)])
            rows = rows / self._row_sizes(slopes) if rows.numel() else rows
            self._slopes = ca.Function(
                "cost_slopes",
                [x, u, k],
                [ca.gradient(cost, x) / self.c_b, ca.gradient(cost, u) / self.c_b],
            )
            return ca.Function("added", [x, u, k], [cost / self.c_b**2, rows, low, high])
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1][-200:]
            raise ValueError(
                "extra_cost, extra_constraints and incentive may depend on their arguments "
                f"alone: {reason}"
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
                f"{name} could not be called with CasADi symbols ({reason}); use arithmetic and "
                "casadi functions, and casadi.if_else in place of if"
            ) from error

    def _row_sizes(self, slopes) -> np.ndarray:
        """Return each constraint's greatest change per scaled unknown, for one tolerance."""
        size = 0.0
        for x in self._places():
            by_x, by_u = (np.abs(np.asarray(value)) for value in slopes(x, [0.0, 0.0], 0))
            size = np.maximum(
                size, np.maximum((by_x * self.units).max(axis=1), by_u.max(axis=1) * self.c_b)
            )
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
            low = float(values[2][0, 0])
            high = float(values[3][0, 0])
            if not -self.c_b * (1.0 + 1e-9) <= low <= 0.0 <= high <= self.c_b * (1.0 + 1e-9):
                raise ValueError(
                    f"incentive gives [{low:g}, {high:g}] {where}; as in (2.41), it must bound "
                    f"corrections by c_b = {self.c_b:g} and let thresholds be held"
                )

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
        rest = ca.fmax(r, TINY)
        load = ca.fmax(1.0 - r, TINY)
        bell = human.beta * ca.log(rest / human.beta) + (1.0 - human.beta) * ca.log(
            load / (1.0 - human.beta)
        )
        bell = ca.if_else(ca.fmin(rest, load) > TINY, ca.exp(bell), 0.0)
        return (human.p_max - human.p_min) * bell + human.p_min

    def motion(self, x, mode_at: Callable):
        """
        Return r and P_r one step later (2.44), mode and TSC.

        Parameters
        ----------
        x : casadi.SX or casadi.MX
            r, P_r, TSC_u and TSC_l.
        mode_at : callable
            mode_at(tsc), the mode at this TSC.
        """
        robot = self.tsc.robot
        p_h = self.performance(x[0])
        tsc = tsc_at.py_func(x[1], p_h, self.tsc.constants())
        mode = mode_at(tsc)
        r = next_utilization.py_func(x[0], mode, self.tsc.human.a)
        p_r = next_performance.py_func(x[1], p_h, mode, robot.a, robot.b, robot.p_min)
        return r, p_r, mode, tsc

    def _rule(self):
        """
        Return the hard rule (2.8) and one step of (2.44) as a function.

        It maps state and mode before, w and where thresholds may go, and k to state and mode after,
        and to corrections, TSC, added cost, greatest constraint and bounds of the corrections.
        """
        import casadi as ca

        symbol = self.symbol
        state = symbol.sym("state", 5)
        inputs = symbol.sym("inputs", 6)
        k = symbol.sym("k")
        x = state[:-1]
        before = state[-1]
        r, p_r, mode, tsc = self.motion(
            x, lambda tsc: ca.if_else(tsc >= x[2], 0.0, ca.if_else(tsc <= x[3], 1.0, before))
        )
        _, _, low, high = self.added(x, ca.DM.zeros(2), k)
        # A threshold that is already outside its interval is held there, so that corrections stay
        # within (2.41).
        least = ca.fmin(inputs[2:4], x[2:])
        most = ca.fmax(inputs[4:6], x[2:])
        moved = ca.fmin(ca.fmax(x[2:] + low + inputs[:2] * (high - low), least), most)
        u = moved - x[2:]
        cost, rows, _, _ = self.added(x, u, k)
        worst = ca.mmax(rows) if self.constraints else symbol(-1.0)
        after = ca.vertcat(r, p_r, moved, mode)
        outputs = ca.vertcat(u, tsc, cost, worst, low, high)
        return ca.Function("rule", [state, inputs, k], [after, outputs])

    def steepness(self, run: HardRun) -> float:
        """
        Return the scale of the objective: the greatest slope of the cost, at least 1.

        The slope is that of the cost over c_b² with respect to a correction.

        Parameters
        ----------
        run : HardRun
            Where the slopes are evaluated.
        """
        by_threshold = 2.0 * (run.states[2:, 1:] - self.zero[2:, None]) / self.c_b
        by_input: Any = 0.0
        if self._slopes_over_horizon is not None:
            by_x, by_u = self._slopes_over_horizon(run.states[:, :-1], run.inputs, self._steps)
            by_threshold[:, :-1] += np.asarray(by_x)[2:, 1:]
            by_input = np.asarray(by_u)
        by_input = by_input + np.cumsum(by_threshold[:, ::-1], axis=1)[:, ::-1]
        return max(1.0, float(np.nan_to_num(np.abs(by_input)).max()))

    def allowed(self, upper: float, lower: float) -> np.ndarray:
        """
        Return where TSC_u and TSC_l may go: least, then greatest, at each step.

        Each keeps between its value now and its target.

        Parameters
        ----------
        upper, lower : float
            TSC_u and TSC_l now.
        """
        ends = np.array([[upper, lower], [self.target[1], self.target[0]]])
        return np.repeat(
            np.stack([ends.min(axis=0), ends.max(axis=0)])[:, :, None], self.horizon, axis=2
        )

    def run(self, state: np.ndarray, w: np.ndarray, allowed: np.ndarray) -> HardRun:
        """
        Run the model under the hard rule (2.8), scaling `w` to corrections along the way.

        Parameters
        ----------
        state : numpy.ndarray, shape (5,)
            r, P_r, TSC_u, TSC_l and the mode before.
        w : numpy.ndarray, shape (2, N)
            c_u and c_l as shares of what (2.41) allows.
        allowed : numpy.ndarray, shape (2, 2, N)
            The intervals of the thresholds, see `allowed`.
        """
        inputs = np.concatenate([w, allowed[0], allowed[1]])
        run = self._over_horizon(state, inputs, self._steps)
        states, outputs = (np.asarray(value) for value in run)
        corrections = outputs[:2]
        tsc, added, worst, low, high = outputs[2:]
        error = (states[2:4] - self.zero[2:, None]) / self.c_b
        base = float(np.sum(error * error))
        width = high - low
        shares = np.where(width > 0.0, (corrections - low) / np.where(width > 0.0, width, 1.0), 0.0)
        cost = base + float(added.sum())
        finite = np.isfinite(states).all() and np.isfinite(cost)
        apart = (states[3] < states[2]).all()
        return HardRun(
            states=np.hstack([state[:4, None], states[:4]]),
            mode=states[4],
            tsc=tsc,
            inputs=corrections,
            w=np.clip(shares, 0.0, 1.0),
            cost=cost,
            size=base + float(np.abs(added).sum()),
            worst=float(worst.max()),
            sound=bool(finite and apart and (low <= 0.0).all() and (high >= 0.0).all()),
        )


@dataclass(frozen=True, eq=False)
class HardRun:
    """
    A run under the hard rule.

    Parameters
    ----------
    states : numpy.ndarray, shape (4, N + 1)
        r, P_r, TSC_u, TSC_l.
    mode, tsc : numpy.ndarray, shape (N,)
        Mode and TSC at each step.
    inputs, w : numpy.ndarray, shape (2, N)
        c_u and c_l, and the same as shares of what (2.41) allows.
    cost, size : float
        (2.43) and the added cost, over c_b²; and the same with the absolute value of every term.
    worst : float
        Greatest of the added constraints, scaled; −1 without any.
    sound : bool
        Whether all values are finite, thresholds never cross, and the incentives include 0
        throughout.
    """

    states: np.ndarray
    mode: np.ndarray
    tsc: np.ndarray
    inputs: np.ndarray
    w: np.ndarray
    cost: float
    size: float
    worst: float
    sound: bool


class CorrectionProgram:
    """
    Multiple shooting: the states at every step are unknowns, between which (2.44) holds.

    With `width` 0 the modes are given, one per step; r and P_r then follow from them whatever the
    corrections, and the solution is exact for that mode sequence. With a positive width the mode is
    a fifth state m in [0, 1], the memory of (2.8): m(k) = (1 − σ((TSC − TSC_u)/width)) (d + (1 − d)
    m(k − 1)) with d = σ((TSC_l − TSC)/width) and σ(y) = 1/(1 + exp(−y)). Several widths inside the
    thresholds both σ vanish and m keeps its value; four widths beyond one of them, 98 % of the
    switch happens in one step. Where TSC turns back earlier than that, m stays between 0 and 1: the
    smoothed program only suggests a mode sequence; no plan is judged by it.

    Parameters
    ----------
    model : CorrectionModel
        Model, target and the user's additions.
    solver : str
        One of SOLVERS.
    width : float
        Width of the switch, in units of TSC; 0 takes the modes as given.
    """

    def __init__(self, model: CorrectionModel, solver: str, width: float = 0.0):
        import casadi as ca

        self.model = model
        self.solver = solver
        self.width = width
        self.size = size = 5 if width else 4
        n = model.horizon
        symbol = model.symbol
        stage = self._stage()
        start = symbol.sym("start", size)
        modes = symbol.sym("modes", n)
        rho = symbol.sym("rho")
        now = symbol.sym("x_0", size)
        unknowns = [now]
        rows = []
        equal = []
        cost = 0
        begins = now - start
        for k in range(n):
            w = symbol.sym(f"w_{k}", 2)
            after = symbol.sym(f"x_{k + 1}", size)
            reached, added, constraints = stage(now, w, modes[k], k)
            unknowns += [w, after]
            equations = [after - reached, begins] if k == 0 else [after - reached]
            rows += [*equations, constraints]
            equal += [True] * (size * len(equations)) + [False] * constraints.numel()
            cost += rho * (added + after[2] ** 2 + after[3] ** 2)
            now = after
        program = {
            "x": ca.vertcat(*unknowns),
            "p": ca.vertcat(start, modes, rho),
            "f": cost,
            "g": ca.vertcat(*rows),
        }
        convex = not model.extras.any and not width
        options = _options(solver, equal, convex, iterations=60 if width else 100)
        method = solver if solver in INTERIOR else "sqpmethod"
        self._solver = ca.nlpsol("correction", method, program, options)
        self._least_rows = np.where(equal, 0.0, -np.inf)
        first = size + (size + 2) * np.arange(n)
        self._at_w = first[None, :] + np.arange(2)[:, None]
        states = first[None, :] + 2 + np.arange(size)[:, None]
        self._at_x = np.hstack([np.arange(size)[:, None], states])
        count = self._at_x.size + self._at_w.size
        self._least = np.full(count, -np.inf)
        self._most = np.full(count, np.inf)
        self._least[self._at_w], self._most[self._at_w] = 0.0, 1.0

    def _stage(self):
        """
        Return (scaled state, w, mode, k) → (scaled state after, added cost over c_b², constraints).
        """
        import casadi as ca

        model = self.model
        symbol = model.symbol
        c_b = model.c_b
        z = symbol.sym("z", self.size)
        w = symbol.sym("w", 2)
        given_mode = symbol.sym("mode")
        k = symbol.sym("k")
        x = model.zero + model.units * z[:4]

        def mode_at(tsc):
            if not self.width:
                return given_mode
            up = _sigmoid((tsc - x[2]) / self.width)
            down = _sigmoid((x[3] - tsc) / self.width)
            return (1.0 - up) * (down + (1.0 - down) * z[4])

        r, p_r, mode, _ = model.motion(x, mode_at)
        _, _, low, high = model.added(x, ca.DM.zeros(2), k)
        u = low + w * (high - low)
        cost, rows, _, _ = model.added(x, u, k)
        thresholds = z[2:4] + u / c_b
        if model.extras.any:  # thresholds must not cross; with (2.43) alone they never do
            apart = (model.target[1] - model.target[0]) / c_b
            rows = ca.vertcat(rows, (thresholds[1] - thresholds[0] - apart + 1e-3) / apart)
        after = [r, (p_r - model.zero[1]) / model.units[1], thresholds]
        after += [mode] if self.width else []
        return ca.Function("stage", [z, w, given_mode, k], [ca.vertcat(*after), cost, rows])

    def solve(
        self, guess: HardRun, mode: float, thresholds: np.ndarray | None = None
    ) -> tuple[np.ndarray | None, str]:
        """
        Solve from a guess; return shares of what (2.41) allows, or None and the reason.

        Parameters
        ----------
        guess : HardRun
            The starting point; its modes are those given to the program.
        mode : float
            Mode before the first step: 1 manual, 0 autonomous.
        thresholds : numpy.ndarray, shape (2, 2, N), optional
            Least, then greatest TSC_u and TSC_l after each step; free when not given.

        Returns
        -------
        w : numpy.ndarray, shape (2, N), or None
        reason : str
        """
        model = self.model
        start = np.empty(self._least.size)
        start[self._at_x[:4]] = (guess.states - model.zero[:, None]) / model.units[:, None]
        start[self._at_w] = guess.w
        if self.width:
            start[self._at_x[4]] = np.r_[mode, guess.mode]
        least = self._least
        most = self._most
        if thresholds is not None:
            least = least.copy()
            most = most.copy()
            z = (thresholds - model.zero[None, 2:, None]) / model.c_b
            least[self._at_x[2:4, 1:]] = z[0] - SLACK
            most[self._at_x[2:4, 1:]] = z[1] + SLACK
        rho = 1.0 / model.steepness(guess)
        parameters = np.concatenate([start[self._at_x[:, 0]], guess.mode, [rho]])
        try:
            # No initial multipliers: sqpmethod does not check complementarity and would stop at the
            # guess if given old ones.
            solution = self._solver(
                x0=start, p=parameters, lbx=least, ubx=most, lbg=self._least_rows, ubg=0.0
            )
            stats = self._solver.stats()
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1][-200:]
            # What CasADi raises when a quadratic program ends without a status.
            if "basic_string" in reason:
                reason = "a quadratic program within it has no solution"
            return None, f"{self.solver}: {reason}"
        x = np.asarray(solution["x"]).ravel()
        if not stats["success"]:
            return None, f"{self.solver}: {stats.get('return_status', 'no success')}"
        if not np.isfinite(x).all():
            return None, f"{self.solver}: its solution is not finite"
        return np.clip(x[self._at_w], 0.0, 1.0), ""


def _sigmoid(y):
    import casadi as ca

    return 0.5 * (1.0 + ca.tanh(0.5 * y))


def _options(solver: str, equal: list[bool], convex: bool, iterations: int) -> dict:
    """Return a solver's options: no output, tolerances, and the structure of the program."""
    if solver in INTERIOR:
        options = QUIET | {solver: INTERIOR[solver] | {"max_iter": iterations}}
        if solver == "fatrop":
            options |= {"structure_detection": "auto", "equality": equal}
        return options
    inner = QUIET | SEQUENTIAL[solver]
    options = QUIET | QUIET_SQP | {"qpsol": solver, "qpsol_options": inner, "max_iter": 15}
    # For given modes (2.43) is one convex quadratic program: full steps, where a line search would
    # stall on rounding.
    return options | ({"max_iter_ls": 0} if convex else {"convexify_strategy": "eigen-clip"})


class _UntraceableError(Exception):
    """A user's function does not accept scalar symbols."""


def _scalar(symbol, name: str, value):
    """Return a user's value as one CasADi scalar."""
    out = _column(symbol, name, value)
    if out.numel() != 1:
        raise ValueError(f"{name} must return a scalar, got shape {out.shape}")
    return out


def _column(symbol, name: str, value):
    """Return a user's value as a CasADi column."""
    import casadi as ca

    try:
        if isinstance(value, bool):
            raise TypeError
        return ca.vec(symbol(value))
    # These are raised by CasADi for a value that it cannot convert.
    except (NotImplementedError, TypeError, RuntimeError):
        raise ValueError(
            f"{name} must return a CasADi expression or a number, got {type(value).__name__}"
        ) from None
