"""An estimate in words and tables: from the search's numbers to a FitResult."""

from __future__ import annotations

import numpy as np
import pandas as pd

from trustlab.identification.fit_result import FitResult, RunFit
from trustlab.identification.greybox import Problem
from trustlab.identification.identifiability import HALF_WIDTH, HINTS, undetermined
from trustlab.identification.output_error import Estimate

__all__ = ["parameter_table", "result"]


def parameter_table(problem: Problem, found: Estimate) -> tuple[pd.DataFrame, pd.DataFrame]:
    """
    Return the shared parameters' table and covariance.

    Parameters
    ----------
    problem : Problem
        Structure and data.
    found : Estimate
        The estimate.

    Returns
    -------
    table : pandas.DataFrame
        Index `parameter`; columns value, stderr, status.
    covariance : pandas.DataFrame
        Of the estimated shared parameters.
    """
    names = list(problem.structure.shared)
    size = len(names)
    status = np.where(found.fixed, "fixed", np.where(found.at_bound, "at bound", "estimated"))[:size]
    stderr = np.where(status == "estimated", np.sqrt(np.abs(np.diag(found.covariance)[:size])), np.nan)
    index = pd.Index(names, name="parameter")
    table = pd.DataFrame(
        {"value": found.theta[:size], "stderr": stderr, "status": status.astype(object)}, index=index
    )
    kept = np.flatnonzero(status == "estimated")
    covariance = pd.DataFrame(
        found.covariance[np.ix_(kept, kept)], index=index[kept], columns=index[kept].rename(None)
    )
    return table, covariance


def _of_the_runs(problem: Problem) -> list[str]:
    """Say what a reader should know of the data themselves."""
    sentences = []
    people = {run.notes[0] for run in problem.runs}
    if len(people) > 1:
        sentences.append(
            f"{len(people)} participants share one set of parameters; fit them one by one unless that is meant."
        )
    measures = {run.notes[1] for run in problem.runs if run.notes[1]}
    if measures:
        sentences.append(
            f"Performance is measured over a moving window ({', '.join(sorted(measures))}): rises and decays quicker than the "
            "window are the window's own."
        )
    return sentences


def result(
    problem: Problem, found: Estimate, model: object, table: pd.DataFrame, covariance: pd.DataFrame
) -> FitResult:
    """
    Put an estimate, its model and its table of parameters into a FitResult.

    Parameters
    ----------
    problem : Problem
        Structure and data.
    found : Estimate
        The estimate.
    model : RobotModel, HumanModel or TscModel
        The model at the estimate.
    table : pandas.DataFrame
        Index `parameter`; columns value, stderr, status; statuses of weakly determined parameters are set here.
    covariance : pandas.DataFrame
        Covariance of the estimated parameters.
    """
    structure, table = problem.structure, table.copy()
    sentences = [f"Converged in {found.iterations} evaluations."]
    if not found.converged:
        sentences = [
            f"Stopped after {found.iterations} evaluations without reaching a minimum; do not use the numbers."
        ]
    success = found.converged
    for name in undetermined(problem, table):
        success = False
        value, stderr, status = table.loc[name, ["value", "stderr", "status"]]
        if status == "at bound":
            sentences.append(
                f"{name} ran into its bound at {value:.6g}: the fit is better beyond it, or these data do not determine it."
            )
        else:
            table.loc[name, "status"] = "weak"
            half = HALF_WIDTH * stderr
            hint = HINTS[name.removeprefix("human_").removeprefix("robot_")]
            sentences.append(
                f"{name} is hardly determined by these data ({value:.4g} ± {half:.2g}); {hint}, or fix it."
            )
    for name in structure.initial:
        first = len(structure.shared) + structure.initial.index(name)
        where = np.arange(first, found.theta.size, len(structure.initial))
        for bound, meaning in ((0.0, "a rested operator"), (1.0, "an operator at full load")):
            held = int((found.at_bound[where] & (found.theta[where] == bound)).sum())
            if held and name == "r0":
                sentences.append(f"{name} = {bound:g}, {meaning}, in {held} of {len(where)} run(s).")
    sentences += _of_the_runs(problem)
    if found.noise == "hac":
        sentences.append(
            f"Residuals are not white (Ljung–Box p = {found.whiteness_p:.2g}): standard errors allow for autocorrelation."
            if found.whiteness_p < 1e-3
            else "Standard errors allow for autocorrelated residuals."
        )
    elif found.whiteness_p < 1e-3:
        sentences.append(
            f"Residuals are not white (Ljung–Box p = {found.whiteness_p:.2g}): these standard errors are too small; "
            'use noise="hac".'
        )
    stderr = np.sqrt(np.where(found.fixed, np.nan, np.diag(found.covariance)))
    shared, own = len(structure.shared), len(structure.initial)
    states = {}
    for j, name in enumerate(structure.initial):
        states[name] = found.theta[shared + j :: own]
        states[f"{name}_stderr"] = stderr[shared + j :: own]
    index = pd.Index([run.label for run in problem.runs], name="run")
    runs = [
        RunFit(
            run.label,
            run.synthetic,
            run.t,
            run.mode,
            {name: getattr(run, name) for name in structure.outputs},
            {name: found.fitted[j][i] for j, name in enumerate(structure.outputs)},
        )
        for i, run in enumerate(problem.runs)
    ]
    return FitResult(
        model=model,
        method="output_error",
        parameters=table,
        covariance=covariance,
        initial_states=pd.DataFrame(states, index=index),
        runs=runs,
        noise=found.noise,
        sigma=dict(zip(structure.outputs, found.sigma.tolist(), strict=True)),
        cost=found.cost,
        success=bool(success),
        message=" ".join(sentences),
        degrees_of_freedom=float(problem.counts.sum() - found.free.size),
    )
