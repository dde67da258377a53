"""
Formulas as text, evaluated on arrays: arithmetic, a few functions, and names of numbers.

A name that stands for several numbers, x for x_1, x_2 …, is their stack along a new first axis.
"""

import ast
import operator
from collections.abc import Callable, Mapping
from functools import cache, partial, reduce
from typing import Any

import numpy as np
from scipy import stats

from trustlab.reproduction.audit.equations import BY_NAME
from trustlab.studies.anova import mauchly_factor, mauchly_p_value

OPERATORS: dict[type, Callable] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
}


def _extreme(ufunc: np.ufunc, *values: Any) -> np.ndarray:
    """Return the least or greatest of several arrays, or along the first axis of one."""
    return reduce(ufunc, values) if len(values) > 1 else ufunc.reduce(values[0])


def chi2_of_epsilon(epsilon: np.ndarray, n: np.ndarray, k: int, greatest: bool) -> np.ndarray:
    """
    Return the least or greatest χ² of Mauchly that an ε of Greenhouse and Geisser leaves.

    W = ∏λ/(mean λ)^p and ε = (Σλ)²/(p Σλ²) of the same p = k − 1 eigenvalues; at given ε, W is
    extreme where all but one eigenvalue are equal, or one is 0.
    """
    p = k - 1
    # Eigenvalues of mean 1: one is 1 ± spread, the others share the rest, which gives Σλ² = p/ε.
    spread = np.sqrt(np.maximum(p / np.minimum(epsilon, 1.0) - p, 0.0) * (p - 1.0) / p)
    single = 1.0 - spread if greatest else 1.0 + spread
    equal = (p - single) / (p - 1.0)
    with np.errstate(all="ignore"):
        w = np.where((single > 0.0) & (equal > 0.0), single * equal ** (p - 1.0), 0.0)
        return -mauchly_factor(n, k) * np.log(w)


def f_of_moments(means: np.ndarray, sds: np.ndarray, n: np.ndarray, greatest: bool) -> np.ndarray:
    """Return F at an average correlation of −1/(k − 1), the least, or 1, the greatest."""
    k = len(means)
    variance = (sds**2).mean(axis=0)
    covariance = (sds.sum(axis=0) ** 2 - (sds**2).sum(axis=0)) / (k * (k - 1.0))
    error = variance - covariance if greatest else variance * k / (k - 1.0)
    return n * means.var(axis=0, ddof=1) / error


def t_of_moments(means: np.ndarray, sds: np.ndarray, n: np.ndarray, correlation: int) -> np.ndarray:
    """Return the size of a paired t at a correlation of 1 (the greatest) or −1 (the least)."""
    sd = np.abs(sds[0] - correlation * sds[1])
    return np.abs(means[0] - means[1]) * np.sqrt(n) / np.maximum(sd, 1e-12)


def p_of_t(t: np.ndarray, n: np.ndarray, times: float) -> np.ndarray:
    """Return a two-sided p times a number of comparisons, at most 1."""
    return np.minimum(times * 2.0 * stats.t.sf(t, n - 1.0), 1.0)


FUNCTIONS: dict[str, Callable] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "min": partial(_extreme, np.minimum),
    "max": partial(_extreme, np.maximum),
    "count": len,
    "rank": lambda x, family: 1.0 + (family > x).sum(axis=0),
    "mean": partial(np.mean, axis=0),
    "variance": partial(np.var, axis=0, ddof=1),
    "sd": partial(np.std, axis=0, ddof=1),
    "sd_of_all": partial(np.std, axis=0),
    "f_tail": lambda f, df1, df2: stats.f.sf(f, df1, df2),
    "t_tail": lambda t, df: stats.t.sf(t, df),
    "chi2_tail": lambda chi2, df: stats.chi2.sf(chi2, df),
    "mauchly_p": mauchly_p_value,
    "least_chi2": partial(chi2_of_epsilon, greatest=False),
    "greatest_chi2": partial(chi2_of_epsilon, greatest=True),
    "least_f": partial(f_of_moments, greatest=False),
    "greatest_f": partial(f_of_moments, greatest=True),
    "least_t": partial(t_of_moments, correlation=-1),
    "greatest_t": partial(t_of_moments, correlation=1),
    "p_of_t": p_of_t,
    **BY_NAME,
}


def evaluate(expression: str, values: Mapping[str, np.ndarray]) -> Any:
    """
    Return the value of an expression; names are those of values.

    Raises
    ------
    ValueError
        If the expression is more than arithmetic with names and FUNCTIONS.
    """
    return _value(_parsed(expression), values)


@cache
def _parsed(expression: str) -> ast.expr:
    return ast.parse(expression, mode="eval").body


def _value(node: ast.expr, values: Mapping[str, np.ndarray]) -> Any:
    match node:
        case ast.Constant(value=int() | float() as number):
            return number
        case ast.Name(id=name) if name in values:
            return values[name]
        case ast.Name(id=name):
            return np.stack([x for symbol, x in values.items() if symbol.startswith(f"{name}_")])
        case ast.UnaryOp(op=sign, operand=operand):
            return OPERATORS[type(sign)](_value(operand, values))
        case ast.BinOp(left=left, op=sign, right=right):
            return OPERATORS[type(sign)](_value(left, values), _value(right, values))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](*(_value(argument, values) for argument in arguments))
    raise ValueError(f"no arithmetic of printed numbers: {ast.unparse(node)}")
