"""
CasADi's Opti with IPOPT, as its documentation writes multiple shooting; the mode sequence and the
state are parameters.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.peers.correction_problem import after, constants


class OptiShooting:
    """
    The problem, built once.

    Parameters
    ----------
    data : mapping of str to numpy.ndarray
        Key `constants`, see `correction_problem.constants`.
    horizon : int
        N.
    """

    def __init__(self, data, horizon):
        c = constants(data)
        opti = self.opti = ca.Opti()
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
        self.x = x
        self.w = w
        self.start = start
        self.modes = modes
        self.scale = scale
        self.last = None

    def solve(self, state, modes):
        """
        Return w, warm-started from the last solution.

        Parameters
        ----------
        state : numpy.ndarray, shape (4,)
            r, q, z_u, z_l.
        modes : numpy.ndarray, shape (N,)
            The sequence of modes.
        """
        opti = self.opti
        opti.set_value(self.start, state)
        opti.set_value(self.modes, modes)
        opti.set_value(self.scale, 1.0 / max(1.0, float(np.max(state[2:] ** 2))))
        if self.last is None:
            opti.set_initial(self.x, np.repeat(state[:, None], modes.size + 1, axis=1))
            opti.set_initial(self.w, 0.5)
        else:
            opti.set_initial(self.last)
        found = opti.solve()
        self.last = found.value_variables()
        return np.asarray(found.value(self.w))
