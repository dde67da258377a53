"""The correction as a nonlinear program: multiple shooting, for any of four solvers."""

from typing import Any

import numpy as np

from trustlab.allocation.correction.casadi_model import CorrectionModel, HardRun

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
        symbol = model.additions.symbol
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
        convex = not model.additions.extras.any and not width
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
        symbol = model.additions.symbol
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
        _, _, low, high = model.additions.at(x, ca.DM.zeros(2), k)
        u = low + w * (high - low)
        cost, rows, _, _ = model.additions.at(x, u, k)
        thresholds = z[2:4] + u / c_b
        if model.additions.extras.any:  # thresholds must not cross; with (2.43) alone they never do
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
