"""
The joint fit the way CasADi's system-identification example goes about it
(docs/examples/python/sysid.py, single shooting).

One sample as a Function expanded to scalars, accumulated over all samples; parameters scaled to
order one; ½ eᵀe minimised by IPOPT with the Gauss–Newton matrix in place of the Hessian. Same
parameters and weights as scipy_fit.py.
"""

from __future__ import annotations

import numpy as np


class SingleShooting:
    """The expressions for one data set, which are constants of them, and a solver."""

    def __init__(self, mode, p_h, p_r, sd_h, sd_r, scale):
        import casadi as ca

        samples, self.scale = mode.size, np.array(scale, dtype=float)
        r = ca.MX.sym("r")
        robot = ca.MX.sym("p_r")
        m = ca.MX.sym("m")
        p = ca.MX.sym("p", 7)
        a_h, beta, h_min, h_max, a, p_min, p_max = ca.vertsplit(p)
        inside = ca.fmax(r, 1e-12)
        bell = ca.exp(beta * ca.log(inside / beta) + (1 - beta) * ca.log((1 - inside) / (1 - beta)))
        h = h_min + (h_max - h_min) * bell
        after = ca.vertcat(
            a_h * r + (1 - a_h) * m, a * robot + (1 - a) * (p_min + (p_max - p_min) * m * h / h_max)
        )
        one = ca.Function(
            "one_sample", [ca.vertcat(r, robot), m, p], [after, ca.vertcat(h, robot)]
        ).expand()
        everything = one.mapaccum("all_samples", samples)

        x = ca.MX.sym("x", 8)
        theta = x * ca.DM(self.scale)
        _, out = everything(
            ca.vertcat(0, theta[7]), ca.DM(mode).T, ca.repmat(theta[:7], 1, samples)
        )
        error = ca.vertcat((out[0, :].T - ca.DM(p_h)) / sd_h, (out[1, :].T - ca.DM(p_r)) / sd_r)
        by_x, sigma = ca.jacobian(error, x), ca.MX.sym("sigma")
        hessian = ca.Function(
            "nlp_hess_l",
            {"x": x, "lam_f": sigma, "hess_gamma_x_x": sigma * ca.triu(by_x.T @ by_x)},
            ["x", "p", "lam_f", "lam_g"],
            ["hess_gamma_x_x"],
        )
        quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}
        nlp = {"x": x, "f": 0.5 * ca.dot(error, error)}
        self.solver = ca.nlpsol("solver", "ipopt", nlp, {"hess_lag": hessian, **quiet})

    def solve(self, start):
        """Return the optimum."""
        end = self.solver(x0=np.asarray(start) / self.scale)
        if not self.solver.stats()["success"]:
            raise RuntimeError(self.solver.stats()["return_status"])
        return np.array(end["x"]).ravel() * self.scale
