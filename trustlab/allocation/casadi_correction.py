"""
The correction (2.40)-(2.44) as one nonlinear program in CasADi, for costs of one's own.

The hard switch (2.8) makes the problem piecewise smooth. The program smooths it: the mode is a
state m in [0, 1], the memory of (2.8), with m(k) = (1 − σ((TSC − TSC_u)/w)) (d + (1 − d) m(k − 1)),
d = σ((TSC_l − TSC)/w), σ(y) = 1/(1 + exp(−y)) and the switch width w. No plan is judged by it: what
the solver returns is run under the hard switch, as are the clipped plan and holding, and the
cheapest is the plan. It is a local optimum at best. Where the solver fails or takes too long, the
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

# How near to rest and full load (2.6) is differentiated.
STEEP = 1e-9

COST = itemgetter(0)

UNSOLVED = "The thresholds are held, as the solver found no plan: {reason}."
SOLVED = (
    "The cheapest, under the hard switch, of the solver's local optimum, the clipped plan and "
    "holding; not proved optimal."
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
        extra_cost: Callable = lambda x, u, k: 0.0,
        switch_width: float = 1e-3,
        limit: float = 1.0,
    ):
        import casadi as ca

        self.corrector = corrector
        self.width = not_negative("switch_width", switch_width)
        # Where modes are given, corrections move the thresholds alone.
        self.moving = [0, 1, 2, 3, 4] if self.width else [2, 3]
        self.limit = positive("limit", limit)
        robot, (lower, upper), c_b = corrector.tsc.robot, corrector.target, corrector.c_b
        self.zero = np.array([0.0, robot.p_min, upper, lower])
        self.units = np.array([1.0, robot.p_max - robot.p_min, c_b, c_b])
        x, u, k = ca.MX.sym("x", 4), ca.MX.sym("u", 2), ca.MX.sym("k")
        try:
            added = ca.Function("added", [x, u, k], [ca.MX(extra_cost(x, u, k))])
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
        self._added, self._boxes = added.map(n), box.map(n)
        self._solver = self._program(self._stage(box, added).map(n), n)

    def _stage(self, box: Any, added: Any) -> Any:
        """
        Return one step of (2.44) as a function.

        From scaled states with the mode before, corrections as shares of their boxes, a given mode
        and the step to scaled states after, and the cost of the step over c_b².
        """
        import casadi as ca

        tsc, c_b = self.corrector.tsc, self.corrector.c_b
        robot, human = tsc.robot, tsc.human
        # Scaled r, P_r, TSC_u and TSC_l, and the mode before.
        z, w = ca.MX.sym("z", 5), ca.MX.sym("w", 2)
        given, k = ca.MX.sym("given"), ca.MX.sym("k")
        state = self.zero + self.units * z[:4]
        r, p_r, upper, lower = ca.vertsplit(state)
        least, most = box(state)
        inside = ca.fmin(ca.fmax(r, STEEP), 1.0 - STEEP)
        shape = human.beta * ca.log(inside / human.beta)
        shape += (1.0 - human.beta) * ca.log((1.0 - inside) / (1.0 - human.beta))
        p_h = human.p_min + (human.p_max - human.p_min) * ca.exp(shape)  # (2.6)
        value = tsc_at.py_func(p_r, p_h, tsc.constants())  # (2.1)
        mode = given
        if self.width:  # (2.8), smoothed
            up = 0.5 * (1.0 + ca.tanh(0.5 * (value - upper) / self.width))
            down = 0.5 * (1.0 + ca.tanh(0.5 * (lower - value) / self.width))
            mode = (1.0 - up) * (down + (1.0 - down) * z[4])
        after_r = next_utilization.py_func(r, mode, human.a)
        after_p = next_performance.py_func(p_r, p_h, mode, robot.a, robot.b, robot.p_min)
        step = least + w * (most - least)
        moved = z[2:4] + step / c_b
        after = ca.vertcat(after_r, (after_p - robot.p_min) / self.units[1], moved, mode)
        cost = added(state, step, k) / c_b**2 + ca.sumsqr(moved)
        return ca.Function("stage", [z, w, given, k], [after, cost])

    def _program(self, stages: Any, n: int) -> Any:
        """Return the solver of all steps, the states between them being unknowns."""
        import casadi as ca

        moving, shares = ca.MX.sym("moving", len(self.moving), n), ca.MX.sym("shares", 2, n)
        path, scale = ca.MX.sym("path", 5, n + 1), ca.MX.sym("scale")
        rows = ca.vertsplit(path[:, 1:])
        for place, row in zip(self.moving, ca.vertsplit(moving), strict=True):
            rows[place] = row
        states = ca.vertcat(*rows)
        before = ca.horzcat(path[:, :1], states[:, :-1])
        reached, costs = stages(before, shares, path[4, 1:], np.arange(n)[None, :])
        program = {
            "x": ca.veccat(moving, shares),
            "p": ca.veccat(path, scale),
            "f": scale * ca.sum2(costs),
            "g": ca.vec((states - reached)[self.moving, :]),
        }
        ipopt = {"print_level": 0, "sb": "yes", "tol": 1e-7, "max_wall_time": self.limit}
        ipopt |= {"mumps_pivot_order": 0}  # quicker than the choice by size that MUMPS makes
        # The solver begins at a good plan, and must not push it far from its bounds.
        ipopt |= {"mu_init": 1e-5, "bound_push": 1e-7, "bound_frac": 1e-7}
        options = {"print_time": False, "error_on_fail": False, "expand": True, "ipopt": ipopt}
        return ca.nlpsol("correction", "ipopt", program, options)

    def improved(self, state: np.ndarray, mode: int) -> tuple[float, np.ndarray, str]:
        """
        Return cost and path of the best plan found, and what to say of it; the cost is NaN where
        there is none.

        Parameters
        ----------
        state : numpy.ndarray, shape (4,)
            r, P_r, TSC_l and TSC_u now.
        mode : int
            Mode before now.
        """
        began = perf_counter()
        size = 2, self.corrector.horizon
        simple = [self._judged(state, mode, np.full(size, each)) for each in (np.nan, 0.0)]
        best = min(simple, key=COST)
        path = best[1]
        corrections, reason = self._solved(state, mode, path)
        if perf_counter() - began > self.limit:
            reason = f"it takes longer than limit = {self.limit:g} s"
        best = min(best, self._judged(state, mode, corrections), key=COST)
        if not np.isfinite(best[0]):
            reason = "no plan has a finite cost"
        return (np.nan, path, UNSOLVED.format(reason=reason)) if reason else (*best, SOLVED)

    def _judged(
        self, state: np.ndarray, mode: int, corrections: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Return (2.43) with the user's cost, and the path, of corrections."""
        cost, _, path = self.corrector.followed(state, mode, corrections)
        steps = np.arange(self.corrector.horizon)[None, :]
        added = self._added(path[[R, P_R, U, L], :-1], path[[C_U, C_L], :-1], steps)
        total = cost + float(np.sum(np.asarray(added)))
        return (total if np.isfinite(total) else np.inf), path

    def _solved(self, state: np.ndarray, mode: int, guess: np.ndarray) -> tuple[np.ndarray, str]:
        """Return c_l and c_u to which the solver comes from a path, and why not to use them."""
        n = self.corrector.horizon
        x = guess[[R, P_R, U, L]]
        z = np.vstack([(x.T - self.zero).T / self.units[:, None], np.r_[mode, guess[MODE, :-1]]])
        low, high = (np.asarray(ends) for ends in self._boxes(x[:, :-1]))
        shares = (guess[[C_U, C_L], :-1] - low) / np.where(high > low, high - low, 1.0)
        # Both thresholds stay between their values now and their targets, which are 0.
        most = np.full((5, n), np.inf)
        least = -most
        now = z[2:4, :1]
        least[2:4], most[2:4] = np.minimum(now, 0.0) - 1e-6, np.maximum(now, 0.0) + 1e-6
        moving = self.moving
        try:
            solution = self._solver(
                x0=np.r_[z[moving, 1:].ravel("F"), np.clip(shares, 0.0, 1.0).ravel("F")],
                p=np.r_[z.ravel("F"), 1.0 / max(1.0, np.sum(now**2))],
                lbx=np.r_[least[moving].ravel("F"), np.zeros(2 * n)],
                ubx=np.r_[most[moving].ravel("F"), np.ones(2 * n)],
                lbg=0.0,
                ubg=0.0,
            )
        except RuntimeError as error:
            return shares, str(error).strip().splitlines()[-1][-200:]
        reached = np.asarray(solution["x"])[: len(moving) * n].reshape(n, -1).T
        both = slice(moving.index(2), moving.index(3) + 1)
        steps = np.diff(np.c_[now, reached[both]], axis=1)[::-1] * self.corrector.c_b
        stats = self._solver.stats()
        return steps, "" if stats["success"] else str(stats["return_status"])
