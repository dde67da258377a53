"""
Write `ranks.csv` and `populations.csv`: what posteriors say of people whose parameters are known.

An hour on one core. The tests read the tables, and make some of their rows again:
`python -m tests.identification.posterior.make_coverage`.
"""

from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

import trustlab as tl
from tests.identification.posterior import simulated_logs
from trustlab.identification.posterior import population as pooling
from trustlab.identification.posterior.density import as_prior, physical, transformed

HERE = Path(__file__).resolve().parent
PRINTED = ["1", "2", "3", "4", "5", "pilot"]
PEOPLE = transformed([tl.published_models()[name] for name in PRINTED[:5]])

# Noise that is nearly white, nearly first-order over 5 s, or anything that the weak prior allows.
NOISES = {
    "white": tl.Prior(slow=(1e-4, 0.3)),
    "slow": tl.Prior(slow_time=(5.0, 0.1), white=(1e-3, 0.5)),
    "means": tl.Prior(),
}

# How many logs of each kind: people of the prior whose mode changes at random, under thresholds
# that know them, under a rule that measures; and people of Table 2.1.
LOGS = {("prior, open", noise): 300 for noise in NOISES}
LOGS |= {("prior, thresholds", "any"): 300, ("prior, measuring rule", "any"): 300}
LOGS |= {(f"Table 2.1, {loop}", noise): 100 for loop in ("open", "thresholds") for noise in NOISES}

# Where the five people of a population come from.
ORIGINS = ("Table 2.1", "spread of Table 2.1", "prior")
GROUPS = 20


def log_of(people, noise, number):
    """Return a simulated log, the true θ, and the prior that it is to be read with."""
    rng = np.random.default_rng([29, number, *map(ord, people + noise)])
    who, how = people.split(", ")
    prior, loop = NOISES.get(noise, tl.Prior()), "open" if how == "open" else "closed"
    if how == "measuring rule":
        case = simulated_logs.measured_case(rng)
    elif who == "prior":
        case = simulated_logs.drawn_case(rng, noise, loop, prior=prior)
    else:
        case = simulated_logs.printed_case(rng, noise, loop, who=PRINTED[number % len(PRINTED)])
        prior = tl.Prior()
    return *case, prior


def shares_below(posterior, theta):
    """Return the share of draws below the truth, by parameter."""
    truth = physical(theta[None], 0.1).iloc[0].dropna()
    draws = posterior.draws.drop(columns=["human_a", "robot_a"])  # ranks of their time constants
    known = draws.columns.intersection(truth.index, sort=False)
    return (draws[known] < truth[known]).mean()


def ranks_of(people, noise, number):
    """Return the shares of draws below the truth; nothing where a log is refused."""
    about = {"people": people, "noise": noise, "number": number}
    session, theta, prior = log_of(people, noise, number)
    try:
        posterior = tl.sample_posterior(session, prior=prior, seed=number)
    except tl.IdentificationError as error:
        return about | {"refused": str(error)}
    return about | shares_below(posterior, theta).to_dict()


def five_of(origin, rng):
    """Return the first seven coordinates of five people."""
    if origin == "Table 2.1":
        return PEOPLE
    if origin == "spread of Table 2.1":
        spread = PEOPLE.std(axis=0, ddof=1)
        return PEOPLE.mean(axis=0) + spread * rng.standard_normal(PEOPLE.shape)
    # What `fit_population` takes for granted: Huang and Wand's distribution of covariances.
    centre, deviation, _ = as_prior("weak").vectors(0)
    size = PEOPLE.shape[1]
    thetas = np.full(PEOPLE.shape, -1.0)
    while (thetas[:, [2, 5]] <= 0.0).any():  # performances are positive
        mean = np.sqrt(pooling.OF_MEAN) * rng.standard_normal(size)
        rates = stats.invgamma(0.5, scale=pooling.SCALE**-2).rvs(size, random_state=rng)
        scatter = np.diag(2.0 * pooling.FREEDOM / rates)
        spread = stats.invwishart(pooling.FREEDOM + size - 1, scatter).rvs(random_state=rng)
        z = rng.multivariate_normal(mean, spread, 5)
        thetas = centre[:size] + deviation[:size] * z
    return thetas


def population_of(origin, noise, number):
    """Return every person's truth, estimate and interval, pooled and alone."""
    rng = np.random.default_rng([31, number, *map(ord, origin + noise)])
    thetas = {str(k): theta for k, theta in enumerate(five_of(origin, rng), start=1)}
    cases = {who: simulated_logs.person_case(rng, each, noise) for who, each in thetas.items()}
    sessions = {who: session for who, (session, _) in cases.items()}
    people = tl.fit_population(sessions, seed=number)
    table = people.table().drop("new person")
    rows = table[["mean", "ci_low", "ci_high", "alone_mean"]].reset_index()
    rows["truth"] = [cases[who][1][name] for who, name in table.index]
    return rows.assign(origin=origin, noise=noise, number=number)


def main():
    """Write both tables."""
    with ProcessPoolExecutor() as pool:
        cases = [(*case, k) for case, count in LOGS.items() for k in range(count)]
        rows = pool.map(ranks_of, *zip(*cases, strict=True), chunksize=10)
        pd.DataFrame(rows).round(4).to_csv(HERE / "ranks.csv", index=False)
        groups = zip(*product(ORIGINS, ("slow", "means"), range(GROUPS)), strict=True)
        tables = pd.concat(pool.map(population_of, *groups))
        tables.to_csv(HERE / "populations.csv", index=False, float_format="%.8g")


if __name__ == "__main__":
    main()
