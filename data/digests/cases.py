"""
What is computed to compare two machines: small calls of public functions, by name.

A result is a table, an array, a dictionary of columns or a list of values. Estimates are tables of
`estimates`, whose numbers are compared by their standard errors.
"""

import tempfile
import tomllib
from pathlib import Path

import networkx as nx
import numpy as np
import pandas as pd
from scipy import signal

import trustlab as tl
from trustlab.studies import Questionnaire, Simulation, StudyColumns

SESSIONS = Path(__file__).parents[1] / "sessions"
PILOT = SESSIONS / "pilot.csv"
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


def estimates(table, estimate, standard_error):
    """Return the columns of a table that hold estimates and their standard errors."""
    return table[[estimate, standard_error]].set_axis(["estimate", "standard_error"], axis=1)


def model():
    """Return the printed model of participant 2."""
    return tl.published_models()["2"]


def mode():
    """Return who drives, in four phases of a hundred samples."""
    return np.repeat([1.0, 0.0, 1.0, 0.5], 100)


def printed_models():
    """Return the parameters of every printed model, the derived ones too."""
    models = tl.published_models()
    rooms = {"robot": ("a", "b", "p_min", "p_max"), "human": ("a", "beta", "p_min", "p_max")}
    return pd.DataFrame(
        {
            f"{part}_{name}": [getattr(getattr(tsc, part), name) for tsc in models.values()]
            for part, names in rooms.items()
            for name in names
        },
        index=pd.Index(models, name="operator"),
    )


def performance():
    """Return robot performance (2.3), its steady state last, under a printed operator."""
    robot = model().robot
    p_h = np.linspace(0.39, 0.46, 400)
    return [*robot.simulate(mode(), p_h, p_r0=0.3), robot.steady_state(1.0, 0.45)]


def utilization():
    """Return utilization (2.5) and human performance (2.6) of a printed operator."""
    r, p_h = model().human.simulate(mode(), r0=0.2)
    return {"r": r, "p_h": p_h, "of_r": model().human.performance(r)}


def trust_in_time():
    """Return trust (3.2) driven by a falling performance, and where it settles."""
    dynamics = tl.TrustModel(a=0.4, b=0.3, t_min=0.1, t_max=0.9)
    run = dynamics.simulate(np.linspace(1.0, 0.0, 300), sample_time=0.1, trust0=0.2)
    return [*run, dynamics.steady_state(0.7), dynamics.decay(0.1), dynamics.step(0.2, 0.7, 0.1)]


def scales():
    """Return the scales (3.5) and (3.6) of a range of trust."""
    trust = np.linspace(0.0, 1.0, 25)
    logistic = tl.models.LogisticScaling(low=0.2, high=1.0)
    step = tl.models.StepScaling(low=0.2, high=1.0)
    return {
        "logistic": [logistic.value(value) for value in trust],
        "step": [step.value(value) for value in trust],
    }


def vehicles():
    """Return the poles of the printed vehicles, and what they do in a sample."""
    axes = tl.models.PRINTED_UAV.values()
    poles = [np.sort(axis.poles().real) for axis in axes]
    return np.concatenate([*poles, *(np.ravel(axis.discrete(0.01)[0]) for axis in axes)])


def pilot():
    """Return the session of the pilot that the repository holds."""
    return tl.read_session(PILOT)


def described(sessions):
    """Return the length, the period and the sums of the columns of sessions."""
    rows = [
        {"person": str(session.metadata.participant), "samples": len(session.t)}
        | {"sample_time": session.sample_time, "duration": session.duration}
        | {f"mean_{name}": float(session.data[name].mean()) for name in session.columns}
        for session in sessions
    ]
    return pd.DataFrame(rows)


RECIPE = """
name = "lab"
kind = "table"

[files]
pattern = "p{participant:int}.csv"

[metadata]
participant = { from = "participant" }

[time]
column = "ms"
unit = "ms"
from_zero = true

[columns]
mode = { column = "driver", map = { human = 1, robot = 0 } }
path_error = { column = "deviation", unit = "cm" }
robot_x = { column = "x", unit = "cm" }
robot_y = { column = "y", unit = "cm" }
step_distance = { travelled = "robot", axes = ["x", "y"] }
v_command = { column = "v", unit = "m/s" }
w_command = { column = "w", unit = "deg/s" }

[resampling]
method = "linear"
sample_time = 0.1
"""


def lab_log(seed):
    """Return a drive as a lab logs it: uneven stamps, units and words of its own."""
    rng = np.random.default_rng(seed)
    n = 600
    return pd.DataFrame(
        {
            "ms": 2000 + np.cumsum(rng.integers(80, 120, n)),
            "driver": np.where(np.arange(n) % 200 < 120, "human", "robot"),
            "deviation": rng.uniform(0.0, 20.0, n).round(2),
            "x": np.cumsum(rng.uniform(1.0, 4.0, n)).round(2),
            "y": rng.normal(size=n).round(2),
            "v": rng.uniform(0.2, 0.6, n).round(3),
            "w": rng.normal(0.0, 20.0, n).round(2),
        }
    )


def lab_sessions():
    """Return the sessions of two people in a lab's folder, read by its recipe."""
    with tempfile.TemporaryDirectory() as place:
        recipe = Path(place, "lab.toml")
        recipe.write_text(RECIPE, encoding="utf-8")
        for person in (1, 2):
            lab_log(person).to_csv(Path(place, f"p{person}.csv"), index=False)
        return list(tl.read_sessions(place, recipe=recipe))


def read_back(ending):
    """Return the first minute of the pilot, written in a format and read again."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place, f"run{ending}")
        tl.write_session(pilot().between(500.0, 560.0), path)
        return tl.read_session(path).table()


def draft():
    """Return what the draft of a recipe says of each column of a lab's log."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place, "p1.csv")
        lab_log(1).to_csv(path, index=False)
        text = tl.draft_recipe(path, Path(place, "p1.toml")).read_text(encoding="utf-8")
        columns = tomllib.loads(text)["columns"]
    return {"name": list(columns), "rule": [str(rule) for rule in columns.values()]}


def flown():
    """Return a flight with commands of human, autopilot and ideal controller."""
    t = 0.1 * np.arange(300)
    frame = pd.DataFrame({"mode": 0.6, "path_error": 0.02 * (1.0 + np.sin(t))})
    for axis, phase in (("x", 0.0), ("y", 1.0)):
        frame[f"u_h_{axis}"] = np.sin(t + phase)
        frame[f"u_i_{axis}"] = np.sin(t + phase + 0.1)
        frame[f"u_a_{axis}"] = np.sin(t + phase + 0.2)
        frame[f"reference_{axis}"] = np.cos(t + phase)
        frame[f"robot_{axis}"] = np.cos(t + phase) + 0.01 * np.sin(7.0 * t)
    metadata = tl.Metadata(participant="1", condition="M", synthetic=True)
    return tl.Session(frame.set_index(pd.Index(t, name="t")), metadata)


def flight_performance(measure):
    """Return performance of the flight by a measure."""
    ranges = {"e_max": 0.1, "u_max": 2.0, "axes": "xy"}
    return flown().with_performance(measure=measure, window=5.0, **ranges).table()


def trials():
    """Return the tracking errors of three trials of a block, of which the first does not count."""
    about = {"autonomy": 0.6, "block": 1, "training": False}
    flights = [flown().between(0.0, stop) for stop in (5.0, 10.0, 20.0)]
    return tl.sessions.tracking_error(
        flight.with_metadata(**about, trial=trial) for trial, flight in enumerate(flights)
    )


def measures():
    """Return the parts that performance is made of."""
    speed = np.linspace(0.0, 0.5, 200)
    error = np.linspace(0.0, 3.0, 200)
    metrics = tl.sessions.metrics
    return {
        "goal_speed": metrics.goal_speed(0.1 * speed, error, 0.1),
        "manoeuvring": metrics.manoeuvring(speed, np.sin(error), error),
        "nearness": metrics.nearness(error, 2.0),
        "window_mean": metrics.window_mean(speed, 0.1, 3.0),
        "command_quality": metrics.command_quality(speed[:, None], error[:, None], 3.0),
    }


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
    """Return the table of a campaign that is written to a folder and read from it."""

    def task(x, seed):
        return {"y": np.random.default_rng(seed).normal() + x}

    with tempfile.TemporaryDirectory() as folder:
        tl.run_campaign(task, tl.parameter_grid(x=range(20)), seed=3, n_jobs=1, out=folder)
        return tl.read_campaign(folder)


def sensitivity():
    """Return Sobol indices of a product."""

    def task(x, y, seed):
        return {"z": x + 0.1 * y * x}

    table = tl.sobol_indices(task, {"x": (0.0, 1.0), "y": (0.0, 1.0)}, n=64, n_jobs=1).table()
    return table[["result", "parameter", "first_order", "total"]]


def corrections():
    """Return one step of the threshold corrector."""
    corrector = tl.ThresholdCorrector(model(), target=(0.05, 0.4), horizon=100)
    plan = corrector.step(r=0.6, p_r=0.3, lower=0.0, upper=0.35, mode=1)
    table = plan.table()
    return [*table["lower"], *table["upper"], plan.cost]


def printed_numbers():
    """Return what printed statistics allow; which data are found depends on the processor."""
    return tl.feasibility(tl.published_studies()["uav.tlx"]).table()


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
    """Return the coefficients of a logistic mixed model."""
    trials = counts().loc[lambda f: f.index.repeat(f["tried"])]
    rank = trials.groupby(["subject", "condition"]).cumcount()
    trials["success"] = (rank < trials["successes"]).astype(int)
    fit = tl.ordinal_model(trials, dv="success", within="condition", subject="subject")
    return estimates(fit.coefficients_table(), "estimate", "se")


def ratings():
    """Return the coefficients of a cumulative-link mixed model of synthetic ratings."""
    frame = scores(15, 3)
    frame["rating"] = np.clip(np.round(2.0 + frame.pop("score")), 1, 4).astype(int)
    columns = {"within": "condition", "subject": "subject"}
    fit = tl.ordinal_model(frame, dv="rating", **columns)
    return estimates(fit.coefficients_table(), "estimate", "se")


def posterior():
    """Return draws of the pilot's parameters from ten minutes."""
    return tl.sample_posterior(pilot().between(500.0, 1100.0), n=200)


def population():
    """Return what two short logs say of two people and of a new one."""
    people = {"A": pilot().between(0.0, 600.0), "B": pilot().between(500.0, 1100.0)}
    return estimates(tl.fit_population(people, n=200).table(), "mean", "sd")


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
    table = tl.fit_trust(tl.read_people("hybrid_vr"), "asymmetric").table()
    table["standard_error"] = (table["ci_high"] - table["ci_low"]) / 3.92
    return table[["parameter", "estimate", "standard_error"]]


def team():
    """Return where the robots of a team drive, a column a robot and axis."""
    run = tl.simulate_team(nx.cycle_graph(4), seed=0, performance="random")
    return pd.DataFrame(run.positions.reshape(len(run.positions), -1))


def simulated_study(testbed, n, conditions):
    """Return the measures of a virtual study."""
    return tl.virtual_study(n=n, testbed=testbed, conditions=conditions, laps=1, seed=0).measures


def ease():
    """Return the scores of a questionnaire."""
    scale = Questionnaire("ease", items=[f"q{i}" for i in range(5)], low=1, high=7)
    return tl.score(items().assign(person=range(20)), scale, subject="person").table()


CASES = {
    # models
    "published_models": printed_models,
    "published_table": lambda: tl.published_table("2.1"),
    "RobotModel": performance,
    "HumanModel": utilization,
    "TscModel": lambda: model().simulate(mode(), r0=0.3, p_r0=0.3),
    "TrustModel": trust_in_time,
    "LogisticScaling": scales,
    "TransferFunction": vehicles,
    # campaign
    "run_campaign": campaign,
    "parameter_grid": lambda: pd.DataFrame(list(tl.parameter_grid(x=[1, 2], y=["a", "b", "c"]))),
    "parameter_draws": lambda: pd.DataFrame(
        tl.parameter_draws(50, seed=1, beta=(0.6, 0.8), laps=[4, 8])
    ),
    "sobol_indices": sensitivity,
    # sessions
    "read_session": lambda: pilot().table(),
    "example": lambda: described([tl.sessions.example("pilot")]),
    "read_parquet": lambda: described([tl.read_session(SESSIONS / "participant_2.parquet")]),
    "read_sessions": lambda: described(lab_sessions()),
    "read_frame": lambda: tl.read_frame(pilot().table()).between(100.0, 200.0).table(),
    "write_csv": lambda: read_back(".csv"),
    "write_parquet": lambda: read_back(".parquet"),
    "write_mcap": lambda: read_back(".mcap"),
    "draft_recipe": draft,
    "vocabulary": tl.sessions.vocabulary,
    "with_performance": lambda: lab_sessions()[0].with_performance(window=10.0).table(),
    "with_performance_uav": lambda: flight_performance("uav_tracking"),
    "with_performance_mixed": lambda: flight_performance("mixed_initiative"),
    "metrics": measures,
    "tracking_error": trials,
    # identification
    "fit_tsc": lambda: estimates(tl.fit_tsc(pilot()).table(), "value", "stderr"),
    "fit_robot": lambda: estimates(tl.fit_robot(pilot()).table(), "value", "stderr"),
    "fit_human": lambda: estimates(tl.fit_human(pilot()).table(), "value", "stderr"),
    "fit_robot_by_regression": lambda: estimates(
        tl.arx(pilot()["p_r"], pilot()["mode"] * pilot()["p_h"], intercept=True).table(),
        "value",
        "stderr",
    ),
    "fit_transfer_function": transfer_function,
    "sample_posterior": lambda: estimates(posterior().table(), "mean", "sd"),
    "fit_population": population,
    # allocation
    "simulate_allocation": lambda: tl.simulate_allocation(model(), 0.0, 0.35, steps=20_000),
    "threshold_limits": limits,
    "steady_state_bounds": lambda: tl.steady_state_bounds(model(), 0.0, 0.35).table(),
    "invariant_bounds": lambda: tl.invariant_bounds(model(), 0.0, 0.3).table(),
    "limit_cycle": lambda: tl.limit_cycle(model(), 0.0, 0.3).table(),
    "incentive_bounds": lambda: tl.incentive_bounds(0.7, 0.3, 1e-5, model()),
    "choose_thresholds": thresholds,
    "choose_thresholds_of_a_posterior": probable_thresholds,
    "estimate_thresholds": lambda: tl.estimate_thresholds(driven(), model()).table(),
    "followed_suggestions": lambda: tl.followed_suggestions(driven("C2")),
    "optimal_allocation": optimum,
    "ThresholdCorrector": corrections,
    # trust
    "fit_trust": trust,
    # teleoperation and operators
    "channel_run": channel,
    "simulate_teleoperation": lambda: tl.simulate_teleoperation(
        "TMIG", seed=0, duration=5.0
    ).table(),
    "teleoperation_measures": lambda: tl.teleoperation_measures(flights()),
    "simulated_answers": lambda: list(tl.simulated_answers(flights()[1], seed=0).values()),
    "simulate_team": team,
    # testbeds and studies
    "run_condition": lambda: driven().table(),
    "virtual_study": lambda: simulated_study("ground_robot", 3, ["C1", "C3", "C5"]),
    "virtual_study_uav": lambda: tl.virtual_study(n=10, testbed="uav_following", seed=0).measures,
    "latin_square_design": lambda: tl.latin_square_design(["A", "B", "C", "D"], 12, seed=0).table(),
    "score": ease,
    "cronbach_alpha": lambda: [tl.cronbach_alpha(items()).alpha],
    "repeated_measures": lambda: tl.repeated_measures(scores(), **WITHIN).table(),
    "pairs": lambda: tl.repeated_measures(scores(), **WITHIN).pairs(),
    "paired_t_test": lambda: tl.paired_t_test(scores(12, 2), **WITHIN).table(),
    "bayes_factor": lambda: tl.bayes_factor(scores(), **WITHIN),
    "equivalence": lambda: tl.equivalence(scores(), **WITHIN, bound=0.8),
    "mixed_model": lambda: tl.mixed_model(scores(), **WITHIN).table(),
    "formula_model": lambda: estimates(
        tl.formula_model("score ~ condition", scores(), groups="subject").coefficients_table(),
        "estimate",
        "se",
    ),
    "ordinal_model_of_two_categories": logistic,
    "ordinal_model": ratings,
    "order_effects": orders,
    "power_analysis": power,
    "smallest_n": least_n,
    # reproduction
    "feasibility": printed_numbers,
    "audit": tl.audit,
    "printed_effects": tl.printed_effects,
    "model_effects": tl.model_effects,
    "simulated_effects": lambda: tl.simulated_effects(
        {"attention_cost": 0.05}, n=4, seed=0, only="table_2.6", n_jobs=1
    ),
}
