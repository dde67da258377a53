"""
do-mpc on the correction: a discrete model, the mode as a time-varying parameter, IPOPT as it comes.
"""

import warnings

from correction_problem import after, in_turns


def ways(data):
    warnings.simplefilter("ignore")
    import casadi as ca
    import do_mpc
    import numpy as np

    c, horizon = data["constants"], data["horizon"]

    def controller():
        model = do_mpc.model.Model("discrete", "SX")
        x = [model.set_variable("_x", name) for name in ("r", "q", "z_u", "z_l")]
        w = [model.set_variable("_u", name) for name in ("w_u", "w_l")]
        mode, scale = model.set_variable("_tvp", "mode"), model.set_variable("_tvp", "scale")
        to = after(c, *x, *w, mode, ca.exp, ca.log)
        for name, value in zip(("r", "q", "z_u", "z_l"), to, strict=True):
            model.set_rhs(name, value)
        model.setup()
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon = horizon
        mpc.settings.t_step = 0.1
        mpc.settings.store_full_solution = False
        mpc.settings.nlpsol_opts = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0}
        cost = scale * (x[2] ** 2 + x[3] ** 2)
        mpc.set_objective(mterm=cost, lterm=cost)
        for name in ("w_u", "w_l"):
            mpc.bounds["lower", "_u", name], mpc.bounds["upper", "_u", name] = 0.0, 1.0
        template, now = mpc.get_tvp_template(), {"modes": np.zeros(horizon), "scale": 1.0}

        def ahead(_):
            template["_tvp", :, "mode"] = [*now["modes"], 0.0]
            template["_tvp", :, "scale"] = [now["scale"]] * (horizon + 1)
            return template

        mpc.set_tvp_fun(ahead)
        mpc.setup()
        first = [True]

        def solve(state, modes):
            now["modes"], now["scale"] = modes, 1.0 / max(1.0, float(np.max(state[2:] ** 2)))
            if first[0]:
                mpc.x0 = state
                mpc.set_initial_guess()
                first[0] = False
            mpc.make_step(state[:, None])
            if not mpc.solver_stats["success"]:
                raise RuntimeError(mpc.solver_stats["return_status"])
            return ca.horzcat(*mpc.opt_x_num["_u", :, 0]).full()

        return solve

    return {name: in_turns(data, name, controller()) for name in ("far", "near")}
