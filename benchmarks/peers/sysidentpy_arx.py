"""
SysIdentPy's y(k) = c + a y(k−1) + b u(k−1), in its two ways: FROLS, which its guide uses, and a
given structure.

FROLS (without order selection) also ranks the three regressors. SimulateNARMAX with
estimate_parameter=True is its way to fit a structure that is known; it must simulate something as
well, so it gets three samples.
"""


def ways(data):
    import warnings

    import numpy as np
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares
    from sysidentpy.simulation import SimulateNARMAX

    warnings.simplefilter("ignore")
    y, u = data["y"][:, None], data["u"][:, None]
    structure = np.array([[0], [1001], [2001]])

    def frols():
        model = FROLS(
            order_selection=False,
            n_terms=3,
            ylag=1,
            xlag=1,
            basis_function=Polynomial(degree=1),
            estimator=LeastSquares(),
        )
        model.fit(X=u, y=y)
        found = dict(
            zip(model.final_model[:, 0].tolist(), model.theta.ravel().tolist(), strict=True)
        )
        return [found[code] for code in structure[:, 0].tolist()]

    def known_structure():
        fit = SimulateNARMAX(
            basis_function=Polynomial(degree=1), estimator=LeastSquares(), estimate_parameter=True
        )
        fit.simulate(
            X_train=u, y_train=y, X_test=u[:3], y_test=y[:3], model_code=structure, steps_ahead=1
        )
        return fit.theta.ravel()

    return {"frols": frols, "known structure": known_structure}
