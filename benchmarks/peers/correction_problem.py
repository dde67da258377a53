"""
The correction (2.43)-(2.44) for one given sequence of modes, scaled as every peer gets it: w =
c/c_b + s lies in [0, 1].
"""

from __future__ import annotations

import itertools


def after(c, r, q, z_u, z_l, w_u, w_l, mode, exp, log):
    """
    Return the next r, scaled P_r and scaled thresholds, whatever r, q … are: numbers or symbols of
    a peer.

    Parameters
    ----------
    c : dict of str to float
        The constants a_r, beta, h_min, h_max, a_pr, b_pr, p_min, p_max of (2.3)-(2.6).
    r, q : object
        Utilization, and robot performance as a share of its range.
    z_u, z_l : object
        (TSC − target)/c_b of both thresholds.
    w_u, w_l : object
        Corrections, in [0, 1].
    mode : object
        1 manual, 0 autonomous.
    exp, log : callable
        The peer's.
    """
    bell = exp(c["beta"] * log(r / c["beta"]) + (1 - c["beta"]) * log((1 - r) / (1 - c["beta"])))
    p_h = c["h_min"] + (c["h_max"] - c["h_min"]) * bell
    share = 0.5 * (r + q)
    return (
        c["a_r"] * r + (1 - c["a_r"]) * mode,
        c["a_pr"] * q + mode * c["b_pr"] / (c["p_max"] - c["p_min"]) * p_h,
        z_u + w_u - share,
        z_l + w_l - share,
    )


def in_turns(data, name, solve):
    """
    Return a call that solves one state after the other, in the order of the closed loop.

    Parameters
    ----------
    data : mapping of str to numpy.ndarray
        Keys `<name>_states`, shape (steps, 4), r, q, z_u, z_l at each step, and `<name>_modes`,
        shape (steps, N), the sequence of modes.
    name : str
        The loop.
    solve : callable
        Takes both at one step and returns w of the whole horizon, shape (2, N).
    """
    steps = itertools.cycle(zip(data[f"{name}_states"], data[f"{name}_modes"], strict=True))
    return lambda: solve(*next(steps)).ravel()
