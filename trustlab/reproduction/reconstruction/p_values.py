"""
Logarithms of p-values of t and F, and their slopes, in a fixed order of operations.

The search for moments accepts and refuses steps by these numbers. SciPy's would do, but they go
through a library's `exp` and `log`, whose last bits differ between machines, and with them the data
that are found. The incomplete beta function is Lentz's continued fraction (DLMF 8.17.22).
"""

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.portable import exponential, log_gamma, logarithm

# Factors of the continued fraction; it ends when one more changes nothing, which takes some
# √(a + b) of them.
FACTORS = 10_000
TINY = 1e-300
LOG_TINY = -690.7755278982137  # ln(1e-300), below which a p is not told apart
STEP = 1e-6  # of the central difference by ε


@njit
def log_beta(a, b):
    """Return ln B(a, b)."""
    return log_gamma(a) + log_gamma(b) - log_gamma(a + b)


@njit
def _fraction(x, a, b):
    """Return the continued fraction of I_x(a, b), for x < (a + 1)/(a + b + 2)."""
    c = 1.0
    d = 1.0 - (a + b) * x / (a + 1.0)
    d = 1.0 / (d if abs(d) > TINY else TINY)
    value = d
    for m in range(1, FACTORS):
        for odd in range(2):
            if odd:
                numerator = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0))
            else:
                numerator = m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m))
            d = 1.0 + numerator * d
            d = 1.0 / (d if abs(d) > TINY else TINY)
            c = 1.0 + numerator / c
            c = c if abs(c) > TINY else TINY
            value *= c * d
        if abs(c * d - 1.0) < 1e-16:
            break
    return value


@njit
def log_incomplete_beta(x, y, a, b):
    """Return ln I_x(a, b), where y = 1 − x, at least ln 1e-300."""
    if x <= 0.0:
        return LOG_TINY
    if y <= 0.0:
        return 0.0
    outside = a * logarithm(x) + b * logarithm(y) - log_beta(a, b)
    if x < (a + 1.0) / (a + b + 2.0):
        return max(outside + logarithm(_fraction(x, a, b) / a), LOG_TINY)
    return max(logarithm(1.0 - exponential(outside) * _fraction(y, b, a) / b), LOG_TINY)


@njit
def log_p_of_t(t, df):
    """Return ln p, two-sided, of values of t, and its slopes by t; shapes of t."""
    log_p = np.empty_like(t)
    slope = np.empty_like(t)
    constant = -log_beta(0.5 * df, 0.5) - 0.5 * logarithm(df)
    for i in range(t.size):
        square = t.flat[i] * t.flat[i]
        log_p.flat[i] = log_incomplete_beta(
            df / (df + square), square / (df + square), 0.5 * df, 0.5
        )
        log_density = constant - 0.5 * (df + 1.0) * logarithm(1.0 + square / df)
        steepness = 2.0 * exponential(log_density - log_p.flat[i])
        slope.flat[i] = -steepness if t.flat[i] > 0.0 else steepness if t.flat[i] < 0.0 else 0.0
    return log_p, slope


@njit
def _log_p_of_f(f, df1, df2):
    total = df2 + df1 * f
    return log_incomplete_beta(df2 / total, df1 * f / total, 0.5 * df2, 0.5 * df1)


@njit
def log_p_of_f(f, epsilon, k, n, corrected):
    """
    Return ln p of F of k conditions and n subjects, and its slopes by F and by ε, shapes (B,).

    `corrected`: the degrees of freedom are multiplied by ε, at most 1.
    """
    log_p = np.empty_like(f)
    by_f = np.empty_like(f)
    by_epsilon = np.zeros_like(f)
    for i in range(f.size):
        share = min(epsilon[i], 1.0) if corrected else 1.0
        df1 = share * (k - 1)
        df2 = df1 * (n - 1)
        value = max(f[i], 0.0)
        log_p[i] = _log_p_of_f(value, df1, df2)
        total = df2 + df1 * value
        log_density = (
            0.5 * df1 * logarithm(df1 / total)
            + 0.5 * df2 * logarithm(df2 / total)
            + (0.5 * df1 - 1.0) * logarithm(max(value, TINY))
            - log_beta(0.5 * df1, 0.5 * df2)
        )
        by_f[i] = -exponential(log_density - log_p[i])
        if corrected:
            ends = np.empty(2)
            for end in range(2):
                moved = min(epsilon[i] + (STEP if end else -STEP), 1.0)
                ends[end] = _log_p_of_f(value, moved * (k - 1), moved * (k - 1) * (n - 1))
            by_epsilon[i] = (ends[1] - ends[0]) / (2.0 * STEP)
    return log_p, by_f, by_epsilon


@njit
def logarithms(x):
    """Return natural logarithms of an array's entries."""
    out = np.empty_like(x)
    for i in range(x.size):
        out.flat[i] = logarithm(x.flat[i])
    return out


@njit
def exponentials(x):
    """Return e to the powers of an array's entries."""
    out = np.empty_like(x)
    for i in range(x.size):
        out.flat[i] = exponential(x.flat[i])
    return out
