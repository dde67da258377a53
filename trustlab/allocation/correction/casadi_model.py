"""The correction (2.43)-(2.44) in CasADi: one step of it, and runs under the hard rule (2.8)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.allocation.correction.casadi_additions import Additions, Extras
from trustlab.models.tsc import TscModel, next_performance, next_utilization, tsc_at

# Utilization below which (2.6) is taken as P_h,min; its second derivative is still finite there.
TINY = 1e-100


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
    """

    def __init__(
        self, tsc: TscModel, target: tuple[float, float], c_b: float, horizon: int, extras: Extras
    ):
        self.tsc = tsc
        self.target = target
        self.c_b = c_b
        self.horizon = horizon
        robot = tsc.robot
        self.units = np.array([1.0, robot.p_max - robot.p_min, c_b, c_b])
        self.zero = np.array([0.0, robot.p_min, target[1], target[0]])
        self.additions = Additions(extras, tsc, c_b, self.zero, self.units)
        rule = self._rule()
        self._over_horizon = rule if horizon == 1 else rule.mapaccum("rule_over_horizon", horizon)
        slopes = self.additions.cost_slopes
        self._slopes_over_horizon = slopes.map(horizon) if extras.cost is not None else None
        self._steps = np.arange(horizon, dtype=float)[None, :]

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
        falling = 1.0 - human.beta
        logarithm = human.beta * ca.log(rest / human.beta) + falling * ca.log(load / falling)
        bell = ca.if_else(ca.fmin(rest, load) > TINY, ca.exp(logarithm), 0.0)
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

        symbol = self.additions.symbol
        state = symbol.sym("state", 5)
        inputs = symbol.sym("inputs", 6)
        k = symbol.sym("k")
        x = state[:-1]
        before = state[-1]

        def mode_at(tsc):
            below = ca.if_else(tsc <= x[3], 1.0, before)
            return ca.if_else(tsc >= x[2], 0.0, below)

        r, p_r, mode, tsc = self.motion(x, mode_at)
        _, _, low, high = self.additions.at(x, ca.DM.zeros(2), k)
        # A threshold that is already outside its interval is held there, so that corrections stay
        # within (2.41).
        least = ca.fmin(inputs[2:4], x[2:])
        most = ca.fmax(inputs[4:6], x[2:])
        moved = ca.fmin(ca.fmax(x[2:] + low + inputs[:2] * (high - low), least), most)
        u = moved - x[2:]
        cost, rows, _, _ = self.additions.at(x, u, k)
        worst = ca.mmax(rows) if self.additions.constraints else symbol(-1.0)
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
        ends = np.array([[upper, lower], self.zero[2:]])
        intervals = np.stack([ends.min(axis=0), ends.max(axis=0)])
        return np.repeat(intervals[:, :, None], self.horizon, axis=2)

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
        wide = width > 0.0
        shares = np.where(wide, (corrections - low) / np.where(wide, width, 1.0), 0.0)
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
