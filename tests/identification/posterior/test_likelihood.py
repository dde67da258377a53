"""
The likelihood and its coordinates.

Oracles: SciPy's multivariate normal density with the covariance of the samples written out and
averaged; the models' own simulation, sample by sample; finite differences for the Jacobian.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

import trustlab as tl
from tests.identification.posterior import simulated_logs
from trustlab.identification.log import read_runs
from trustlab.identification.noise import Noise, filter_columns, process, whiten
from trustlab.identification.posterior import density as kernel
from trustlab.identification.posterior.density import (
    as_prior,
    evaluated,
    point_of,
    prior_of,
    transformed,
)
from trustlab.identification.posterior.sampling import prior_thetas, target_of
from trustlab.identification.problem import Problem
from trustlab.identification.tsc import TSC
from trustlab.sessions.metrics import window_mean


def target_and_runs(rng, minutes=(1.0, 0.7), **settings):
    """A target of short runs of people drawn from the prior; the θ of the first."""
    log = tl.LogSettings(**settings)
    cases = [simulated_logs.drawn_case(rng, "white", minutes=each) for each in minutes]
    runs = read_runs([session for session, _ in cases], "mode", "p_h", "p_r", log=log)
    optimum = SimpleNamespace(problem=Problem(TSC, runs, TSC.limits()))
    return target_of(optimum, as_prior("weak"), log), runs, cases[0][1]


def own_target(seed, **settings):
    """A target of one run, and the θ that made it."""
    target, _, theta = target_and_runs(np.random.default_rng(seed), (1.0,), **settings)
    return target, theta


def dense_covariance(white, slow, seconds, samples, blocks, step=0.1):
    """The covariance of block means of white plus first-order noise, written out."""
    t = step * np.arange(samples * blocks)
    covariance = slow**2 * np.exp(-np.abs(t[:, None] - t) / seconds) + white**2 * np.eye(t.size)
    means = np.kron(np.eye(blocks), np.full(samples, 1.0 / samples))
    return means @ covariance @ means.T


@pytest.mark.parametrize("seed", range(4))
def test_the_kalman_filter_gives_the_dense_density(seed):
    rng = np.random.default_rng(seed)
    white, slow, seconds = np.exp(rng.normal([-5.0, -5.0, 1.0], 1.0))
    errors = 0.01 * rng.standard_normal(40)
    noise = process(white, slow, np.exp(-0.1 / seconds), 10)
    share = slow**2 / (white**2 + slow**2)
    of_blocks = dense_covariance(white, slow, seconds, 10, 40)
    of_samples = dense_covariance((1.0 - share) ** 0.5, share**0.5, seconds, 1, 40)

    def density(covariance, known):
        there = stats.multivariate_normal(cov=covariance[np.ix_(known, known)])
        return there.logpdf(errors[known])

    def density_of(scaled, logs, known):
        return -0.5 * (logs + np.sum(scaled**2) + known.sum() * np.log(2.0 * np.pi))

    def density_by_filter(known, noise):
        scaled = np.empty((40, 1))
        logs = filter_columns(errors[:, None], known, noise, scaled)
        return density_of(scaled, logs, known)

    for known in (np.ones(40, bool), rng.random(40) < 0.7):
        expected = density(of_blocks, known)
        assert density_by_filter(known, noise) == pytest.approx(expected, rel=1e-9)
        whitened = whiten(errors[:, None], known, Noise(share, np.exp(-0.1 / seconds)))
        by_samples = pytest.approx(density(of_samples, known), rel=1e-9)
        assert density_of(*whitened, known) == by_samples
        # Negative control: correlation within a block that is forgotten between blocks.
        apart = noise._replace(both=0.0)
        assert density_by_filter(known, apart) != pytest.approx(expected, rel=1e-6)


def test_block_means_are_those_of_the_models():
    rng = np.random.default_rng(5)
    target, runs, _ = target_and_runs(rng)
    for theta in prior_thetas(target, 20, rng):
        means = kernel.simulate(theta, target.blocks)
        tsc, _, _ = simulated_logs.model_of(theta)
        for i, run in enumerate(runs):
            odds, above = theta[kernel.R0 + 2 * i], theta[kernel.P_R0 + 2 * i]
            r0 = 1.0 / (1.0 + np.exp(-odds))
            sampled = tsc.simulate(run["mode"], r0, theta[kernel.P_MIN] + above)
            blocks = slice(*target.blocks.first_block[i : i + 2])
            for j, name in enumerate(("p_h", "p_r")):
                count = run.size // 10
                expected = sampled[name].to_numpy()[: 10 * count].reshape(count, 10).mean(axis=1)
                # (2.6) at the mean utilization of a block of a second; at rest its slope is
                # infinite.
                part = (tsc.human, tsc.robot)[j]
                span = part.p_max - part.p_min
                np.testing.assert_allclose(means[j, blocks], expected, atol=0.02 * span)
                assert np.abs(means[j, blocks] - expected).mean() < 1e-3 * span


def test_the_density_is_likelihood_times_prior():
    target, theta = own_target(6)
    x = point_of(theta, target)
    back, values = evaluated(x[None], target)
    np.testing.assert_allclose(back[0], theta, atol=1e-12)
    errors = target.blocks.measured - kernel.simulate(theta, target.blocks)
    expected = 0.0
    for j, places in enumerate(kernel.NOISES):
        white, slow, seconds = np.exp(theta[list(places)])
        covariance = dense_covariance(white, slow, seconds, 10, errors.shape[1])
        expected += stats.multivariate_normal(cov=covariance).logpdf(errors[j])
    normals = stats.norm(target.mean, target.deviation)
    free = target.free
    prior = normals.logpdf(theta)[free].sum() + np.log(target.deviation[free]).sum()
    prior += 0.5 * free.size * np.log(2.0 * np.pi)
    assert values[0] == pytest.approx(expected + prior, rel=1e-9)


def test_a_prior_of_correlated_parameters_has_its_density():
    rng = np.random.default_rng(7)
    values = transformed(tl.published_models().values())
    root = rng.standard_normal((7, 7))
    covariance = root @ root.T + np.eye(7)
    prior = prior_of(values.mean(axis=0), covariance)
    mean, _, whitening = prior.vectors(1)
    expected = stats.multivariate_normal(values.mean(axis=0), covariance)
    for theta in expected.rvs(5, random_state=rng):
        z = whitening @ np.r_[theta - mean[:7], np.zeros(mean.size - 7)]
        density = expected.logpdf(theta) - expected.logpdf(expected.mean)
        assert -0.5 * z @ z == pytest.approx(density, rel=1e-9)


def test_coordinates_have_unit_jacobian():
    target, theta = own_target(8)
    x = point_of(theta, target)
    columns = []
    for k in range(x.size):
        step = np.zeros(x.size)
        step[k] = 1e-6
        ends = evaluated(np.array([x + step, x - step]), target)[0][:, target.free]
        columns.append((ends[0] - ends[1]) / 2e-6 / target.deviation[target.free])
    assert np.linalg.det(np.array(columns)) == pytest.approx(1.0, abs=1e-6)


def test_a_delay_shifts_what_is_simulated():
    """Oracle: the models' samples under a mode that is moved; states are those of the first."""
    target, runs, theta = target_and_runs(np.random.default_rng(9), (1.0,), mode_delay=True)
    assert kernel.DELAY in target.free
    tsc, r0, p_r0 = simulated_logs.model_of(theta)
    mode = runs[0]["mode"]
    errors = np.empty(target.blocks.measured.shape)
    for samples in (10, 3, 40):
        moved = np.r_[mode[:1].repeat(samples), mode[:-samples]]
        sampled = tsc.simulate(moved, r0, p_r0)[["p_h", "p_r"]].to_numpy().T
        measured = sampled[:, : 10 * errors.shape[1]].reshape(2, -1, 10).mean(axis=2)
        blocks = target.blocks._replace(measured=measured, known=np.ones(errors.shape, bool))
        sizes = []
        # Negative control: the mode acts when it is stamped.
        for theta[kernel.DELAY] in (0.1 * samples, 0.0):
            kernel.innovations(theta, blocks, kernel.simulate(theta, blocks), errors)
            sizes.append(np.abs(errors).mean())
        assert sizes[0] < 0.25 * sizes[1]


@pytest.mark.parametrize("window", [30, 31, 100, 1000])
def test_means_over_a_window_are_simulated_by_blocks(window):
    """Oracle: with_performance's mean of the simulated samples."""
    t = 0.1 * np.arange(3000)
    samples = 0.4 + 0.05 * np.sin(t / 30.0)
    blocks = samples.reshape(-1, 10).mean(axis=1)
    expected = window_mean(samples, 0.1, 0.1 * window).reshape(-1, 10).mean(axis=1)
    means = kernel.logged(blocks, 0.0, window, 10)
    np.testing.assert_allclose(means, expected, atol=5e-5)
    assert np.abs(blocks - expected).max() > 1e-3  # what is told apart
