"""
CasADi's Opti with IPOPT, as its documentation writes multiple shooting; the mode sequence and the
state are parameters.
"""

import casadi as ca
import numpy as np

from benchmarks.peers.correction_problem import after


def shooting(data):
    """
    Return a call that solves the problem for r, q, z_u, z_l, shape (4,), and a sequence of modes,
    shape (N,), and returns w; it is warm-started from the last solution.
    """
    c, horizon = data["constants"], data["horizon"]
    opti = ca.Opti()
    x, w = opti.variable(4, horizon + 1), opti.variable(2, horizon)
    start, modes = opti.parameter(4), opti.parameter(1, horizon)
    scale = opti.parameter()
    opti.subject_to(x[:, 0] == start)
    for k in range(horizon):
        to = after(c, *(x[i, k] for i in range(4)), w[0, k], w[1, k], modes[k], ca.exp, ca.log)
        opti.subject_to(x[:, k + 1] == ca.vertcat(*to))
    opti.subject_to(opti.bounded(0, w, 1))
    opti.minimize(scale * ca.sumsqr(x[2:, 1:]))
    opti.solver("ipopt", {"print_time": False, "expand": True}, {"print_level": 0, "sb": "yes"})
    last = []

    def solve(state, given):
        opti.set_value(start, state)
        opti.set_value(modes, given)
        opti.set_value(scale, 1.0 / max(1.0, float(np.max(state[2:] ** 2))))
        if last:
            opti.set_initial(last.pop())
        else:
            opti.set_initial(x, np.repeat(state[:, None], horizon + 1, axis=1))
            opti.set_initial(w, 0.5)
        solved = opti.solve()
        last.append(solved.value_variables())
        return np.asarray(solved.value(w))

    return solve
