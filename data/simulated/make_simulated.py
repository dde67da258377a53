"""
Write the simulations that the reports only read, as they take minutes: `make simulated`.

The reports simulate a sample of every table again and compare. `make_simulated.py guidance` makes
one of them.
"""

import itertools
import json
import sys
import warnings
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import networkx as nx
import numpy as np
import pandas as pd
from scipy.signal import lfilter

import trustlab as tl
from trustlab.models.digest import room_digest
from trustlab.reproduction import read_calibration
from trustlab.reproduction.calibration import TELEOPERATOR_PRIORS
from trustlab.reproduction.reconstruction.contradictions import ADJUSTMENTS
from trustlab.sessions.metrics import window_mean
from trustlab.teleoperation import (
    SCHEMES,
    STUDIES,
    Guidance,
    GuidanceBudget,
    TeamRobot,
    TeamSettings,
    TeamTrial,
)
from trustlab.testbeds import TeleoperatorPopulation
from trustlab.testbeds.uav_tracking import TASKS

HERE = Path(__file__).resolve().parent
SEED = 0


def adjustments() -> pd.DataFrame:
    """Which adjustments of p-values the printed numbers of each study can belong to."""
    rows = []
    for name, study in tl.published_studies().items():
        for p_adjust in ADJUSTMENTS:
            found = tl.feasibility(study, p_adjust, SEED).rest_feasible
            rows.append((name, p_adjust, "found" if found else "not found"))
    return pd.DataFrame(rows, columns=["study", "p_adjust", "status"])


def reconstructions() -> pd.DataFrame:
    """
    Data with the printed statistics of each study, not measurements, reconstructed with several
    seeds. Another processor finds other data that fit as well.
    """
    frames = []
    for name, study in tl.published_studies().items():
        for seed in range(SEED, SEED + 5 if name in SEVERAL else SEED + 1):
            data = tl.reconstruct(study, seed, p_adjust="bonferroni").round(9)
            frames.append(data.assign(study=name, seed=seed))
    return pd.concat(frames)[["study", "seed", "subject", "condition", "value"]]


# Studies of which the reports need more than one reconstruction: those that lack a printed mean,
# and the one by which the report on virtual studies asks how much the reconstruction matters.
SEVERAL = ("uav.satisfaction", "uav.trust", "uav.tlx")


# Of the longest time constant: how many pass before extremes are taken, and while they are, and how
# many at most where it takes so long to switch.
SETTLING, RECORDED, LONGEST = 12.0, 5.0, 200.0

# By how much a bound must be exceeded to count: more than what is left of the transient, e⁻¹².
TOLERANCE = 1e-5

TESTED = (
    "r ≥ r_l (2.33)",
    "r ≤ r_u (2.33)",
    "P_r (2.15)",
    "TSC (2.14)",
    "switching (Theorem 1)",
    "r, invariant_bounds",
    "P_r, invariant_bounds",
)


def random_set(rng: np.random.Generator) -> tuple[tl.TscModel, float, float]:
    """
    Draw a model and thresholds between its limits, at least .02 apart.

    Time constants are log-uniform, 50 to 2000 samples for utilization and 20 to 630 for robot
    performance; ranges of performance are 2 to 50 % (human) and 10 to 100 % (robot) of their least
    values.
    """
    while True:
        h_min, r_min = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.4)
        h_max = h_min * (1.0 + rng.uniform(0.02, 0.5))
        r_max = r_min * (1.0 + rng.uniform(0.1, 1.0))
        a, beta = 1.0 - 10.0 ** rng.uniform(-3.3, -1.7), rng.uniform(0.3, 0.95)
        robot = tl.RobotModel(1.0 - 10.0 ** rng.uniform(-2.8, -1.3), r_min, r_max, h_max)
        model = tl.TscModel(robot, tl.HumanModel(a, beta, h_min, h_max))
        limits = tl.threshold_limits(model, 0.0)
        if limits.feasible:
            lower, upper = np.sort(rng.uniform(limits.lower, limits.upper, 2))
            if upper - lower > 0.02:
                return model, float(lower), float(upper)


def steady_run(
    model: tl.TscModel, pair: tuple, r0: float, settling: int, recorded: int, returns: int = 0
) -> pd.DataFrame:
    """Return the last samples, and the one before, after so many returns to manual control."""
    steps = settling + recorded
    while True:
        run = tl.simulate_allocation(model, *pair, steps, r0)
        back = np.flatnonzero(np.diff(run["mode"].to_numpy()) > 0.0) + 1
        if back.size >= returns:
            first = max(settling, back[returns - 1]) if returns else settling
            if first + recorded <= steps:
                return run.iloc[first - 1 : first + recorded]
        steps *= 2


def outside(run: pd.DataFrame, bounds) -> list[bool]:
    """Say whether a run leaves bounds: r below, r above, P_r, TSC; its first sample is before."""
    left = []
    for name in ("r", "p_r", "tsc"):
        values = run[name].to_numpy()[1:]
        left.append(values.min() < getattr(bounds, f"{name}_low") - TOLERANCE)
        left.append(values.max() > getattr(bounds, f"{name}_high") + TOLERANCE)
    return [*left[:2], left[2] or left[3], left[4] or left[5]]


def failures(sets: int = 20_000, seed: int = SEED, invariant: int = 2_000) -> pd.DataFrame:
    """
     How often random parameter sets violate the printed bounds, and those of `invariant_bounds`
    . All thresholds lie within (2.9)-(2.10) with the δ_Ph of the set's own steady
     motion, whose δ_TSC the bounds take; "switching" is violated by motions that stay in one mode.
    """
    root = np.random.SeedSequence(seed)
    left = np.zeros(len(TESTED), int)
    counted = 0
    while counted < sets:
        rng = np.random.default_rng(root.spawn(1)[0])
        model, *pair = random_set(rng)
        longest = 1.0 / (1.0 - max(model.human.a, model.robot.a))
        recorded = int(RECORDED * longest)
        start = model, pair, rng.random(), int(SETTLING * longest)
        run = steady_run(*start, recorded)
        # Less than a cycle may hide the largest steps; a motion that stays in one mode has none.
        while np.count_nonzero(np.diff(run["mode"]) > 0.0) < 2 and recorded < LONGEST * longest:
            recorded *= 2
            run = steady_run(*start, recorded)
        change = run[["p_r", "p_h"]].diff().abs().max()
        if not tl.threshold_limits(model, change["p_h"]).contains(*pair):
            continue
        left[:4] += outside(
            run, tl.steady_state_bounds(model, *pair, model.delta(change["p_r"], change["p_h"]))
        )
        left[4] += np.ptp(run["mode"].to_numpy()) == 0.0
        if counted < invariant:
            bounds = tl.invariant_bounds(model, *pair, cells=16)
            below, above, p_r, _ = outside(steady_run(*start, recorded, bounds.cycles), bounds)
            left[5:] += below or above, p_r
        counted += 1
    counts = {"bound": TESTED, "sets": [sets] * 5 + [invariant] * 2, "left": left}
    return pd.DataFrame(counts).assign(share=lambda table: table["left"] / table["sets"])


# Keywords of `simulate_teleoperation` by the name under which they are shown.
GUIDANCES: dict[str, dict[str, str]] = {
    "through the channel, guard off": Guidance("through_channel", "off"),
    "through the channel": Guidance("through_channel", "cancel"),
    "at the operator": Guidance(),
}


def guidance(operators: int = 30) -> pd.DataFrame:
    """
    Simulated operators of the main study in every scheme under every guidance.

    Every operator has one path, one series of losses of the target, delays and noise, the same in
    all runs.
    """
    population = TeleoperatorPopulation("main")
    people = [population.person(row) for row in population.draw(operators, SEED).to_dict("records")]
    parts = []
    for name, design in GUIDANCES.items():
        for scheme in SCHEMES:
            for number, person in enumerate(people):
                stream = np.random.SeedSequence(SEED, spawn_key=(number,))
                run = tl.simulate_teleoperation(scheme, person, seed=stream, guidance=design)
                measures = tl.teleoperation_measures(run)
                parts.append(measures.assign(guidance=name, scheme=scheme, participant=number + 1))
    wanted = ["guidance", "scheme", "participant", "tracking_error", "guidance_felt"]
    wanted += ["energy_target", "energy_port_min", "guarded"]
    return pd.concat(parts, ignore_index=True)[wanted]


def checks() -> pd.DataFrame:
    """
    Printed effects beside 40 studies of each testbed simulated under the posterior, as fitted and
    with what it says of deciding put aside; needs `make calibration`.
    """
    tables = {}
    for name in ("ground_robot", "uav"):
        found = read_calibration(name, HERE.parent / "calibration").within_reach()
        free = found.posterior.assign(attention_cost=0.0)
        people = {
            "deciding is free": free,
            "free, trust too high by 0.6": free.assign(trust_bias=0.6),
            "fitted": found.posterior,
        }
        for assumed, each in people.items():
            tables[name, assumed] = found.checks(40, seed=SEED + 1, people=each, n_jobs=2)
    return pd.concat(tables, names=["study", "assumed"]).reset_index(["study", "assumed"])


# Standard deviation of noise [m/s] per sample, its time constant [s], and the window of means [s].
RECORDED_NOISE = {"white": (0.0, 0.0), "slow": (5.0, 0.0), "slow, means over 100 s": (5.0, 100.0)}
DEVIATION = 0.005


def recorded_session(
    tsc: tl.TscModel, minutes: float, switches: int, noise: str, rng: np.random.Generator
) -> tl.Session:
    """Return a log at 10 Hz whose mode changes at random times, at least 20 s apart."""
    size = round(600 * minutes)
    free = np.sort(rng.uniform(0.0, size - 200.0 * (switches + 1), switches))
    times = free + 200.0 * np.arange(1, switches + 1)
    mode = (np.searchsorted(times, np.arange(size), side="right") % 2 == 0) * 1.0
    run = tsc.simulate(mode, rng.uniform(0.02, 0.3), tsc.robot.p_min)
    seconds, window = RECORDED_NOISE[noise]
    memory = np.exp(-0.1 / seconds) if seconds else 0.0
    columns = {"mode": mode}
    for name in ("p_h", "p_r"):
        shocks = DEVIATION * np.sqrt(1.0 - memory**2) * rng.standard_normal(size)
        shocks[0] = DEVIATION * rng.standard_normal()
        values = run[name].to_numpy() + lfilter([1.0], [1.0, -memory], shocks)
        columns[name] = window_mean(values, 0.1, window) if window else values
    frame = pd.DataFrame(columns, index=pd.Index(0.1 * np.arange(size), name="t"))
    return tl.Session(frame, tl.Metadata(synthetic=True, more={"performance_window": window}))


def decided(
    minutes: float, switches: int, noise: str, participant: str, seed: np.random.SeedSequence
) -> dict:
    """Return what one simulated log tells of β, and whether thresholds chosen from it are safe."""
    tsc = tl.published_models()[participant]
    session = recorded_session(tsc, minutes, switches, noise, np.random.default_rng(seed))
    posterior = tl.sample_posterior(session, n=500)
    beta = posterior.table().loc["human_beta"]
    with warnings.catch_warnings():  # where none are offered
        warnings.simplefilter("ignore")
        choice = tl.choose_thresholds(posterior, points=10)
    cycle = tl.limit_cycle(tsc, choice.lower, choice.upper)
    return {
        "width": beta["ci_high"] - beta["ci_low"],
        "covered": bool(beta["ci_low"] <= tsc.human.beta <= beta["ci_high"]),
        "probability": choice.probability,
        "offered": choice.offered,
        "safe": cycle.encloses_beta,
    }


def recording() -> pd.DataFrame:
    """
    What logs of several lengths tell of the printed people, and whether thresholds chosen from
    them are safe (docs/how_to/logs.md).
    """
    cells = tl.parameter_grid(
        minutes=[5, 10, 20, 40],
        switches=[3, 9],
        noise=list(RECORDED_NOISE),
        participant=["pilot", "1", "2", "3", "4", "5"],
    )
    rows = tl.run_campaign(decided, cells, seed=SEED, n_jobs=1)
    names = ["minutes", "switches", "noise", "participant", "width", "covered", "probability"]
    return rows[[*names, "offered", "safe"]]


def recording_summary() -> pd.DataFrame:
    """The table of docs/how_to/logs.md, from recording.csv."""
    rows = pd.read_csv(HERE / "recording.csv")
    rows["safe_offered"] = rows["safe"] & rows["offered"]
    rows["noise"] = pd.Categorical(rows["noise"], list(RECORDED_NOISE))
    groups = rows.groupby(["noise", "minutes", "switches"], observed=True)
    table = pd.DataFrame(
        {
            "width of β's interval": groups["width"].median().map("{:.2f}".format),
            "probability of the best thresholds": groups["probability"]
            .median()
            .map("{:.2f}".format),
            "logs": groups.size(),
            "thresholds offered": groups["offered"].sum(),
            "of these safe": groups["safe_offered"].sum(),
        }
    )
    return table.reset_index()


LAWS = {"proportional": {}, "crossover": {"adapting": 1.0}}


def tracking_errors(study: str, schemes: list[str], person: dict, seed, task=None) -> dict:
    """Return the mean tracking error [m] of one operator under every scheme, on the same path."""
    operator = TeleoperatorPopulation.person(person)
    return {
        scheme: tl.simulate_teleoperation(scheme, operator, study, seed=seed, task=task)[
            "path_error"
        ].mean()
        for scheme in schemes
    }


def compensation() -> pd.DataFrame:
    """
    Schemes of the main study by how much operators make up for the channel's scale, and by how
    often autonomy fails.
    """
    whole = 0.5 / STUDIES["main"].scattering.beta_min ** 0.5
    kinds = {f"factor {f:.3g}": {"compensation": f} for f in (1.0, 1.25, 1.6, whole)}
    kinds["adapting"] = {"adapting": 1.0}
    rows = []
    for every in (5.0, 15.0, 60.0, 600.0):
        task = replace(TASKS["main"], failure_every=every)
        for kind, assumptions in kinds.items():
            people = TeleoperatorPopulation("main").draw(30, SEED, assumptions).to_dict("records")
            for person, seed in zip(people, np.random.SeedSequence(SEED).spawn(30), strict=True):
                errors = tracking_errors("main", ["M", "MMI", "OMI", "TMIG"], person, seed, task)
                row = {"failure_every": every, "operator": kind}
                rows.append(row | {"participant": person["participant"]} | errors)
    return pd.DataFrame(rows)


# Half the width of the picture [m], where it is bounded: drawn on a logarithmic scale.
PICTURES = {"preliminary": (1.0, 12.0), "main": (0.25, 3.0)}
FLOWN = {"preliminary": ["M", "MI", "MMI", "TMIG", "TMIS"], "main": ["M", "MI", "MMI", "TMIG"]}


def orders() -> pd.DataFrame:
    """
    Which simulated operators bring the printed order of schemes about.

    For both studies and laws: operators as shipped; with assumptions drawn from the priors of the
    calibration, for each operator anew; and likewise where the picture shows a part only.
    """
    rows = []
    for (study, schemes), law in itertools.product(FLOWN.items(), LAWS):
        for kind, number in {"as shipped": 30, "assumed": 100, "assumed, picture": 100}.items():
            rng = np.random.default_rng([SEED, len(rows)])
            seeds = np.random.SeedSequence(SEED).spawn(number)
            for i, seed in enumerate(seeds):
                assumptions, task = LAWS[law], TASKS[study]
                if kind != "as shipped":
                    drawn = {k: rng.uniform(*ends) for k, ends in TELEOPERATOR_PRIORS.items()}
                    assumptions = drawn | {"adapting": float(law == "crossover")}
                if "picture" in kind:
                    task = replace(task, view=np.exp(rng.uniform(*np.log(PICTURES[study]))))
                population = TeleoperatorPopulation(study)
                person = population.draw(i + 1, SEED, assumptions).to_dict("records")[-1]
                row = {"study": study, "law": law, "operators": kind, "participant": i + 1}
                row |= assumptions | {"view": task.view}
                rows.append(row | tracking_errors(study, schemes, person, seed, task))
    return pd.DataFrame(rows)


FELT = Guidance(budget=GuidanceBudget(energy=0.2, power=0.5))


def command_gain(run: tl.Session) -> float:
    """Return the command per metre of tracking error [1/s], by least squares."""
    command, place, reference = (
        run.data[[f"{stem}_{axis}" for axis in "xyz"]].to_numpy()
        for stem in ("r_m", "robot", "reference")
    )
    error = reference - place
    return float((command * error).sum() / (error**2).sum())


def flown_guided(scheme: str, person: dict, stiffness: float, seed) -> dict:
    """
    Return tracking errors without guidance, with it, and without it at the command gain that it
    gave: the operator's own command is scaled until both gains are equal.
    """
    operator = TeleoperatorPopulation.person(person)

    def fly(k_ffa, factor=1.0):
        study = replace(STUDIES["main"], k_ffa=k_ffa)
        hand = replace(operator, compensation=factor * operator.compensation)
        return tl.simulate_teleoperation(scheme, hand, study, seed=seed, guidance=FELT)

    without, guided = fly(0.0), fly(stiffness)
    goal = command_gain(guided)
    factor, equal = 1.0, without
    for _ in range(8):
        factor *= goal / command_gain(equal)
        equal = fly(0.0, factor)
        if abs(command_gain(equal) / goal - 1.0) < 1e-3:
            break
    measures = tl.teleoperation_measures([without, guided, equal])
    row = dict(zip(("without", "guided", "equal_gain"), measures["tracking_error"], strict=True))
    row |= {"felt_without": measures["guidance_felt"][0], "felt": measures["guidance_felt"][1]}
    row |= {"given_out": -measures["energy_port_min"][1], "factor": factor}
    return row | {"gain": goal, "gain_apart": command_gain(equal) / goal - 1.0}


def felt() -> pd.DataFrame:
    """Guidance with a budget against none, also at equal command gain."""
    rows = []
    cells = itertools.product(LAWS, ("M", "TMIG"), (6.0, 20.0))
    for law, scheme, stiffness in cells:
        people = TeleoperatorPopulation("main").draw(30, SEED, LAWS[law]).to_dict("records")
        for person, seed in zip(people, np.random.SeedSequence(SEED).spawn(30), strict=True):
            row = {"law": law, "scheme": scheme, "k_ffa": stiffness}
            row |= {name: person[name] for name in ("participant", "skill")}
            rows.append(row | flown_guided(scheme, person, stiffness, seed))
    return pd.DataFrame(rows)


# One robot of four is faulty: its fault, how near the goal counts as there [m], and the measure of
# performance that trust follows.
FAULTS = {
    "deaf": (TeamRobot(loss=1.0), 1e-3, "motion"),
    "slow": (TeamRobot(speed=0.5), 1e-3, "motion"),
    "drifting": (TeamRobot(drift=0.02), 0.2, "motion"),
    "deaf, trust at random": (TeamRobot(loss=1.0), 1e-3, "random"),
}
LONGEST = 200.0


def time_with_fault(fault: str, policy: str, number: int, seed: np.random.SeedSequence) -> dict:
    """Return when a team with one faulty robot is at the goal [s], `LONGEST` where it is not."""
    robot, near, performance = FAULTS[fault]
    faulty = int(np.random.default_rng([SEED, number]).integers(4))
    members = tuple(robot if i == faulty else TeamRobot() for i in range(4))
    run = tl.simulate_team(
        nx.cycle_graph(4),
        policy,
        (1.0, 2.0, 0.5),
        number,  # the same start for every policy, whatever the seed of the campaign
        LONGEST,
        settings=TeamSettings(robots=members),
        trial=TeamTrial(0.02, record_every=0.1, tolerance=near),
        performance=performance,
    )
    return {"time": run.time_to_goal if run.converged else LONGEST}


def trust_value() -> pd.DataFrame:
    """When teams with one faulty robot are at the goal, under three policies."""
    cells = [
        {"fault": fault, "policy": policy, "number": number}
        for fault in FAULTS
        for policy in ("most_trusted", "sequence", "random")
        for number in range(200 if fault == "deaf" else 40)
    ]
    rows = tl.run_campaign(time_with_fault, cells, seed=SEED, n_jobs=1)
    return rows[["fault", "policy", "number", "time"]]


# People who rated their trust after each of ten trials.
RATED = ("hybrid_vr", "hybrid_real")
# Models of trust that simulated people follow.
FOLLOWED = ("performance", "asymmetric")
# Models in the loops; None is (3.2), or (4.1), as printed.
PRINTED = "printed"
DRIVERS = (None, "performance", "series", "asymmetric", "optimo")


def simulated_people(name: str) -> tl.trust.Panel:
    """Return the people of hybrid_vr with ratings that follow a model fitted to them."""
    panel = tl.read_people("hybrid_vr")
    model = tl.fit_trust(panel, name, criterion="free").model
    drawn = tl.trust.simulate_ratings(model, panel, np.random.default_rng([SEED, len(name)]))
    return replace(drawn, source=f"simulated: {name}", cautions=("Nobody rated this.",))


def scored(panel: tl.trust.Panel, criterion: str, models=None) -> pd.DataFrame:
    """Return the scores of models on people left out, with paired differences from (3.2)."""
    result = tl.compare_trust_models(panel, models, criterion=criterion, seed=SEED)
    scores = result.scores.melt(["split", "model", "person"], var_name="measure", value_name="mean")
    means = scores.groupby(["split", "model", "measure"])["mean"].mean().reset_index()
    pairs = result.paired().rename(columns={"people": "n"})
    return means.merge(pairs, on=["split", "model", "measure"], how="left")


# OPTIMo takes longer than all others together.
QUICK = [name for name in (*tl.trust.MODELS, *tl.trust.BASELINES) if name != "optimo"]


def trust_scores() -> pd.DataFrame:
    """Models of trust on real people, and on simulated ones."""
    tables = {}
    for name in RATED:
        for criterion in ("step", "free"):
            tables[name, criterion] = scored(tl.read_people(name), criterion)
    for name in ("trust_transfer", "btm"):
        tables[name, "step"] = scored(tl.read_people(name), "step", QUICK)
    for name in FOLLOWED:
        tables[f"simulated: {name}", "free"] = scored(simulated_people(name), "free", QUICK)
    return pd.concat(tables, names=["people", "criterion"]).reset_index(["people", "criterion"])


def trust_recovery() -> pd.DataFrame:
    """Which model is chosen where people follow which, 3 panels of each."""
    shares = tl.trust.recover_trust_models(tl.read_people("hybrid_vr"), n=3, seed=SEED)
    return shares.reset_index()


def residuals(panel: tl.trust.Panel, name: str) -> pd.DataFrame:
    """Return each person's mean rating minus that of a free run, by fifths of successes so far."""
    model = tl.fit_trust(panel, name, criterion="free").model
    left = panel.ratings[:, 1:] - tl.trust.predict(model, panel, free=True).mean
    share = np.cumsum(panel.events.p_r >= 0.5, axis=1) / np.arange(1, panel.trials + 1)
    fifth = np.digitize(share, [0.2, 0.4, 0.6, 0.8], right=True)
    person = np.repeat(np.arange(len(panel)), panel.trials)
    table = {"fifth": fifth.ravel(), "person": person, "residual": left.ravel()}
    return pd.DataFrame(table).groupby(["fifth", "person"], as_index=False).mean()


def trust_residuals() -> pd.DataFrame:
    """What models of trust, fitted for free runs, leave of real people's ratings."""
    cases = itertools.product(RATED, ("performance", "asymmetric", "series", "optimo"))
    tables = {(people, name): residuals(tl.read_people(people), name) for people, name in cases}
    return pd.concat(tables, names=["people", "model"]).reset_index(["people", "model"])


@lru_cache
def driver(name: str | None, rate: float) -> tl.trust.TrustInLoop | None:
    """
    Return a model fitted to hybrid_vr; a trial lasts until (3.2), fitted likewise, is as fast as
    the printed rate [1/s].
    """
    if name is None:
        return None
    panel = tl.read_people("hybrid_vr")
    printed, model = (
        tl.fit_trust(panel, each, criterion="free").model for each in ("performance", name)
    )
    return tl.trust.TrustInLoop(model, every=printed.a / rate)


def trust_effects() -> pd.DataFrame:
    """Printed effects of Chapter 3 under other models of trust, 20 operators."""
    tables = {
        (name or PRINTED, study): tl.simulated_effects(
            n=20, seed=SEED, only=study, trust=driver(name, 0.2), n_jobs=1
        )
        for name in DRIVERS
        for study in ("table_3.1", "teleop")
    }
    return pd.concat(tables, names=["trust", "study"]).reset_index(["trust", "study"])


def arrival(policy: str, name: str | None, number: int) -> dict[str, float]:
    """Return when four robots that lose packets are at the goal [s]; 300 if not before."""
    loss = np.random.default_rng([SEED, 11, number]).uniform(0.0, 1.0, 4)
    run = tl.simulate_team(
        nx.cycle_graph(4),
        policy,
        seed=number,
        duration=300.0,
        settings=TeamSettings(robots=tuple(TeamRobot(loss=share) for share in loss)),
        trial=TeamTrial(0.02, record_every=0.1),
        trust=driver(name, 0.1),
    )
    leaders = run.data["number"].to_numpy().astype(int)
    return {
        "arrival": run.time_to_goal if run.converged else 300.0,
        "switches": len(run.switches),
        "loss": float(loss[leaders].mean()),
        "least_loss": float(loss.min()),
    }


def trust_teams() -> pd.DataFrame:
    """40 teams led by the most trusted robot under other models of trust."""
    cases = [("sequence", None), ("random", None), *(("most_trusted", name) for name in DRIVERS)]
    return pd.DataFrame(
        {"policy": policy, "trust": name or PRINTED, "team": number} | arrival(policy, name, number)
        for policy, name in cases
        for number in range(40)
    )


TABLES = {
    adjustments: "reproduction",
    reconstructions: "reproduction",
    failures: "allocation",
    guidance: "testbeds",
    trust_value: "testbeds",
    compensation: "testbeds",
    orders: "testbeds",
    felt: "testbeds",
    checks: "reproduction",
    recording: "allocation",
    recording_summary: "allocation",
    trust_scores: "trust",
    trust_residuals: "trust",
    trust_recovery: "trust",
    trust_effects: "reproduction",
    trust_teams: "testbeds",
}
"""Each table, and the lowest room that it comes from."""

if __name__ == "__main__":
    for make, room in TABLES.items():
        if sys.argv[1:] in ([], [make.__name__]):
            make().to_csv(HERE / f"{make.__name__}.csv", index=False)
            about = {
                "seed": SEED,
                "origin": make.__doc__.strip(),
                "source_digest": room_digest(room),
            }
            (HERE / f"{make.__name__}.json").write_text(
                json.dumps(about, indent=1) + "\n", encoding="utf-8"
            )
