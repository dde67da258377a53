"""
The correction (2.40)-(2.44) as one nonlinear program in CasADi, for costs of one's own.

The hard switch (2.8) makes the problem piecewise smooth. The program smooths it: the mode is a
state m in [0, 1], the memory of (2.8), with m(k) = (1 − σ((TSC − TSC_u)/w)) (d + (1 − d) m(k − 1)),
d = σ((TSC_l − TSC)/w), σ(y) = 1/(1 + exp(−y)) and the switch width w. No plan is judged by it: what
the solver returns is run under the hard switch, as is the clipped plan, and the cheaper is the
plan. It is a local optimum at best. Where the solver fails or takes too long, the
thresholds are held.
"""

from collections.abc import Callable
from operator import itemgetter
from time import perf_counter
from typing import Any

import numpy as np

from trustlab.allocation.correction import C_L, C_U, MODE, P_R, L, R, U
from trustlab.models.checks import not_negative, positive
from trustlab.models.tsc import next_performance, next_utilization, tsc_at

# How near to rest and full load (2.6) is differentiated, and in c_b the narrowest box, how far
# thresholds may leave their intervals, and how far apart they must stay.
STEEP = 1e-9
NARROW = 1e-9
SLACK = 1e-6

# The solver begins at the clipped plan, so that it needs neither a barrier that leads it away from
# its bounds nor a first guess of multipliers; the pivot order is quicker than MUMPS' own choice.
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-7,
    "mu_init": 1e-9,
    "bound_push": 1e-7,
    "bound_frac": 1e-7,
    "constr_mult_init_max": 0.0,
    "min_refinement_steps": 0,
    "mumps_pivot_order": 0,
}

UNSOLVED = "The thresholds are held, as the solver found no plan: {reason}."
SOLVED = (
    "The cheaper, under the hard switch, of the solver's local optimum and the clipped plan; not "
    "proved optimal."
)


class CorrectionProgram:
    """
    Multiple shooting over the horizon, solved by IPOPT, which keeps to a limit of time.

    Parameters
    ----------
    corrector : ThresholdCorrector
        The problem, and who follows corrections under the hard switch.
    extra_cost : callable
        extra_cost(x, u, k), a scalar added to (2.43), with x = [r, P_r, TSC_u, TSC_l] and u = [c_u,
        c_l] of step k; called with CasADi symbols, as the incentive is.
    switch_width : float
        Width of the smoothed switch, in units of TSC; 0 takes the modes of the clipped plan.
    limit : float
        Seconds that a step may compute.

    Raises
    ------
    ValueError
        If a function cannot be called with symbols.
    """

    def __init__(
        self,
        corrector: Any,
        extra_cost: Callable | None = None,
        switch_width: float = 1e-3,
        limit: float = 1.0,
    ):
        import casadi as ca

        self.corrector = corrector
        self.width = not_negative("switch_width", switch_width)
        # States are TSC_u and TSC_l, from their targets in c_b, r, P_r and the mode before. Where
        # modes are given, corrections move the thresholds alone.
        self.moving = 5 if self.width else 2
        self.limit = positive("limit", limit)
        # Only a cost of one's own has reasons to move one threshold beyond the other.
        self.guarded = extra_cost is not None
        robot, c_b = corrector.tsc.robot, corrector.c_b
        x, u, k = ca.MX.sym("x", 4), ca.MX.sym("u", 2), ca.MX.sym("k")
        try:
            added = ca.Function(
                "added", [x, u, k], [ca.MX(extra_cost(x, u, k) if extra_cost else 0.0)]
            )
            bounds = corrector.incentive(x[0], x[1], c_b, robot.p_min, robot.p_max)
            box = ca.Function("box", [x], [ca.MX(bound) for bound in bounds])
        except Exception as error:
            raise ValueError(
                "extra_cost(x, u, k) and incentive are called with CasADi symbols and must depend "
                "on their arguments alone; use arithmetic and casadi functions, and casadi.if_else "
                f"in place of if; got {type(error).__name__}: {str(error).strip()[-200:]}"
            ) from error
        if added.numel_out() != 1:
            raise ValueError(f"extra_cost must return one number, got {added.numel_out()}")
        n = corrector.horizon
        path = ca.MX.sym("path", 6, n)
        costs = added.map(n)(path[:4, :], path[4:, :], np.arange(n)[None, :])
        self._added = ca.Function("added", [path], [ca.sum2(costs)])
        self._solver = self._program(box.map(n))

    def _program(self, box: Any) -> Any:
        """
        Return the solver of all steps, the states after them being unknowns; rows are one quantity
        over the horizon.
        """
        import casadi as ca

        tsc, (goal_l, goal_u), c_b = self.corrector.tsc, self.corrector.target, self.corrector.c_b
        robot, human, n = tsc.robot, tsc.human, self.corrector.horizon
        path, scale = ca.MX.sym("path", 5, n + 1), ca.MX.sym("scale")
        moving = ca.MX.sym("moving", self.moving, n)
        states = ca.vertcat(moving, path[self.moving :, 1:])
        z_u, z_l, r, p_r, before = ca.vertsplit(ca.horzcat(path[:, :1], states[:, :-1]))
        upper, lower = goal_u + c_b * z_u, goal_l + c_b * z_l
        x = ca.vertcat(r, p_r, upper, lower)
        u = c_b * (states[:2, :] - ca.vertcat(z_u, z_l))
        least, most = box(x)
        width = ca.fmax(most - least, NARROW * c_b)
        shares = (u - ca.vertcat(least, least)) / ca.vertcat(width, width)
        inside = ca.fmin(ca.fmax(r, STEEP), 1.0 - STEEP)
        shape = human.beta * ca.log(inside / human.beta)
        shape += (1.0 - human.beta) * ca.log((1.0 - inside) / (1.0 - human.beta))
        p_h = human.p_min + (human.p_max - human.p_min) * ca.exp(shape)  # (2.6)
        value = tsc_at.py_func(p_r, p_h, tsc.constants())  # (2.1)
        mode = path[4, 1:]
        if self.width:  # (2.8), smoothed
            up = 0.5 * (1.0 + ca.tanh(0.5 * (value - upper) / self.width))
            down = 0.5 * (1.0 + ca.tanh(0.5 * (lower - value) / self.width))
            mode = (1.0 - up) * (down + (1.0 - down) * before)
        after_r = next_utilization.py_func(r, mode, human.a)
        after_p = next_performance.py_func(p_r, p_h, mode, robot.a, robot.b, robot.p_min)
        missed = states[2:, :] - ca.vertcat(after_r, after_p, mode)
        rows = ca.vertcat(shares, missed)[: self.moving, :]
        if self.guarded:
            apart = (goal_u - goal_l) / c_b + states[0, :] - states[1, :] - SLACK
            rows = ca.vertcat(apart, rows)
        cost = self._added(ca.vertcat(x, u)) / c_b**2 + ca.sumsqr(states[:2, :])
        program = {
            "x": ca.vec(moving),
            "p": ca.veccat(path, scale),
            "f": scale * cost,
            "g": ca.vec(rows),
        }
        ipopt = IPOPT | {"max_wall_time": self.limit}
        options = {"print_time": False, "error_on_fail": False, "expand": True, "ipopt": ipopt}
        return ca.nlpsol("correction", "ipopt", program, options)

    def improved(
        self, state: np.ndarray, mode: int, cost: float, path: np.ndarray
    ) -> tuple[float, np.ndarray, str]:
        """
        Return cost and path of the best plan found, and what to say of it; the cost is NaN where
        there is none.

        Parameters
        ----------
        state : numpy.ndarray, shape (4,)
            r, P_r, TSC_l and TSC_u now.
        mode : int
            Mode before now.
        cost, path : float, numpy.ndarray
            The clipped plan.
        """
        began = perf_counter()
        try:
            corrections, reason = self._solved(mode, path)
            moved, _, other = self.corrector.followed(
                state, mode, np.ascontiguousarray(corrections)
            )
            plans = self._judged(cost, path), self._judged(moved, other)
        except RuntimeError as error:  # CasADi's, as where it cannot evaluate the user's functions
            reason = str(error).strip().splitlines()[-1][-200:]
            return np.nan, path, UNSOLVED.format(reason=reason)
        if perf_counter() - began > self.limit:
            reason = f"it takes longer than limit = {self.limit:g} s"
        cost, path = min(plans, key=itemgetter(0))
        if not np.isfinite(cost):
            reason = "no plan has a finite cost"
        return (np.nan, path, UNSOLVED.format(reason=reason)) if reason else (cost, path, SOLVED)

    def _judged(self, cost: float, path: np.ndarray) -> tuple[float, np.ndarray]:
        """
        Return the cost with the user's, infinite where that is no number or the thresholds cross,
        and the path.
        """
        total = cost + float(self._added(path[[R, P_R, U, L, C_U, C_L], :-1]))
        return (total if np.isfinite(total) and all(path[L] < path[U]) else np.inf), path

    def _solved(self, mode: int, guess: np.ndarray) -> tuple[np.ndarray, str]:
        """Return c_l and c_u to which the solver comes from a path, and why not to use them."""
        c_b, target = self.corrector.c_b, np.array(self.corrector.target)
        thresholds = (guess[[U, L]] - target[::-1, None]) / c_b
        z = np.vstack([thresholds, guess[[R, P_R]], np.r_[mode, guess[MODE, :-1]]])
        now, start = z[:2, :1], z[: self.moving, 1:]
        # Both thresholds stay between their values now and their targets, which are 0.
        least = np.full_like(start, -np.inf)
        most = -least
        least[:2], most[:2] = np.minimum(now, 0.0) - SLACK, np.maximum(now, 0.0) + SLACK
        greatest = [np.inf] * self.guarded + [1.0, 1.0, 0.0, 0.0, 0.0][: self.moving]
        solution = self._solver(
            x0=start.ravel("F"),
            p=np.r_[z.ravel("F"), 1.0 / max(1.0, np.sum(now**2))],
            lbx=least.ravel("F"),
            ubx=most.ravel("F"),
            lbg=0.0,
            ubg=greatest * self.corrector.horizon,
        )
        reached = np.asarray(solution["x"]).reshape(-1, self.moving).T[:2]
        steps = np.diff(np.c_[now, reached], axis=1)[::-1] * c_b
        stats = self._solver.stats()
        return steps, "" if stats["success"] else str(stats["return_status"])
