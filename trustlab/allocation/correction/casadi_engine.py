"""
The general engine of the correction: nonlinear model predictive control with CasADi.

The hard switch (2.8) makes the program piecewise smooth: it is smooth within one mode sequence. The
engine moves from one sequence to the next and judges every plan by a run under the hard switch,
never by the cost that a solver reports.

1. The candidates are the last plan shifted by one step, the fastest way to the target, and holding
   the thresholds.
2. The program is solved for the mode sequence of the best candidate, its solution is run under
   (2.8), and so on until the sequence repeats. For (2.43) alone this ends at clipping, from any
   start: corrections depend on earlier modes only, so that each round gets at least one more switch
   right.
3. Where a switch within the horizon happens, or fails to, only because a threshold was moved,
   holding it back is tried; if that is cheaper, the program is solved with the thresholds confined
   to where (2.8) produces those modes.
4. With a positive `switch_width`, a program with a smoothed switch is solved as well; its mode
   sequence is then treated in the same way. Costs of r, P_r or the mode need it: for a given mode
   sequence these do not depend on the corrections.

The plan is a local optimum, to the solver's tolerance, among the corrections that produce its mode
sequence. That no other sequence is cheaper is not proved: `cost_lower_bound` is NaN. engine="exact"
proves it for (2.43).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from trustlab.allocation.correction.casadi_additions import Extras
from trustlab.allocation.correction.casadi_model import CorrectionModel, HardRun
from trustlab.allocation.correction.casadi_program import SOLVERS, CorrectionProgram
from trustlab.allocation.correction.dynamics import simulate_correction, suggestion_now
from trustlab.allocation.correction.incentive import incentive_box
from trustlab.allocation.correction.plan import CorrectionPlan, CorrectionStatus
from trustlab.models.checks import not_negative, one_of
from trustlab.models.tsc import TscModel

# Width of the smoothed switch where costs or constraints were added, in units of TSC: below the
# change of TSC in one step.
DEFAULT_WIDTH = 1e-3

# Most mode sequences followed, and most switches for which the other outcome is tried, per plan.
ROUNDS, TRIALS = 8, 4

# How far, in units of c_b, a threshold that is held back for a switch stays away from TSC.
MARGIN = 1e-6

# By how much an added constraint may be violated, relative to its change per unit of w or of a
# scaled state.
FEASIBLE = 1e-5


class Situation(NamedTuple):
    """
    Where a plan begins, where its thresholds may go, and why solvers failed.

    `state` is r, P_r, TSC_u, TSC_l and the mode before.
    """

    state: np.ndarray
    allowed: np.ndarray
    reasons: list[str]


class CasadiEngine:
    """
    Multiple shooting over the horizon; the head of this module says how mode sequences are found.

    Parameters
    ----------
    tsc : TscModel
        The model.
    target_lower, target_upper : float
        TSC_ld and TSC_ud.
    c_b : float
        Largest correction per step.
    horizon : int
        N, steps.
    incentive : callable
        The bounds of the corrections: `incentive_box`, or a function like it that accepts CasADi
        symbols.
    extra_cost : callable, optional
        extra_cost(x, u, k), a scalar added to (2.43) for k = 0 … N − 1, with x = [r, P_r, TSC_u,
        TSC_l] and u = [c_u, c_l] of step k as CasADi symbols; in the unit of (2.43), TSC².
    extra_constraints : callable, optional
        extra_constraints(x, u, k), one or several expressions, each held at or below 0 for k = 0 …
        N − 1.
    switch_width : float, optional
        Width of the smoothed switch in units of TSC; 0 omits it. When not given, 0 for (2.43) alone
        and DEFAULT_WIDTH with added costs or constraints.
    solver : str, optional
        "piqp" (default), "hpipm", "fatrop" or "ipopt". The smoothed program is solved by IPOPT if
        chosen, else by fatrop. Where a solver fails, fatrop is tried as well.

    Raises
    ------
    ValueError
        If an option is unknown or an added function cannot be used.
    """

    name = "casadi"
    options = ("extra_cost", "extra_constraints", "switch_width", "solver")

    def __init__(
        self,
        tsc: TscModel,
        target_lower: float,
        target_upper: float,
        c_b: float,
        horizon: int,
        incentive: Callable = incentive_box,
        extra_cost: Callable | None = None,
        extra_constraints: Callable | None = None,
        switch_width: float | None = None,
        solver: str | None = None,
    ):
        extras = Extras(extra_cost, extra_constraints, incentive)
        width = DEFAULT_WIDTH if extras.any else 0.0
        if switch_width is not None:
            width = not_negative("switch_width", switch_width)
        solver = one_of("solver", "piqp" if solver is None else solver, SOLVERS)
        self.horizon = horizon
        self._tsc = tsc
        self._target = (target_lower, target_upper)
        self._model = model = CorrectionModel(tsc, self._target, c_b, horizon, extras)
        # The second now, not when the first fails: setting it up takes longer than a sample of a
        # run that waits for a plan.
        self._programs = [
            CorrectionProgram(model, name) for name in dict.fromkeys((solver, "fatrop"))
        ]
        smooth = "ipopt" if solver == "ipopt" else "fatrop"
        self._smooth = CorrectionProgram(model, smooth, width) if width else None
        self._adds = extra_cost is not None
        self._extended = extras.any
        self._last: np.ndarray | None = None

    def reset(self) -> None:
        """Forget the last plan, which is a candidate for the next one."""
        self._last = None

    def decide(self, *state):
        """Return c_l, c_u, cost, its lower bound and status of the plan that `solve` returns."""
        plan = self.solve(*state)
        return plan.c_l, plan.c_u, plan.cost, plan.cost_lower_bound, plan.status

    def solve(self, r: float, p_r: float, lower: float, upper: float, mode: int) -> CorrectionPlan:
        """
        Return the plan from this state.

        Where no solver succeeds, the thresholds are held and the status says so.

        Parameters
        ----------
        r, p_r : float
            Utilization and robot performance now.
        lower, upper : float
            TSC_l and TSC_u now.
        mode : int
            Mode before now: 1 manual, 0 autonomous.
        """
        state = np.array([r, p_r, upper, lower, mode], dtype=float)
        now = Situation(state, self._model.allowed(upper, lower), [])
        best = self._search(now)
        message = "; ".join(dict.fromkeys(now.reasons))
        if best is not None:
            total = best.cost * self._model.c_b**2
            plan = self._plan(state, best.inputs, CorrectionStatus.CONVERGED, message, total)
            if self._repeats(plan, best):
                self._last = np.hstack([best.w[:, 1:], best.w[:, -1:]])
                return plan
            message = (
                "the compiled model does not reproduce the run that the corrections were found in"
            )
        self.reset()
        return self._plan(
            state, np.zeros((2, self.horizon)), CorrectionStatus.FAILED, message, math.nan
        )

    def _search(self, now: Situation) -> HardRun | None:
        """Return the best plan that a solver found, or None."""
        model = self._model
        guess = self._first(now)
        if not guess.sound:
            now.reasons.append(
                "the model or the added functions give values that are not finite, or incentives "
                "that exclude 0, at a predicted state"
            )
            return None
        free = now.allowed if self._extended else None
        settled: list[HardRun] = []
        candidate = guess
        for _ in range(ROUNDS):
            after = self._solved(guess, free, now)
            if after is None:
                if candidate is guess and not self._sound(guess):
                    return None
                break
            if self._sound(after):
                if np.array_equal(after.mode, guess.mode):
                    settled.append(after)
                    break
                candidate = min(candidate, after, key=self._rank)
            guess = after
        if self._smooth is not None:
            w, reason = self._smooth.solve(candidate, now.state[-1], now.allowed)
            if w is None:
                now.reasons.append(f"smoothed switch: {reason}")
            else:
                settled += self._settled(model.run(now.state, w, now.allowed), now)
        settled = settled or self._settled(candidate, now)
        if not settled:
            now.reasons.append("no mode sequence settled")
            return None
        return self._with_switches_held(min(settled, key=self._rank), now)

    def _first(self, now: Situation) -> HardRun:
        """Return the best candidate: the last plan, the fastest way to the target, or holding."""
        state = now.state
        straight = self._straight(now.state)
        runs = [self._model.run(state, straight, now.allowed)]
        if self._last is not None:
            runs.append(self._model.run(state, self._last, now.allowed))
        if self._extended:
            still = np.broadcast_to(state[2:4, None], now.allowed.shape)
            runs.append(self._model.run(state, straight, still))
        return min(runs, key=self._rank)

    def _straight(self, state) -> np.ndarray:
        return np.repeat(
            (self._model.zero[2:] > state[2:4]).astype(float)[:, None], self.horizon, axis=1
        )

    def _rank(self, run: HardRun) -> tuple[bool, float]:
        return not self._sound(run), run.cost

    def _sound(self, run: HardRun) -> bool:
        return run.sound and run.worst <= FEASIBLE

    def _solved(
        self, guess: HardRun, thresholds: np.ndarray | None, now: Situation
    ) -> HardRun | None:
        """
        Return the hard run of a solution for the modes of `guess`.

        The first solver that succeeds gives it.
        """
        for program in self._programs:
            w, reason = program.solve(guess, now.state[-1], thresholds)
            if w is not None:
                after = self._model.run(now.state, w, now.allowed)
                if not self._worse(after, guess):
                    return after
                reason = f"{program.solver}: its solution costs more than the guess it started from"
            now.reasons.append(reason)
        return None

    def _worse(self, after: HardRun, guess: HardRun) -> bool:
        """Return whether a solution costs more than an admissible guess with the same modes."""
        same = self._sound(guess) and self._sound(after) and np.array_equal(after.mode, guess.mode)
        return same and after.cost > guess.cost + 1e-6 * max(1.0, guess.size)

    def _settled(self, run: HardRun, now: Situation) -> list[HardRun]:
        """Return the best plan whose thresholds produce the modes of `run`, or nothing."""
        after = self._solved(run, self._cell(run, now.allowed), now) if run.sound else None
        settled = after is not None and self._sound(after) and np.array_equal(after.mode, run.mode)
        return [after] if settled else []

    def _cell(self, run: HardRun, allowed: np.ndarray) -> np.ndarray:
        """Return where thresholds may go so that (2.8) produces the modes of `run`."""
        cell = allowed.copy()
        margin = MARGIN * self._model.c_b
        mode = run.mode[1:]
        tsc = run.tsc[1:]
        row = _deciding(run)
        # In the manual mode the deciding threshold is above TSC, in the autonomous mode below it.
        k = np.flatnonzero(mode == 1.0)
        cell[0, row[k], k] = np.maximum(cell[0, row[k], k], tsc[k] + margin)
        k = np.flatnonzero(mode == 0.0)
        cell[1, row[k], k] = np.minimum(cell[1, row[k], k], tsc[k] - margin)
        return cell

    def _with_switches_held(self, best: HardRun, now: Situation) -> HardRun:
        """
        Return the best plan after trying to hold a threshold back where that changes a switch.
        """
        model = self._model
        state = now.state
        for _ in range(TRIALS):
            trial = best
            for k, row in self._moved_switches(best):
                cell = now.allowed.copy()
                margin = MARGIN * model.c_b
                # Up to step k the threshold stays on the side of TSC(k) on which it is now.
                if state[2 + row] < best.tsc[k]:
                    cell[1, row, :k] = np.minimum(cell[1, row, :k], best.tsc[k] - margin)
                else:
                    cell[0, row, :k] = np.maximum(cell[0, row, :k], best.tsc[k] + margin)
                run = model.run(state, best.w if self._extended else self._straight(state), cell)
                trial = min(trial, run, key=self._rank)
            settled = self._settled(trial, now) if trial is not best else []
            if not settled or settled[0].cost >= best.cost:
                return best
            best = settled[0]
        return best

    def _moved_switches(self, run: HardRun) -> list[tuple[int, int]]:
        """Return steps at which moved thresholds change what (2.8) decides, and which do."""
        row = _deciding(run)
        now = run.states[2 + row, 0]
        then = run.states[2 + row, np.arange(1, self.horizon)]
        tsc = run.tsc[1:]
        steps = np.flatnonzero((now < tsc) != (then < tsc))[:TRIALS]
        return [(int(k) + 1, int(row[k])) for k in steps]

    def _plan(self, state, inputs, status, message, total) -> CorrectionPlan:
        """Return the plan under the hard switch; `total` is its cost with additions."""
        r, p_r, upper, lower, mode = (float(value) for value in state)
        run = simulate_correction(
            self._tsc, r, p_r, lower, upper, int(mode), inputs[1], inputs[0], self._target
        )
        tsc = float(self._tsc.value(p_r, self._tsc.human.performance(r)))
        return CorrectionPlan(
            c_l=float(inputs[1, 0]),
            c_u=float(inputs[0, 0]),
            suggestion=suggestion_now(tsc, lower, upper),
            tsc=tsc,
            actions_l=inputs[1],
            actions_u=inputs[0],
            cost_lower_bound=math.nan,
            status=status,
            engine=self.name,
            message=message,
            added_cost=total - run["cost"] if self._adds else 0.0,
            **run,
        )

    def _repeats(self, plan: CorrectionPlan, run: HardRun) -> bool:
        """Return whether the compiled model repeats a run, so that (2.41) holds for it."""
        paths = np.stack([plan.r, plan.p_r, plan.upper, plan.lower])
        same = np.abs(paths - run.states) <= 1e-9 * self._model.units[:, None]
        return bool(same.all()) and np.array_equal(plan.mode, run.mode)


def _deciding(run: HardRun) -> np.ndarray:
    """
    Return which threshold decides at steps 1 … N − 1.

    It is TSC_u (0) after the manual mode and TSC_l (1) after the autonomous one.
    """
    return (run.mode[:-1] == 0.0).astype(int)
