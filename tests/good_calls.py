"""
Calls that work, for the walk of `tests/contract.py`: where a name's docstring has no example, where
its example takes too long, and for methods. Tables of names and arguments, nothing else; a function
makes those that take time.
"""

import numpy as np

import trustlab as tl
from tests import cases
from tests.cases import THRESHOLDS

CHEAPER = {
    "choose_thresholds": {"points": 4},
    "compare_trust_models": lambda: {
        "panel": cases.panel(),
        "models": ["running_mean", "habit"],
        "folds": 2,
    },
    "feasibility": lambda: {"study": cases.study()},
    "fit_human": lambda: {"sessions": cases.log()},
    "fit_robot": lambda: {"sessions": cases.log()},
    "fit_transfer_function": lambda: dict(
        zip(["command", "velocity"], cases.response(), strict=True)
    ),
    "fit_trust": lambda: {"panel": cases.panel(), "model": "performance"},
    "fit_tsc": lambda: {"sessions": cases.log()},
    "formula_model": lambda: {"data": cases.scores()},
    "invariant_bounds": {"cells": 64, "cycles": 20},
    "optimal_allocation": lambda: {  # of somebody quick, so that cycles are short
        "tsc": tl.TscModel(tl.RobotModel(0.95, 0.2, 0.4, 0.5), tl.HumanModel(0.98, 0.7, 0.4, 0.5))
    },
    "reconstruct": lambda: {"study": cases.study()},
    "run_campaign": {"parameters": [{"n": 10}, {"n": 100}]},
    "run_condition": {"laps": 1},
    "sample_posterior": lambda: {"sessions": cases.log(), "n": 100},
    "simulate_allocation": {"steps": 50},
    "simulate_team": {"duration": 2.0},
    "smallest_n": lambda: {"simulation": tl.studies.Simulation(replicates=100)},
    "sobol_indices": {"n": 8, "resamples": 20},
    "virtual_study": {"n_jobs": 1, "conditions": ["C1", "C3"], "n": 4},
}
"""Arguments in place of those of an example."""

CALLS = {
    # Names of rooms.
    "allocation.step_bounds": lambda: {"tsc": cases.model()},
    "models.StepScaling": {"low": 0.2, "high": 0.8},
    "operators.operator": lambda: {"participant": 1, "model": cases.model()},
    "reproduction.read_calibration": {"study": "uav", "folder": "data/calibration"},
    "studies.apa_p": {"p": 0.01},
    "studies.holm": {"p": np.array([0.01, 0.2, 0.03])},
    "studies.clopper_pearson": {"count": 3, "total": 10},
    "studies.graded_covariance": {"k": 3},
    "studies.partial_eta_interval": {"f": 4.0, "df1": 2.0, "df2": 22.0},
    "studies.participants_needed": {"conditions": 4},
    "teleoperation.corrected_filter": {"cutoff": 5.0, "impedance": 1.0},
    "teleoperation.packet_delay": {
        "sent": np.array([0.0, 0.1, 0.2]),
        "received": np.array([0.1, 0.2, 0.35]),
    },
    "teleoperation.printed_filter": {"cutoff": 5.0},
    "teleoperation.random_walk_delay": {"low": 0.1, "high": 0.3, "max_rate": 0.5},
    "teleoperation.sinusoid_energy": lambda: {
        "two_port": tl.teleoperation.printed_filter(5.0),
        "duration": 1.0,
    },
    "teleoperation.team_graph": lambda: {"graph": cases.graph()},
    "testbeds.following_operator": {"participant": 2},
    "testbeds.identification_session": lambda: {"operator": cases.driver()},
    "testbeds.plot_energies": lambda: {"session": cases.flight()},
    "testbeds.published_operator": {"participant": 2},
    "trust.predict": lambda: {
        "model": tl.trust.MODELS["asymmetric"](),
        "panel": cases.panel(),
    },
    "trust.simulate_ratings": lambda: {
        "model": tl.trust.MODELS["asymmetric"](),
        "panel": cases.panel(),
        "rng": np.random.default_rng(0),
    },
    # Methods, of the answer of the first name that has it.
    "EnergyLedger.receive": {"number": 0, "wave": np.array([2.0])},
    "FitResult.residual_correlations": {"lags": 5},
    "HapticDevice.dissipation": {"x": np.zeros(3), "v": np.ones(3)},
    "HapticDevice.output": {"x": np.zeros(3), "v": np.ones(3)},
    "HapticDevice.storage": {"x": np.ones(3), "v": np.ones(3)},
    "HapticDevice.step": {
        "x": np.zeros(3),
        "v": np.ones(3),
        "f_h": np.ones(3),
        "f_m": np.zeros(3),
        "sample_time": 0.001,
    },
    "HumanModel.performance": {"r": 0.5},
    "HumanModel.simulate": {"mode": np.array([1.0, 0.0, 1.0])},
    "Panel.event": {"k": 0},
    "Panel.of": {"rows": [0, 1]},
    "Posterior.table": {},
    "PublishedStudy.pair": {"name": "A-B"},
    "RepeatedMeasures.pairs": {},
    "RobotModel.simulate": {
        "mode": np.array([1.0, 0.0, 1.0]),
        "p_h": np.array([0.4, 0.4, 0.4]),
    },
    "RobotModel.steady_state": {"mode": 1.0, "p_h": 0.4},
    "Session.between": {"start": 0.0, "stop": 0.1},
    "StudyReport.write": {"path": "report.html"},
    "TeleoperationLoop.run": {"until": 0.5},
    "ThresholdLimits.contains": THRESHOLDS,
    "TrackingTask.path": {"t": np.array([0.0, 1.0]), "height": 0.0, "phase": 0.0},
    "TransferFunction.discrete": {"sample_time": 0.1},
    "TrustModel.decay": {"sample_time": 0.1},
    "TrustModel.simulate": {"performance": np.array([0.5, 1.0]), "sample_time": 0.1},
    "TrustModel.steady_state": {"performance": 0.5},
    "TscModel.delta": {"delta_p_r": 0.01, "delta_p_h": 0.0},
    "TscModel.simulate": {"mode": np.array([1.0, 0.0, 1.0])},
    "TscModel.value": {"p_r": 0.3, "p_h": 0.4},
    "VirtualStudy.analysis": {"dv": "p_r"},
}
"""Arguments of a good call, where no example makes it."""

NOT_WALKED = {
    "Session.with_performance": "needs a log of a drive",
    "trust.recover_trust_models": "fit_trust and compare_trust_models check the same arguments",
    "VirtualStudy.joined": "for studies in parts",
    "RecordedStudy.order_effects": "needs people who have finished",
    "RecordedStudy.analysis": "needs people who have finished",
    "RecordedStudy.report": "writes a report by a notebook",
    "LiveStudy.delete": "needs a participant who has begun",
    "LiveStudy.open": "needs a folder with a study",
    "LiveStudy.participant": "needs a participant who has begun",
    "LiveStudy.rehearse": "drives a whole study",
    "LiveStudy.steps": "needs a participant who has begun",
    "LiveStudy.serve": "starts a server",
    "Model.check_names": "a part of fit",
    "Model.coordinate": "a part of fit",
    "Model.limits": "a part of fit",
    "Model.outputs_of": "a part of fit",
    "Model.useful": "a part of fit",
    "Prior.vectors": "a part of sample_posterior",
    "Teleoperator.numbers": "a part of the loop",
    "ThresholdCorrector.followed": "a part of step",
    "allocation.incentive_box": "is the kernel of incentive_bounds",
    "calibrate": "simulates studies for minutes",
    "fit_population": "takes seconds; sample_posterior checks the same arguments",
    "live.policy_agreement": "needs a team that somebody led",
    "publishing.caption": "for the notebooks of this project",
    "publishing.only_parameters": "reads the names of a notebook",
    "publishing.required_data": "needs data that are not shipped",
    "publishing.use_house_style": "changes all figures that follow",
    "reproduction.write_calibration": "for the script that makes the stored calibrations",
    "ros.measures_table": "needs a run of a robot",
    "ros.read_run": "needs a run of a robot",
    "ros.read_toml": "needs a file that describes a robot",
    "sessions.external_data": "needs data that are not shipped",
    "sessions.load_recipe": "read_session calls it",
    "sessions.plot_by_participant": "for one chapter",
    "sessions.plot_paths": "for one chapter",
    "sessions.tracking_error": "for one chapter",
    "studies.tlx_weights": "needs fifteen choices a person",
}
"""Names that are not walked over, with the reason."""
