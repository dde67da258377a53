"""Compiled simulations of (2.3), (2.5) and (2.6) with their derivatives by every parameter."""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["EDGE", "human_sensitivities", "input_influence", "joint_sensitivities", "robot_sensitivities"]

EDGE = 1e-9
"""(2.6) has an infinite slope at r = 0 and r = 1; its slope is taken this far inside."""


@numba.njit(cache=True, inline="always")
def _shape(r, beta):
    """Return the Yerkes–Dodson shape of (2.6) and its derivatives by r and β."""
    if r <= 0.0 or r >= 1.0:
        shape, by_beta = 0.0, 0.0
    else:
        log_r, log_q = np.log(r / beta), np.log((1.0 - r) / (1.0 - beta))
        shape = np.exp(beta * log_r + (1.0 - beta) * log_q)
        by_beta = shape * (log_r - log_q)
        if EDGE < r < 1.0 - EDGE:
            return shape, shape * (beta / r - (1.0 - beta) / (1.0 - r)), by_beta
    inside = min(max(r, EDGE), 1.0 - EDGE)
    steep = np.exp(beta * np.log(inside / beta) + (1.0 - beta) * np.log((1.0 - inside) / (1.0 - beta)))
    return shape, steep * (beta / inside - (1.0 - beta) / (1.0 - inside)), by_beta


@numba.njit(cache=True)
def human_sensitivities(mode, a, beta, p_min, p_max, r0, p_h, jacobian):
    """
    Simulate (2.5)-(2.6) and differentiate by a, beta, p_min, p_max, r0.

    Parameters
    ----------
    mode : numpy.ndarray, shape (N,)
        Manual share.
    a, beta, p_min, p_max, r0 : float
        Parameters of the human model and utilization at the first sample.
    p_h : numpy.ndarray, shape (N,)
        Filled with human performance.
    jacobian : numpy.ndarray, shape (N, 5)
        Filled with its derivatives.
    """
    r, r_a, r_0 = r0, 0.0, 1.0
    span = p_max - p_min
    for k in range(mode.size):
        shape, slope, by_beta = _shape(r, beta)
        p_h[k] = p_min + span * shape
        jacobian[k, 0] = span * slope * r_a
        jacobian[k, 1] = span * by_beta
        jacobian[k, 2] = 1.0 - shape
        jacobian[k, 3] = shape
        jacobian[k, 4] = span * slope * r_0
        r_a = a * r_a + r - mode[k]
        r_0 = a * r_0
        r = a * r + (1.0 - a) * mode[k]


@numba.njit(cache=True)
def robot_sensitivities(mode, p_h, a, p_min, p_max, p_h_max, p_r0, p_r, jacobian):
    """
    Simulate (2.3) under a given human performance and differentiate by a, p_min, p_max, p_r0.

    Parameters
    ----------
    mode, p_h : numpy.ndarray, shape (N,)
        Manual share and human performance.
    a, p_min, p_max, p_h_max, p_r0 : float
        Parameters of the robot model and robot performance at the first sample.
    p_r : numpy.ndarray, shape (N,)
        Filled with robot performance.
    jacobian : numpy.ndarray, shape (N, 4)
        Filled with its derivatives.
    """
    now, by_a, by_min, by_max, by_0 = p_r0, 0.0, 0.0, 0.0, 1.0
    gain = (p_max - p_min) / p_h_max
    rest = 1.0 - a
    for k in range(mode.size):
        p_r[k] = now
        jacobian[k, 0] = by_a
        jacobian[k, 1] = by_min
        jacobian[k, 2] = by_max
        jacobian[k, 3] = by_0
        drive = mode[k] * p_h[k]
        share = drive / p_h_max
        by_a = a * by_a + now - p_min - gain * drive
        by_min = a * by_min + rest * (1.0 - share)
        by_max = a * by_max + rest * share
        by_0 = a * by_0
        now = a * now + rest * (p_min + gain * drive)


@numba.njit(cache=True)
def joint_sensitivities(mode, human, robot, r0, p_r0, p_h, p_r, by_human, by_robot):
    """
    Simulate (2.3), (2.5) and (2.6) together, the robot driven by the simulated operator, and differentiate.

    Parameters
    ----------
    mode : numpy.ndarray, shape (N,)
        Manual share.
    human : numpy.ndarray, shape (4,)
        a, beta, p_min, p_max of the human model.
    robot : numpy.ndarray, shape (3,)
        a, p_min, p_max of the robot model; its p_h_max is the human's p_max.
    r0, p_r0 : float
        Utilization and robot performance at the first sample.
    p_h, p_r : numpy.ndarray, shape (N,)
        Filled with the performances.
    by_human : numpy.ndarray, shape (N, 5)
        Filled with the derivatives of p_h by human[0..3], r0.
    by_robot : numpy.ndarray, shape (N, 9)
        Filled with the derivatives of p_r by human[0..3], robot[0..2], r0, p_r0.
    """
    a_h, beta, h_min, h_max = human
    a, p_min, p_max = robot
    span, gain, rest = h_max - h_min, (p_max - p_min) / h_max, 1.0 - a
    r, r_a, r_0, now, by_0 = r0, 0.0, 1.0, p_r0, 1.0
    s_a, s_beta, s_hmin, s_hmax, s_ra, s_rmin, s_rmax, s_r0 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(mode.size):
        shape, slope, by_beta = _shape(r, beta)
        m = mode[k]
        h = h_min + span * shape
        h_a, h_beta, h_r0 = span * slope * r_a, span * by_beta, span * slope * r_0
        p_h[k], p_r[k] = h, now
        row = by_human[k]
        row[0], row[1], row[2], row[3], row[4] = h_a, h_beta, 1.0 - shape, shape, h_r0
        row = by_robot[k]
        row[0], row[1], row[2], row[3] = s_a, s_beta, s_hmin, s_hmax
        row[4], row[5], row[6], row[7], row[8] = s_ra, s_rmin, s_rmax, s_r0, by_0
        drive = m * h
        share = drive / h_max
        into = rest * gain * m
        s_a = a * s_a + into * h_a
        s_beta = a * s_beta + into * h_beta
        s_hmin = a * s_hmin + into * (1.0 - shape)
        s_hmax = a * s_hmax + into * (shape - h / h_max)
        s_r0 = a * s_r0 + into * h_r0
        s_ra = a * s_ra + now - p_min - gain * drive
        s_rmin = a * s_rmin + rest * (1.0 - share)
        s_rmax = a * s_rmax + rest * share
        by_0 = a * by_0
        now = a * now + rest * (p_min + gain * drive)
        r_a = a_h * r_a + r - m
        r_0 = a_h * r_0
        r = a_h * r + (1.0 - a_h) * m


@numba.njit(cache=True)
def input_influence(mode, a, b, jacobian):
    """
    Return Jᵀ L, where L maps a change of human performance to the change of simulated robot performance (2.3).

    Parameters
    ----------
    mode : numpy.ndarray, shape (N,)
        Manual share.
    a, b : float
        Parameters of (2.3).
    jacobian : numpy.ndarray, shape (N, p)
        J.

    Returns
    -------
    numpy.ndarray, shape (N, p)
        Row i: the derivative of Jᵀ y by human performance at sample i.
    """
    n, p = jacobian.shape
    out = np.zeros((n, p))
    tail = np.zeros(p)
    for k in range(n - 2, -1, -1):
        for j in range(p):
            tail[j] = jacobian[k + 1, j] + a * tail[j]
            out[k, j] = b * mode[k] * tail[j]
    return out
