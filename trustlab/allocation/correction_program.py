"""The nonlinear program of the correction (2.43)-(2.44) and the solvers for it."""

from __future__ import annotations

import numpy as np

from trustlab.allocation.correction_shooting import Rolled, Shooting

__all__ = ["SOLVERS", "CorrectionProgram"]

SOLVERS = ("piqp", "hpipm", "fatrop", "ipopt")
"""Solvers by name: sequential quadratic programming on PIQP or HPIPM, or the interior-point methods fatrop and IPOPT."""

TOLERANCE = 1e-8
QUIET = {"print_time": False, "error_on_fail": False}
QUIET_SQP = {"print_header": False, "print_iteration": False, "print_status": False}

SLACK = 1e-6
"""How far, in units of c_b, thresholds may stray in the program from where they may go; the hard rule then cuts them there."""


class CorrectionProgram:
    """
    Multiple shooting over the horizon: the states at every step are unknowns, the model (2.44) holds between them.

    With `width` 0 the modes are given, one per step; r and P_r then follow from them whatever the corrections, and the
    solution is exact for that sequence of modes. With a positive width the mode is a fifth state m in [0, 1], the memory
    of (2.8): m(k) = (1 − σ((TSC − TSC_u)/width)) (d + (1 − d) m(k − 1)) with d = σ((TSC_l − TSC)/width) and
    σ(y) = 1/(1 + exp(−y)). Several widths inside the thresholds both σ vanish and m stays as it was; four widths beyond one
    of them, 98 % of the switch happen in one step. Where TSC turns back less than that beyond a threshold, m stays between 0
    and 1: the smoothed program is a guess of the modes, and never what a plan is judged by.

    Parameters
    ----------
    shooting : Shooting
        Model, target and what a user adds.
    solver : str
        One of SOLVERS.
    width : float
        Width of the switch, in units of TSC; 0 takes the modes as given.
    """

    def __init__(self, shooting: Shooting, solver: str, width: float = 0.0):
        import casadi as ca

        self.shooting, self.solver, self.width = shooting, solver, width
        self.plain = not shooting.extras.any and not width
        self.size = size = 5 if width else 4
        n, symbol, stage = shooting.horizon, shooting.symbol, self._stage()
        start, modes, rho = symbol.sym("start", size), symbol.sym("modes", n), symbol.sym("rho")
        now = symbol.sym("x_0", size)
        unknowns, rows, equal, cost = [now], [], [], 0
        begins = now - start
        for k in range(n):
            w, after = symbol.sym(f"w_{k}", 2), symbol.sym(f"x_{k + 1}", size)
            to, price, held = stage(now, w, modes[k], k)
            unknowns += [w, after]
            rows.append(after - to)
            equal += [True] * size
            if k == 0:
                rows.append(begins)
                equal += [True] * size
            rows.append(held)
            equal += [False] * held.numel()
            cost += rho * (price + after[2] ** 2 + after[3] ** 2)
            now = after
        program = {
            "x": ca.vertcat(*unknowns),
            "p": ca.vertcat(start, modes, rho),
            "f": cost,
            "g": ca.vertcat(*rows),
        }
        method = solver if solver in ("fatrop", "ipopt") else "sqpmethod"
        self._solver = ca.nlpsol(
            "correction", method, program, _options(solver, equal, self.plain, 60 if width else 100)
        )
        self._least_rows = np.where(equal, 0.0, -np.inf)
        first = size + (size + 2) * np.arange(n)
        self._at_w = first[None, :] + np.arange(2)[:, None]
        states = first[None, :] + 2 + np.arange(size)[:, None]
        self._at_x = np.hstack([np.arange(size)[:, None], states])
        self._least, self._most = (
            np.full(self._at_x.size + self._at_w.size, end) for end in (-np.inf, np.inf)
        )
        self._least[self._at_w], self._most[self._at_w] = 0.0, 1.0

    def _stage(self):
        """Return (scaled state, w, mode, k) → (scaled state after, added cost over c_b², constraints)."""
        import casadi as ca

        shooting, symbol = self.shooting, self.shooting.symbol
        tsc, robot, human, c_b = shooting.tsc, shooting.tsc.robot, shooting.tsc.human, shooting.c_b
        z, w = symbol.sym("z", self.size), symbol.sym("w", 2)
        mode, k = symbol.sym("mode"), symbol.sym("k")
        x = shooting.physical(z[:4])
        p_h = shooting.performance(z[0])
        manual = mode
        if self.width:
            level = tsc.a_T * x[1] - tsc.b_T * p_h
            up, down = _sigmoid((level - x[2]) / self.width), _sigmoid((x[3] - level) / self.width)
            manual = (1.0 - up) * (down + (1.0 - down) * z[4])
        _, _, low, high = shooting.added(x, ca.DM.zeros(2), k)
        u = low + w * (high - low)
        cost, rows, _, _ = shooting.added(x, u, k)
        thresholds = z[2:4] + u / c_b
        if shooting.extras.any:  # thresholds do not cross; (2.43) alone never makes them
            apart = (shooting.target[1] - shooting.target[0]) / c_b
            rows = ca.vertcat(rows, (thresholds[1] - thresholds[0] - apart + 1e-3) / apart)
        gain = robot.b / (robot.p_max - robot.p_min)
        after = [human.a * z[0] + human.b * manual, robot.a * z[1] + manual * gain * p_h, thresholds]
        after = ca.vertcat(*after, manual) if self.width else ca.vertcat(*after)
        return ca.Function("stage", [z, w, mode, k], [after, cost, rows])

    def solve(
        self, guess: Rolled, mode: int, thresholds: np.ndarray | None = None
    ) -> tuple[np.ndarray | None, str]:
        """
        Solve from a guess; return the corrections as shares of what (2.41) allows, or None and why there are none.

        Parameters
        ----------
        guess : Rolled
            Where to start from. Its modes are the ones given to the program.
        mode : int
            Mode before the first step.
        thresholds : numpy.ndarray, shape (2, 2, N), optional
            Least, then greatest TSC_u and TSC_l after each step; free when not given.

        Returns
        -------
        w : numpy.ndarray, shape (2, N), or None
        reason : str
        """
        shooting = self.shooting
        start = np.empty(self._least.size)
        start[self._at_x[:4]] = (guess.states - shooting.zero[:, None]) / shooting.units[:, None]
        start[self._at_w] = guess.w
        if self.width:
            start[self._at_x[4]] = np.r_[float(mode), guess.mode]
        least, most = self._least, self._most
        if thresholds is not None:
            least, most = least.copy(), most.copy()
            z = (thresholds - shooting.zero[None, 2:, None]) / shooting.c_b
            least[self._at_x[2:4, 1:]], most[self._at_x[2:4, 1:]] = z[0] - SLACK, z[1] + SLACK
        given = np.concatenate([start[self._at_x[:, 0]], guess.mode, [1.0 / shooting.steepness(guess)]])
        try:
            # No multipliers to start from: sqpmethod does not look at complementarity, and would stop at a guess with old ones.
            found = self._solver(x0=start, p=given, lbx=least, ubx=most, lbg=self._least_rows, ubg=0.0)
            stats = self._solver.stats()
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1][-200:]
            if (
                "basic_string" in reason
            ):  # how CasADi passes on that a quadratic program ended without a status
                reason = "a quadratic program within it has no solution"
            return None, f"{self.solver}: {reason}"
        x = np.asarray(found["x"]).ravel()
        if not stats["success"]:
            return None, f"{self.solver}: {stats.get('return_status', 'no success')}"
        if not np.isfinite(x).all():
            return None, f"{self.solver}: its solution is not finite"
        return np.clip(x[self._at_w], 0.0, 1.0), ""


def _sigmoid(y):
    import casadi as ca

    return 0.5 * (1.0 + ca.tanh(0.5 * y))


def _options(solver: str, equal: list[bool], plain: bool, most: int) -> dict:
    """Return a solver's options: silence, tolerance, and what the structure of the program allows."""
    if solver == "fatrop":
        options = {"print_level": 0, "tol": TOLERANCE, "max_iter": most}
        return QUIET | {"structure_detection": "auto", "equality": equal, "fatrop": options}
    if solver == "ipopt":
        return QUIET | {
            "ipopt": {"print_level": 0, "sb": "yes", "tol": TOLERANCE, "max_iter": most, "max_wall_time": 2.0}
        }
    inner = {"error_on_fail": False, "print_time": False}
    inner |= (
        {"hpipm.mode": "robust", "hpipm.iter_max": 60} if solver == "hpipm" else {"piqp": {"max_iter": 60}}
    )
    options = QUIET | QUIET_SQP | {"qpsol": solver, "qpsol_options": inner, "max_iter": 15}
    # For given modes (2.43) is one convex quadratic program: full steps, where a line search would stall on rounding.
    return options | ({"max_iter_ls": 0} if plain else {"convexify_strategy": "eigen-clip"})
