"""What is computed to compare two machines: small calls of public functions."""

import tempfile
from pathlib import Path

import networkx as nx
import numpy as np
import pandas as pd
from scipy import signal

import trustlab as tl
from trustlab.studies import LikertScale, Simulation, StudyColumns

PILOT = Path(__file__).parents[1] / "sessions" / "pilot.csv"
WITHIN = {"dv": "score", "within": "condition", "subject": "subject"}
SCATTERING = tl.Scattering(b=2.0, alpha_min=0.2, alpha_max=1.0, beta_min=0.05, beta_max=0.5)


def scores(subjects=12, conditions=4):
    """Return a table of synthetic scores: subjects, conditions, a value with a trend."""
    rng = np.random.default_rng(7)
    values = np.round(rng.normal(size=(subjects, conditions)) + 0.4 * np.arange(conditions), 3)
    index = [(f"P{i}", f"C{j}") for i in range(subjects) for j in range(conditions)]
    frame = pd.DataFrame(index, columns=["subject", "condition"])
    return frame.assign(score=values.ravel())


def counts():
    """Return synthetic counts of successes: subjects, conditions, how many of ten."""
    rng = np.random.default_rng(11)
    frame = scores(15, 3)
    logits = frame["score"] - 0.5
    successes = rng.binomial(10, 1.0 / (1.0 + np.exp(-logits)))
    return frame.assign(successes=successes, tried=10)


def items():
    """Return synthetic answers to five items of a questionnaire."""
    rng = np.random.default_rng(5)
    trait = rng.normal(size=(20, 1))
    answers = np.clip(np.round(4.0 + trait + rng.normal(size=(20, 5))), 1, 7)
    return pd.DataFrame(answers, columns=[f"q{i}" for i in range(5)])


def model():
    """Return the printed model of participant 2."""
    return tl.published_models()["2"]


def pilot():
    """Return the session of the pilot that the repository holds."""
    return tl.read_session(PILOT)


def driven(condition="C3"):
    """Return a simulated session of participant 2, eight laps long."""
    return tl.run_condition(condition, participant=2, laps=4, seed=0).session


def flights():
    """Return simulated flights under two schemes."""
    return [tl.simulate_teleoperation(scheme, seed=0, duration=10.0) for scheme in ("M", "TMIG")]


def channel():
    """Return the energy of a channel that carries random signals."""
    velocity, force = np.random.default_rng(0).normal(size=(2, 500, 3))
    run = tl.channel_run(velocity, force, SCATTERING, 0.01, delay_1=0.1, delay_2=0.1)
    return run.energy


def transfer_function():
    """Return a transfer function fitted to a response."""
    command = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 20), 50)
    times = 0.01 * np.arange(1000)
    _, velocity, _ = signal.lsim(([0.985], [1.0, 0.4952]), command, times, interp=False)
    fit = tl.fit_transfer_function(command, velocity, sample_time=0.01, order=1)
    return [fit.model.gain, *fit.model.denominator]


def campaign():
    """Return the table of a campaign that is written to a folder."""

    def task(x, seed):
        return {"y": np.random.default_rng(seed).normal() + x}

    with tempfile.TemporaryDirectory() as folder:
        return tl.run_campaign(task, tl.parameter_grid(x=range(20)), seed=3, n_jobs=1, out=folder)


def sensitivity():
    """Return Sobol indices of a product."""

    def task(x, y, seed):
        return {"z": x + 0.1 * y * x}

    return tl.sobol_indices(task, {"x": (0.0, 1.0), "y": (0.0, 1.0)}, n=64, n_jobs=1).table()


def corrections():
    """Return one step of the threshold corrector."""
    corrector = tl.ThresholdCorrector(model(), target=(0.05, 0.4), horizon=100)
    plan = corrector.step(r=0.6, p_r=0.3, lower=0.0, upper=0.35, mode=1)
    return [plan.lower, plan.upper, plan.cost]


def reconstruction(name):
    """Return data with the printed statistics of a study."""
    return tl.reconstruct(tl.published_studies()[name], seed=0)


def limits():
    """Return the limits of thresholds."""
    bounds = tl.threshold_limits(model())
    return [bounds.lower, bounds.upper]


def thresholds():
    """Return the thresholds chosen for the model."""
    choice = tl.choose_thresholds(model())
    return [choice.lower, choice.upper]


def power():
    """Return the power of a study like the scores."""
    columns = StudyColumns("score", "condition", "subject")
    quick = Simulation(replicates=500, seed=0)
    return tl.power_analysis(data=scores(12, 3), columns=columns, n=12, simulation=quick).table()


def least_n():
    """Return the least number of people for a power of 80 %."""
    covariance = np.full((3, 3), 0.5) + 0.5 * np.eye(3)
    quick = Simulation(replicates=500, seed=0)
    return [tl.smallest_n(0.8, [0.0, 0.3, 0.6], covariance, simulation=quick).n]


def orders():
    """Return effects of order in a virtual study."""
    study = tl.virtual_study(n=10, conditions=["C1", "C2", "C3", "C4", "C5"], laps=2, seed=0)
    columns = {"condition": "condition", "position": "position", "subject": "participant"}
    return tl.order_effects(study.measures, dv="p_r", **columns).table()


def logistic():
    """Return the tests of a logistic mixed model."""
    fit = tl.formula_model(
        "successes ~ condition", counts(), groups="subject", family="binomial", trials="tried"
    )
    return fit.coefficients_table()


def ratings():
    """Return the terms of a cumulative-link mixed model of synthetic ratings."""
    frame = scores(15, 3)
    frame["rating"] = np.clip(np.round(2.0 + frame.pop("score")), 1, 4).astype(int)
    columns = {"within": "condition", "subject": "subject"}
    return tl.ordinal_model(frame, dv="rating", **columns).coefficients_table()


def posterior():
    """Return draws of the pilot's parameters from ten minutes."""
    return tl.sample_posterior(pilot().between(500.0, 1100.0), n=200)


def population():
    """Return what two short logs say of two people and of a new one."""
    people = {"A": pilot().between(0.0, 600.0), "B": pilot().between(500.0, 1100.0)}
    return tl.fit_population(people, n=200).table().dropna(axis=1)


def probable_thresholds():
    """Return thresholds chosen under a posterior, and their probability."""
    choice = tl.choose_thresholds(posterior(), points=8)
    return [choice.lower, choice.upper, choice.probability]


def optimum():
    """Return the optimal allocation of the model."""
    best = tl.optimal_allocation(model(), weight=0.5)
    return [best.value, best.upper_bound, best.r_star]


def trust():
    """Return parameters of a model of trust, fitted to people of a public study."""
    fit = tl.fit_trust(tl.read_people("hybrid_vr"), "asymmetric")
    return fit.table()[["parameter", "estimate"]]


def simulated_study(testbed, n, conditions):
    """Return the measures of a virtual study."""
    return tl.virtual_study(n=n, testbed=testbed, conditions=conditions, laps=1, seed=0).measures


def ease():
    """Return the scores of a questionnaire."""
    scale = LikertScale("ease", items=tuple(f"q{i}" for i in range(5)), low=1, high=7)
    return tl.score_likert(items().assign(person=range(20)), scale, subject="person").table()


# What every machine computes to the last bit.
SAME_BITS = {
    "simulate_allocation": lambda: tl.simulate_allocation(model(), 0.0, 0.35, steps=20_000),
    "threshold_limits": limits,
    "invariant_bounds": lambda: tl.invariant_bounds(model(), 0.0, 0.3).table(),
    "limit_cycle": lambda: tl.limit_cycle(model(), 0.0, 0.3).table(),
    "sweep": lambda: tl.sweep(model(), {"upper": [0.25, 0.3]}, lower=0.0, n_jobs=1).table(),
    "incentive_bounds": lambda: tl.incentive_bounds(0.7, 0.3, 1e-5, model()),
    "ThresholdCorrector": corrections,
    "run_condition": lambda: driven().table(),
    "followed_suggestions": lambda: tl.followed_suggestions(driven("C2")),
    "virtual_study": lambda: simulated_study("ground_robot", 3, ["C1", "C3", "C5"]),
    "virtual_study_uav": lambda: tl.virtual_study(n=10, testbed="uav_following", seed=0).measures,
    "simulate_teleoperation": lambda: tl.simulate_teleoperation(
        "TMIG", seed=0, duration=5.0
    ).table(),
    "simulated_answers": lambda: list(tl.simulated_answers(flights()[1], seed=0).values()),
    "channel_run": channel,
    "simulate_team": lambda: (
        tl.simulate_team(nx.cycle_graph(4), seed=0, performance="random").positions
    ),
    "run_campaign": campaign,
    "parameter_draws": lambda: pd.DataFrame(
        tl.parameter_draws(50, seed=1, beta=(0.6, 0.8), laps=[4, 8])
    ),
    "latin_square_design": lambda: tl.latin_square_design(["A", "B", "C", "D"], 12, seed=0).table(),
    "reconstruct_tlx": lambda: reconstruction("uav.tlx"),
    "reconstruct_tracking": lambda: reconstruction("teleop.tracking_error"),
    "score_likert": ease,
}

# What goes through LAPACK, an optimiser or a library's special functions: equal to 1e-9.
SAME_DIGITS = {
    "steady_state_bounds": lambda: tl.steady_state_bounds(model(), 0.0, 0.35).table(),
    "choose_thresholds": thresholds,
    "estimate_thresholds": lambda: tl.estimate_thresholds(
        driven(), model(), within=1.0, resamples=100
    ).table(),
    "fit_tsc": lambda: tl.fit_tsc(pilot()).table(),
    "fit_robot": lambda: tl.fit_robot(pilot()).table(),
    "fit_human": lambda: tl.fit_human(pilot()).table(),
    "fit_robot_by_regression": lambda: tl.fit_robot(pilot(), method="regression").table(),
    "fit_transfer_function": transfer_function,
    "sample_posterior": lambda: posterior().table(),
    "fit_population": population,
    "choose_thresholds_of_a_posterior": probable_thresholds,
    "optimal_allocation": optimum,
    "tune_transparency": lambda: tl.tune_transparency(SCATTERING).table(),
    "teleoperation_measures": lambda: tl.teleoperation_measures(flights()),
    "sobol_indices": sensitivity,
    "repeated_measures": lambda: tl.repeated_measures(scores(), **WITHIN).table(),
    "pairs": lambda: tl.repeated_measures(scores(), **WITHIN).pairs(),
    "paired_t_test": lambda: tl.paired_t_test(scores(12, 2), **WITHIN).table(),
    "bayes_factor": lambda: tl.bayes_factor(scores(), **WITHIN),
    "equivalence": lambda: tl.equivalence(scores(), **WITHIN, bound=0.8),
    "mixed_model": lambda: tl.mixed_model(scores(), **WITHIN).table(),
    "formula_model": lambda: tl.formula_model(
        "score ~ condition", scores(), groups="subject"
    ).coefficients_table(),
    "formula_model_of_counts": logistic,
    "order_effects": orders,
    "cronbach_alpha": lambda: [tl.cronbach_alpha(items()).alpha],
    "power_analysis": power,
    "smallest_n": least_n,
    "reconstruct_study": lambda: tl.reconstruct_study(
        tl.published_studies()["uav.tlx"], seed=0
    ).table(),
    "audit": tl.audit,
    "printed_effects": tl.printed_effects,
    "model_effects": tl.model_effects,
    "simulated_effects": lambda: tl.simulated_effects(
        {"attention_cost": 0.05}, n=4, seed=0, only="table_2.6", n_jobs=1
    ),
}

# What ends in a search by differences, to 1e-6.
SIX_DIGITS = {"fit_trust": trust, "ordinal_model": ratings}

# Name of the case: how closely machines agree, 0 for the same bits, and what computes it.
CASES = {name: (0.0, compute) for name, compute in SAME_BITS.items()}
CASES |= {name: (1e-9, compute) for name, compute in SAME_DIGITS.items()}
CASES |= {name: (1e-6, compute) for name, compute in SIX_DIGITS.items()}
