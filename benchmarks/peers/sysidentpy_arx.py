"""
SysIdentPy's y(k) = c + a y(k−1) + b u(k−1), by FROLS, which its guide uses.

FROLS (without order selection) also ranks the three regressors.
"""


def ways(data):
    import warnings

    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    warnings.simplefilter("ignore")
    y, u = data["y"][:, None], data["u"][:, None]

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
        found = dict(zip(model.final_model[:, 0].tolist(), model.theta.ravel(), strict=True))
        return [found[code] for code in (0, 1001, 2001)]

    return {"frols": frols}
