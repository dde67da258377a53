"""
The likelihood and its coordinates.

Oracles: SciPy's multivariate normal density with the covariance of the samples written out and
averaged; the models' own simulation, sample by sample; finite differences for the Jacobian.
"""

from types import SimpleNamespace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark
from scipy import stats

import trustlab as tl
from tests.identification.posterior.simulated_logs import drawn_case, model_of
from trustlab.identification.log import Noise, filter_columns, process, read_runs, whiten
from trustlab.identification.posterior import density as kernel, sampling
from trustlab.identification.posterior.density import (
    as_prior,
    evaluated,
    point_of,
    prior_of,
    transformed,
)
from trustlab.identification.posterior.sampling import prior_thetas
from trustlab.identification.problem import Problem
from trustlab.identification.tsc import TSC
from trustlab.sessions.metrics import window_mean


def target_of(seed, *minutes, **settings):
    """A target of short runs of people drawn from the prior, the runs, and the θ of the first."""
    log, rng = tl.LogSettings(**settings), default_rng(seed)
    cases = [drawn_case(rng, "white", minutes=each) for each in minutes or [1.0]]
    runs = read_runs([session for session, _ in cases], "mode", "p_h", "p_r", log=log)
    optimum = SimpleNamespace(problem=Problem(TSC, runs, TSC.limits()))
    return sampling.target_of(optimum, as_prior("weak"), log), runs, cases[0][1]


def dense_covariance(white, slow, seconds, samples, blocks):
    """The covariance of block means of white plus first-order noise, written out."""
    t = 0.1 * np.arange(samples * blocks)
    covariance = slow**2 * np.exp(-abs(t[:, None] - t) / seconds) + white**2 * np.eye(t.size)
    means = np.kron(np.eye(blocks), np.full(samples, 1.0 / samples))
    return means @ covariance @ means.T


def in_blocks(samples):
    """Means of ten samples."""
    return np.reshape(samples, (-1, 10)).mean(axis=1)


@mark.parametrize("seed", range(4))
def test_the_kalman_filter_gives_the_dense_density(seed):
    rng = default_rng(seed)
    white, slow, seconds = np.exp(rng.normal([-5.0, -5.0, 1.0], 1.0))
    memory, share = np.exp(-0.1 / seconds), slow**2 / (white**2 + slow**2)
    errors, known = 0.01 * rng.standard_normal((40, 1)), rng.random(40) >= 0.3 * (seed % 2)

    def dense(covariance):
        there = stats.multivariate_normal(cov=covariance[np.ix_(known, known)])
        return there.logpdf(errors[known, 0])

    def density(scaled, logs):
        return -0.5 * (logs + np.sum(scaled**2) + known.sum() * np.log(2.0 * np.pi))

    def filtered(noise):
        scaled = np.empty((40, 1))
        logs = filter_columns(errors, known, noise, scaled)
        return density(scaled, logs)

    noise = process(white, slow, memory, 10)
    of_blocks = dense(dense_covariance(white, slow, seconds, 10, 40))
    assert filtered(noise) == approx(of_blocks, rel=1e-9)
    # Negative control: correlation within a block that is forgotten between blocks.
    assert filtered(noise._replace(both=0.0)) != approx(of_blocks, rel=1e-6)
    of_samples = dense(dense_covariance((1.0 - share) ** 0.5, share**0.5, seconds, 1, 40))
    whitened = density(*whiten(errors, known, Noise(share, memory)))
    assert whitened == approx(of_samples, rel=1e-9)


def test_block_means_are_those_of_the_models():
    target, runs, _ = target_of(5, 1.0, 0.7)
    states = [kernel.R0, kernel.P_R0]
    for theta in prior_thetas(target, 20, default_rng(5)):
        means = kernel.simulate(theta, target.blocks)
        for i, run in enumerate(runs):
            theta[states] = theta[np.add(states, 2 * i)]
            tsc, *begin = model_of(theta)
            sampled = tsc.simulate(run["mode"], *begin)
            blocks = slice(*target.blocks.first_block[i : i + 2])
            for j, (name, part) in enumerate({"p_h": tsc.human, "p_r": tsc.robot}.items()):
                expected = in_blocks(sampled[name][: run.size // 10 * 10])
                # (2.6) at the mean utilization of a block of a second; at rest its slope is
                # infinite.
                span = part.p_max - part.p_min
                assert_allclose(means[j, blocks], expected, atol=0.02 * span)
                assert abs(means[j, blocks] - expected).mean() < 1e-3 * span


def test_the_density_is_likelihood_times_prior():
    target, *_ = target_of(6, 1.0, 0.7)
    theta = prior_thetas(target, 20, default_rng(6))[0]
    x, free = point_of(theta, target), target.free
    back, values = evaluated(x[None], target)
    assert_allclose(back[0], theta, atol=1e-12)
    errors = target.blocks.measured - kernel.simulate(theta, target.blocks)
    # The prior is counted from its maximum.
    expected = -0.5 * np.sum(((theta - target.mean) / target.deviation)[free] ** 2)
    for of_run in np.split(errors, target.blocks.first_block[1:-1], axis=1):
        for error, places in zip(of_run, kernel.NOISES, strict=True):
            covariance = dense_covariance(*np.exp(theta[list(places)]), 10, error.size)
            expected += stats.multivariate_normal(cov=covariance).logpdf(error)
    assert values[0] == approx(expected, rel=1e-9)


def test_a_prior_of_correlated_parameters_has_its_density():
    rng = default_rng(7)
    centre = transformed(tl.published_models().values()).mean(axis=0)
    root = rng.standard_normal((7, 7))
    covariance = root @ root.T + np.eye(7)
    mean, _, whitening = prior_of(centre, covariance).vectors(1)
    expected = stats.multivariate_normal(centre, covariance)
    for theta in expected.rvs(5, random_state=rng):
        z = whitening[:, :7] @ (theta - mean[:7])
        density = expected.logpdf(theta) - expected.logpdf(centre)
        assert -0.5 * z @ z == approx(density, rel=1e-9)


def test_coordinates_have_unit_jacobian():
    target, _, theta = target_of(8)
    x = point_of(theta, target)
    steps = 1e-6 * np.eye(x.size)
    after, before = (evaluated(x + side * steps, target)[0][:, target.free] for side in (1, -1))
    jacobian = (after - before) / 2e-6 / target.deviation[target.free]
    assert np.linalg.det(jacobian) == approx(1.0, abs=1e-6)


def test_a_delay_shifts_what_is_simulated():
    """Oracle: the models' samples under a mode that is moved; states are those of the first."""
    target, (run,), theta = target_of(9, mode_delay=True)
    assert kernel.DELAY in target.free
    tsc, *begin = model_of(theta)
    mode = run["mode"]
    errors = np.empty(target.blocks.measured.shape)
    for samples in (10, 3, 40):
        moved = np.r_[mode[:1].repeat(samples), mode[:-samples]]
        sampled = tsc.simulate(moved, *begin)[["p_h", "p_r"]][: 10 * errors.shape[1]]
        measured = np.array([in_blocks(sampled[name]) for name in sampled])
        blocks = target.blocks._replace(measured=measured, known=np.ones(errors.shape, bool))
        sizes = []
        # Negative control: the mode acts when it is stamped.
        for theta[kernel.DELAY] in (0.1 * samples, 0.0):
            kernel.innovations(theta, blocks, kernel.simulate(theta, blocks), errors)
            sizes.append(abs(errors).mean())
        assert sizes[0] < 0.25 * sizes[1]


@mark.parametrize("window", [30, 31, 100, 1000])
def test_means_over_a_window_are_simulated_by_blocks(window):
    """Oracle: with_performance's mean of the simulated samples."""
    samples = 0.4 + 0.05 * np.sin(np.arange(3000) / 300.0)
    blocks = in_blocks(samples)
    expected = in_blocks(window_mean(samples, 0.1, 0.1 * window))
    assert_allclose(kernel.logged(blocks, 0.0, window, 10), expected, atol=5e-5)
    assert abs(blocks - expected).max() > 1e-3  # what is told apart
