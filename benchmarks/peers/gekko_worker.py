"""
GEKKO on the correction: every step written out, solved on this machine by the IPOPT that comes with
it.
"""

from correction_problem import Turns, after, constants
from serve import serve


def ways(data):
    import numpy as np
    from gekko import GEKKO

    c, horizon = constants(data), int(data["horizon"])

    def controller():
        m = GEKKO(remote=False)
        start = [m.Param(value=0.5) for _ in range(4)]
        modes, scale = [m.Param(value=0.0) for _ in range(horizon)], m.Param(value=1.0)
        x = [[m.Var(value=0.5) for _ in range(4)] for _ in range(horizon)]
        w = [[m.Var(value=0.5, lb=0.0, ub=1.0) for _ in range(2)] for _ in range(horizon)]
        for k in range(horizon):
            before = x[k - 1] if k else start
            to = after(c, *before, *w[k], modes[k], m.exp, m.log)
            m.Equations([x[k][i] == to[i] for i in range(4)])
            m.Minimize(scale * (x[k][2] ** 2 + x[k][3] ** 2))
        m.options.IMODE, m.options.SOLVER = 3, 3
        m.options.OTOL = m.options.RTOL = 1e-8

        def solve(state, sequence):
            for parameter, value in zip([*start, *modes], [*state, *sequence], strict=True):
                parameter.value = float(value)
            scale.value = 1.0 / max(1.0, float(np.max(state[2:] ** 2)))
            now = state
            for k in range(horizon):  # the model with inputs half-way: a feasible start
                now = after(c, *now, 0.5, 0.5, sequence[k], np.exp, np.log)
                for i in range(4):
                    x[k][i].value = float(now[i])
            m.solve(disp=False)
            if m.options.APPSTATUS != 1:
                raise RuntimeError(f"APPSTATUS {m.options.APPSTATUS}")
            return np.array([[step[j].value[0] for step in w] for j in range(2)])

        return solve

    return {
        name: Turns(data[f"{name}_states"], data[f"{name}_modes"], controller())
        for name in ("saturated", "near")
    }


serve("gekko", ways)
