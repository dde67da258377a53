"""
SIPPY's ARX: y(k) + a y(k−1) = b u(k−1), on data whose means were removed beforehand (it estimates
no constant).
"""

from serve import serve


def ways(data):
    from sippy_unipi import system_identification

    y, u = data["y"] - data["y"].mean(), data["u"] - data["u"].mean()

    def arx():
        model = system_identification(y, u, "ARX", ARX_orders=[1, 1, 0], tsample=0.1)
        return [model.DENOMINATOR[0][0][1], model.NUMERATOR[0][0][0]]

    return {"arx": arx}


serve("sippy_unipi", ways)
