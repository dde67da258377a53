"""
The correction (2.40)-(2.44) as one nonlinear program in CasADi, for costs of one's own.

The hard switch (2.8) makes the problem piecewise smooth. The program smooths it: the mode is a
state m in [0, 1], the memory of (2.8), with m(k) = (1 − σ((TSC − TSC_u)/w)) (d + (1 − d) m(k − 1)),
d = σ((TSC_l − TSC)/w), σ(y) = 1/(1 + exp(−y)) and the switch width w. No plan is judged by it: what
the solver returns is run under the hard switch, as are the clipped plan, the last plan and holding,
and the cheapest is the plan. It is a local optimum at best. Where the solver fails or takes too
long, the thresholds are held.
"""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from trustlab.allocation.correction_path import C_L, C_U, MODE, P_R, L, R, U, incentive_box
from trustlab.models.checks import not_negative, positive
from trustlab.models.tsc import TscModel, next_performance, next_utilization, tsc_at

# Width of the smoothed switch, in units of TSC: below the change of TSC in one step.
WIDTH = 1e-3

# How near to rest and full load (2.6) is differentiated.
STEEP = 1e-9

UNSOLVED = "The thresholds are held, as the solver found no plan: {reason}."
UNUSABLE = "The thresholds are held, as no plan has a finite cost."
SOLVED = "A local optimum of the user's cost; not proved optimal."
KEPT = "The solver's plan costs more under the hard switch than {name}, which is taken."


class CorrectionProgram:
    """
    Multiple shooting over the horizon, solved by IPOPT, which keeps to a limit of time.

    Parameters
    ----------
    tsc : TscModel
        The model.
    target : (float, float)
        TSC_ld and TSC_ud.
    c_b : float
        Largest correction per step.
    horizon : int
        N, steps.
    incentive : callable
        The bounds of the corrections; called with CasADi symbols.
    extra_cost : callable, optional
        extra_cost(x, u, k), a scalar added to (2.43), with x = [r, P_r, TSC_u, TSC_l] and u = [c_u,
        c_l] of step k.
    switch_width : float
        Width of the smoothed switch; 0 takes the modes of the clipped plan.
    limit : float
        Seconds that a step may compute.

    Raises
    ------
    ValueError
        If a function fails, or returns what is no finite number.
    """

    def __init__(
        self,
        tsc: TscModel,
        target: tuple[float, float],
        c_b: float,
        horizon: int,
        incentive: Callable = incentive_box,
        extra_cost: Callable | None = None,
        switch_width: float = WIDTH,
        limit: float = 1.0,
    ):
        import casadi as ca

        self.width = not_negative("switch_width", switch_width)
        self.limit = positive("limit", limit)
        self.horizon, self.c_b = horizon, c_b
        self._tsc = tsc
        robot = tsc.robot
        self.zero = np.array([0.0, robot.p_min, target[1], target[0]])
        self.units = np.array([1.0, robot.p_max - robot.p_min, c_b, c_b])
        self._last: np.ndarray | None = None
        x, u, k = (ca.MX.sym(name, size) for name, size in (("x", 4), ("u", 2), ("k", 1)))
        added = 0.0 if extra_cost is None else _called("extra_cost", extra_cost, x, u, k)
        if not isinstance(added, int | float | ca.MX | ca.SX | ca.DM) or ca.MX(added).numel() != 1:
            raise ValueError(f"extra_cost must return a scalar, got {added!r}")
        r, p_r, _, _ = ca.vertsplit(x)
        bounds = _called("incentive", incentive, r, p_r, c_b, robot.p_min, robot.p_max)
        box = ca.Function("box", [x], [ca.MX(bound) for bound in bounds])
        try:
            self._added = ca.Function("added", [x, u, k], [ca.MX(added)])
        except RuntimeError as error:
            raise ValueError("extra_cost may depend on its arguments alone") from error
        middle = float(self._added(self.zero + 0.5 * self.units, [0.0, 0.0], 0))
        if not np.isfinite(middle):
            raise ValueError(f"extra_cost gives {middle} at r = 0.5; it must be finite")
        self._over_horizon = self._added.map(horizon)
        self._boxes = box.map(horizon)
        self._solver = self._program(self._stage(box))

    def _stage(self, box: Any) -> Any:
        """
        Return one step of (2.44) as a function.

        From scaled states with the mode before, corrections as shares of their boxes, a given mode
        and the step to scaled states after, and the cost of the step over c_b².
        """
        import casadi as ca

        robot, human = self._tsc.robot, self._tsc.human
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
        value = tsc_at.py_func(p_r, p_h, self._tsc.constants())  # (2.1)
        mode = given
        if self.width:  # (2.8), smoothed
            up = 0.5 * (1.0 + ca.tanh(0.5 * (value - upper) / self.width))
            down = 0.5 * (1.0 + ca.tanh(0.5 * (lower - value) / self.width))
            mode = (1.0 - up) * (down + (1.0 - down) * z[4])
        after_r = next_utilization.py_func(r, mode, human.a)
        after_p = next_performance.py_func(p_r, p_h, mode, robot.a, robot.b, robot.p_min)
        step = least + w * (most - least)
        moved = z[2:4] + step / self.c_b
        after = ca.vertcat(after_r, (after_p - robot.p_min) / self.units[1], moved, mode)
        cost = self._added(state, step, k) / self.c_b**2 + ca.sumsqr(moved)
        return ca.Function("stage", [z, w, given, k], [after, cost])

    def _program(self, stage: Any) -> Any:
        """Return the solver of all steps, the states between them being unknowns."""
        import casadi as ca

        n = self.horizon
        states, shares = ca.MX.sym("states", 5, n), ca.MX.sym("shares", 2, n)
        start, rho = ca.MX.sym("start", 5), ca.MX.sym("rho")
        modes = ca.MX.sym("modes", 1, n)
        before = ca.horzcat(start, states[:, :-1])
        reached, costs = stage.map(n)(before, shares, modes, np.arange(n)[None, :])
        program = {
            "x": ca.vertcat(ca.vec(states), ca.vec(shares)),
            "p": ca.vertcat(start, ca.vec(modes), rho),
            "f": rho * ca.sum2(costs),
            "g": ca.vec(states - reached),
        }
        quiet = {"print_level": 0, "sb": "yes", "tol": 1e-7, "max_wall_time": self.limit}
        quiet |= {"mumps_pivot_order": 0}  # quicker than the choice by size that MUMPS makes
        # The solver begins at a good plan, and must not push it far from its bounds.
        quiet |= {"mu_init": 1e-5, "bound_push": 1e-7, "bound_frac": 1e-7}
        options = {"print_time": False, "error_on_fail": False, "expand": True, "ipopt": quiet}
        return ca.nlpsol("correction", "ipopt", program, options)

    def reset(self) -> None:
        """Forget the last plan, which is a candidate for the next one."""
        self._last = None

    def cost(self, base: float, path: np.ndarray) -> float:
        """
        Return (2.43) and the user's cost of a path under the hard switch.

        Parameters
        ----------
        base : float
            The cost (2.43).
        path : numpy.ndarray, shape (7, N + 1)
            The path, as in `CorrectionPlan`.
        """
        steps = np.arange(self.horizon)[None, :]
        added = self._over_horizon(path[[R, P_R, U, L], :-1], path[[C_U, C_L], :-1], steps)
        total = base + float(np.sum(np.asarray(added)))
        return total if np.isfinite(total) else np.inf

    def improved(
        self, corrector: Any, state: np.ndarray, mode: int, clipped: np.ndarray
    ) -> tuple[float, np.ndarray, str, bool]:
        """
        Return cost and path of the best plan found, what to say of it, and whether there is one.

        Parameters
        ----------
        corrector : ThresholdCorrector
            Who follows corrections under the hard switch.
        state : numpy.ndarray, shape (4,)
            r, P_r, TSC_l and TSC_u now.
        mode : int
            Mode before now.
        clipped : numpy.ndarray, shape (7, N + 1)
            The clipped plan, from which the solver begins.
        """
        began = perf_counter()
        candidates = {
            "the clipped plan": clipped[[C_L, C_U], :-1],
            "holding the thresholds": np.zeros((2, self.horizon)),
        }
        if self._last is not None:
            candidates["the last plan"] = np.c_[self._last[:, 1:], self._last[:, -1:]]
        judged = {}
        for name, corrections in candidates.items():
            judged[name] = self._judged(corrector, state, mode, corrections)
        best = min(judged, key=lambda name: judged[name][0])
        found, reason = self._solved(state, mode, judged[best][1])
        if perf_counter() - began > self.limit:
            reason = f"it takes longer than limit = {self.limit:g} s"
        if reason:
            self._last = None
            return np.nan, clipped, UNSOLVED.format(reason=reason), False
        solved = self._judged(corrector, state, mode, found)
        message = SOLVED
        if solved[0] > judged[best][0]:
            # The solver comes near an optimum, which the clipped plan may be exactly.
            if solved[0] > judged[best][0] + 1e-6 * abs(judged[best][0]):
                message = KEPT.format(name=best)
            solved = judged[best]
        cost, path = solved
        if not np.isfinite(cost):
            self._last = None
            return np.nan, clipped, UNUSABLE, False
        self._last = path[[C_L, C_U], :-1]
        return cost, path, message, True

    def _judged(
        self, corrector: Any, state: np.ndarray, mode: int, corrections: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Return cost and path of corrections."""
        base, _, sound, path = corrector.followed(state, mode, corrections)
        return (self.cost(base, path) if sound else np.inf), path

    def _shares(self, path: np.ndarray) -> np.ndarray:
        """Return c_u and c_l of a path as shares of their boxes."""
        low, high = (np.asarray(ends) for ends in self._boxes(path[[R, P_R, U, L], :-1]))
        width = np.where(high > low, high - low, 1.0)
        return np.clip((path[[C_U, C_L], :-1] - low) / width, 0.0, 1.0)

    def _solved(
        self, state: np.ndarray, mode: int, guess: np.ndarray
    ) -> tuple[np.ndarray | None, str]:
        """Return the corrections c_l and c_u that the solver finds, or None and why not."""
        scaled = (guess[[R, P_R, U, L]] - self.zero[:, None]) / self.units[:, None]
        memory = np.r_[float(mode), guess[MODE, :-1]]
        z = np.vstack([scaled, memory])
        shares = self._shares(guess)
        start = np.r_[z[:, 1:].ravel(order="F"), shares.ravel(order="F")]
        ends = np.sort(np.array([scaled[2:, 0], [0.0, 0.0]]), axis=0)
        low = np.full((5, self.horizon), -np.inf)
        high = np.full((5, self.horizon), np.inf)
        low[2:4], high[2:4] = ends[0][:, None] - 1e-6, ends[1][:, None] + 1e-6
        n = low.size
        rho = 1.0 / max(1.0, float(np.sum(scaled[2:] ** 2)))
        try:
            solution = self._solver(
                x0=start,
                p=np.r_[z[:, 0], guess[MODE, :-1], rho],
                lbx=np.r_[low.ravel(order="F"), np.zeros(shares.size)],
                ubx=np.r_[high.ravel(order="F"), np.ones(shares.size)],
                lbg=0.0,
                ubg=0.0,
            )
        except RuntimeError as error:
            return None, str(error).strip().splitlines()[-1][-200:]
        stats = self._solver.stats()
        if not stats["success"]:
            return None, str(stats.get("return_status", "no success"))
        found = np.asarray(solution["x"]).ravel()[:n].reshape(5, self.horizon, order="F")
        steps = np.diff(np.c_[z[2:4, 0], found[2:4]], axis=1) * self.c_b
        return (steps[::-1], "") if np.isfinite(steps).all() else (None, "not finite")


def _called(name: str, function: Callable, *arguments: Any) -> Any:
    """Call a user's function with symbols."""
    try:
        return function(*arguments)
    except Exception as error:
        reason = f"{type(error).__name__}: {str(error).strip()[-200:]}"
        raise ValueError(
            f"{name} could not be called with CasADi symbols ({reason}); use arithmetic and "
            "casadi functions, and casadi.if_else in place of if"
        ) from error
