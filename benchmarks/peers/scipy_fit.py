"""
The joint fit as one would write it by hand: SciPy's trust-region search with compiled forward
sensitivities.

Parameters, in this order: a, beta, p_min, p_max of (2.5)-(2.6), a, p_min, p_max of (2.3), P_r at
the first sample; utilization starts at 0. Residuals are divided by the noise's standard deviation
of each output.
"""

from __future__ import annotations

from math import exp, log

import numba
import numpy as np
from scipy.optimize import least_squares


@numba.njit(cache=True)
def residuals(x, mode, p_h, p_r, sd_h, sd_r, out, by_x):
    """
    Fill `out`, shape (2 N,), with the weighted residuals of p_h, then of p_r, and `by_x`, shape
    (8, 2 N), with their derivatives, a row per parameter.
    """
    a_h, beta, h_min, h_max, a, p_min, p_max, now = x
    n = mode.size
    span = h_max - h_min
    rise = p_max - p_min
    rest = 1.0 - a
    w_h = 1.0 / sd_h
    w_r = 1.0 / sd_r
    r = 0.0
    r_a = 0.0
    # dP_r by each parameter; the last is P_r's own start.
    d = np.zeros(8)
    d[7] = 1.0
    for k in range(n):
        m = mode[k]
        bell = by_a = by_beta = 0.0
        if r > 1e-12:
            log_r, log_q = log(r / beta), log((1.0 - r) / (1.0 - beta))
            bell = exp(beta * log_r + (1.0 - beta) * log_q)
            by_a = span * bell * (beta / r - (1.0 - beta) / (1.0 - r)) * r_a
            by_beta = span * bell * (log_r - log_q)
        h = h_min + span * bell
        out[k] = w_h * (h - p_h[k])
        out[n + k] = w_r * (now - p_r[k])
        by_h = (by_a, by_beta, 1.0 - bell, bell)
        into, share = rest * rise / h_max * m, m * h / h_max
        by_r = (
            into * by_a,
            into * by_beta,
            into * (1.0 - bell),
            into * (bell - h / h_max),
            now - p_min - rise * share,
            rest * (1.0 - share),
            rest * share,
            0.0,
        )
        for i in range(4):
            by_x[i, k] = w_h * by_h[i]
        for i in range(8):
            by_x[i, n + k] = w_r * d[i]
            d[i] = a * d[i] + by_r[i]
        now = a * now + rest * p_min + into * h
        r_a = a_h * r_a + r - m
        r = a_h * r + (1.0 - a_h) * m


def fit(start, mode, p_h, p_r, sd_h, sd_r):
    """Return the optimum; the covariance is computed, as a user needs it."""
    by_x = np.zeros((8, 2 * mode.size))

    def error(x):
        out = np.empty(2 * mode.size)
        residuals(x, mode, p_h, p_r, sd_h, sd_r, out, by_x)
        return out

    def slope(x):
        # SciPy asks for it where the last error was computed.
        return by_x.T

    end = least_squares(error, start, jac=slope, method="trf", x_scale="jac")
    np.linalg.inv(end.jac.T @ end.jac)
    return end.x
