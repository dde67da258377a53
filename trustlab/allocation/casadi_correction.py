"""
The correction (2.40)-(2.44) as a nonlinear program in CasADi, for costs of one's own.

The hard switch (2.8) makes the problem piecewise smooth. The program keeps the modes of the clipped
plan, and with them r, P_r and the boxes (2.42), so that only the thresholds are unknown. What the
solver returns is run under the hard switch, as is the clipped plan, and the cheaper is the plan. It
is a local optimum at best. Where the solver fails or takes too long, the thresholds are held.
"""

from collections.abc import Callable
from operator import itemgetter
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np

from trustlab.allocation.correction import C_L, C_U, P_R, L, R, U
from trustlab.models.checks import positive

# How far, in c_b, thresholds may leave their intervals, and how far apart they must stay.
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
    The thresholds over the horizon as unknowns of IPOPT, which keeps to a limit of time.

    Parameters
    ----------
    corrector : ThresholdCorrector
        The problem, and who follows corrections under the hard switch.
    extra_cost : callable
        extra_cost(x, u, k), a scalar added to (2.43), with x = [r, P_r, TSC_u, TSC_l] and u = [c_u,
        c_l] of step k; called with CasADi symbols.
    limit : float
        Seconds that a step may compute.

    Raises
    ------
    ValueError
        If the function cannot be called with symbols.
    """

    def __init__(self, corrector: Any, extra_cost: Callable | None = None, limit: float = 1.0):
        self.corrector = corrector
        self.limit = positive("limit", limit)
        # (2.43) alone draws thresholds to their targets, on the way to which they cannot cross.
        self.guarded = extra_cost is not None
        x, u, k = ca.MX.sym("x", 4), ca.MX.sym("u", 2), ca.MX.sym("k")
        try:
            cost = ca.MX(extra_cost(x, u, k) if extra_cost else 0.0)
            added = ca.Function("added", [x, u, k], [cost])
        except Exception as error:
            raise ValueError(
                "extra_cost(x, u, k) is called with CasADi symbols and must depend on its "
                "arguments alone; use arithmetic and casadi functions, and casadi.if_else in place "
                f"of if; got {type(error).__name__}: {str(error).strip()[-200:]}"
            ) from error
        if added.numel_out() != 1:
            raise ValueError(f"extra_cost must return one number, got {added.numel_out()}")
        n = corrector.horizon
        path = ca.MX.sym("path", 6, n)
        costs = added.map(n)(path[:4, :], path[4:, :], np.arange(n)[None, :])
        self._added = ca.Function("added", [path], [ca.sum2(costs)])
        self._solver = self._program()

    def _program(self) -> Any:
        """Return the solver; rows are one quantity over the horizon, TSC_u before TSC_l."""
        n, c_b, (lower, upper) = self.corrector.horizon, self.corrector.c_b, self.corrector.target
        # Thresholds after each step, from their targets in c_b.
        z = ca.MX.sym("z", 2, n)
        now, known, scale = ca.MX.sym("now", 2), ca.MX.sym("known", 2, n), ca.MX.sym("scale")
        before = ca.horzcat(now, z[:, :-1])
        steps = z - before
        thresholds = ca.repmat(ca.DM([upper, lower]), 1, n) + c_b * before
        added = self._added(ca.vertcat(known, thresholds, c_b * steps))
        program = {
            "x": ca.vec(z),
            "p": ca.veccat(now, known, scale),
            "f": scale * (added / c_b**2 + ca.sumsqr(z)),
            "g": ca.veccat(steps, z[0, :] - z[1, :]) if self.guarded else ca.vec(steps),
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
            corrections, reason = self._solved(path)
            moved, _, other = self.corrector.followed(state, mode, corrections)
            plans = self._judged(cost, path), self._judged(moved, other)
        except RuntimeError as error:  # CasADi's, as where it cannot evaluate the user's function
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

    def _solved(self, path: np.ndarray) -> tuple[np.ndarray, str]:
        """Return c_l and c_u to which the solver comes from a path, and why not to use them."""
        corrector, c_b = self.corrector, self.corrector.c_b
        robot = corrector.tsc.robot
        upper_first = np.array(corrector.target)[::-1, None]
        z = (path[[U, L]] - upper_first) / c_b
        now, known = z[:, :1], path[[R, P_R], :-1]
        least, most = np.vectorize(corrector.incentive, "dd")(*known, c_b, robot.p_min, robot.p_max)
        apart = np.full(
            corrector.horizon * self.guarded, SLACK + np.diff(upper_first, axis=0) / c_b
        )
        # Both thresholds stay between their values now and their targets, which are 0.
        solution = self._solver(
            x0=z[:, 1:].ravel("F"),
            p=np.r_[now.ravel(), known.ravel("F"), 1.0 / max(1.0, np.sum(now**2))],
            lbx=np.tile(np.minimum(now, 0.0) - SLACK, corrector.horizon).ravel("F"),
            ubx=np.tile(np.maximum(now, 0.0) + SLACK, corrector.horizon).ravel("F"),
            lbg=np.r_[np.repeat(least / c_b, 2), apart],
            ubg=np.r_[np.repeat(most / c_b, 2), np.inf + apart],
        )
        reached = np.asarray(solution["x"]).reshape(-1, 2).T
        steps = np.diff(np.c_[now, reached])[::-1] * c_b
        stats = self._solver.stats()
        return np.ascontiguousarray(steps), "" if stats["success"] else stats["return_status"]
