"""What the walk of `tests/contract.py` allows, and what it finds and nobody has mended yet."""

ALLOWED = {
    "Metadata": {"more": "any fact may be stored"},
    "Metadata.changed": {"misspelt": "any fact may be added", "site": "any fact may be stored"},
    "Session.between": {"start": "the others lie before the first sample"},
    "OnlineCorrection.update": {
        "": "measures its own time",
        "p_r": "NaN is a message that did not come",
        "p_h": "NaN is a message that did not come",
        "mode": "NaN is a message that did not come",
    },
    "Operator": {"trust_bias": "positive is a word of the description, not the range"},
    "PerformanceRule.step": {"tsc": "rules take the same arguments"},
    "Session.with_metadata": {"misspelt": "any fact may be added"},
    "StudyReport.write": {"": "writes the time of day"},
    "ThresholdCorrector.step": {"": "measures its own time"},
    "ThresholdRule.step": {"p_r": "rules take the same arguments"},
    "choose_thresholds": {"delta_p_h": "Theorem 1 leaves no room at a large one"},
    "EnergyLedger.receive": {
        "number": "answers whether the wave is kept",
        "wave": "answers whether the wave is kept",
    },
    "HapticDevice.output": {"x": "the same arguments as the other methods"},
    "HapticDevice.dissipation": {"x": "the same arguments as the other methods"},
    "equivalence": {"missing": "nothing is missing"},
    "estimate_thresholds": {
        "model": "a drive of four laps has too few switches",
        "after": "a drive of four laps has too few switches",
        "sessions": "a drive of four laps has too few switches",
    },
    "paired_t_test": {"missing": "nothing is missing"},
    "parameter_draws": {"laps": "a value may be anything"},
    "parameter_grid": {"lower": "a value may be anything", "upper": "a value may be anything"},
    "read_frame": {"misspelt": "any fact may be added"},
    "read_sessions": {"on_error": "no file is faulty"},
    "repeated_measures": {"missing": "nothing is missing"},
    "run_correction": {"": "measures its own time"},
    "simulate_allocation": {"mode": "none of 50 samples is near a threshold"},
    "smallest_n": {"most": "fewer suffice"},
    "FitResult.residuals": {"output": "the example has one output"},
    "FitResult.residual_correlations": {"output": "the example has one output"},
    "latin_square_design": {"whole_squares": "eight are whole squares"},
    "run_campaign": {"out": "the table is the same"},
    "RecordedStudy.export": {"path": "the file is the same"},
    "HapticDevice.step": {"x": "one step", "f_m": "acts one sample later"},
    "MixedModel.pairs": {"factor": "one factor"},
    "RepeatedMeasures.pairs": {"factor": "one factor", "at": "one factor"},
    "bayes_factor": {"missing": "nothing is missing"},
    "order_effects": {"frame": "every row is needed, and other columns are not looked at"},
    "testbeds.Pioneer": {"heading_drift": "positive is a word of the description, not the range"},
    "teleoperation.packet_delay": {"sent": "the answer holds a function"},
    "teleoperation.random_walk_delay": {
        "seed": "the answer holds a function",
        "hold": "the answer holds a function",
    },
    "draft_recipe": {"out": "the recipe is the same"},
}
"""Arguments that may be NaN, or of any name, or that change nothing in the good call; and answers
that differ each time.
"""

KNOWN = {
    "LiveCondition": {
        "suggestions": "no argument named",
    },
    "LiveStudy": {
        "folder": "foreign errors",
        "conditions": "foreign errors",
        "participants": "foreign errors",
    },
    "PublishedStudy": {
        "conditions": "foreign errors",
        "significant_without_p": "foreign errors",
        "title": "anything is taken",
        "where": "anything is taken",
    },
    "PublishedStudy.pair": {
        "name": "foreign errors",
    },
    "Scheme": {
        "title": "anything is taken",
    },
    "TeamLoop.step": {
        "leader": "foreign errors",
        "samples": "no argument named",
    },
    "TrackingTask.path": {
        "t": "foreign errors, NaN is taken",
        "height": "foreign errors, anything is taken",
        "phase": "foreign errors, NaN is taken",
    },
    "ArxResult.table": {
        "level": "no difference",
    },
    "channel_run": {
        "beta": "no difference",
        "read_out": "no difference",
    },
    "compare": {
        "values": "foreign errors, no argument named",
        "printed": "foreign errors, no argument named",
        "stderr": "foreign errors, no difference",
    },
    "compare_trust_models": {
        "models": "foreign errors",
    },
    "TrustComparison.paired": {
        "against": "foreign errors",
    },
    "cronbach_alpha": {
        "items": "NaN is taken",
    },
    "fit_robot": {
        "p_h_max": "NaN is taken",
    },
    "latin_square_design": {
        "participants": "foreign errors",
    },
    "limit_cycle": {
        "lower": "NaN is taken",
        "upper": "NaN is taken",
    },
    "optimal_allocation": {
        "sample_time": "no difference",
    },
    "PowerAnalysis.plot": {
        "test": "foreign errors",
    },
    "read_live_study": {
        "folder": "foreign errors",
    },
    "RecordedStudy.export": {
        "path": "foreign errors",
    },
    "read_people": {
        "name": "foreign errors, no argument named",
    },
    "Panel.event": {
        "k": "foreign errors",
    },
    "Panel.of": {
        "rows": "foreign errors",
    },
    "reconstruct": {
        "p_adjust": "no difference",
    },
    "StudyReport.write": {
        "path": "foreign errors, no argument named",
    },
    "simulated_answers": {
        "points": "foreign errors",
    },
    "simulated_effects": {
        "n": "foreign errors, no difference",
    },
    "teleoperation_measures": {
        "sessions": "foreign errors",
    },
    "virtual_study": {
        "n": "foreign errors",
    },
    "VirtualStudy.plot": {
        "measures": "foreign errors, no argument named",
    },
    "reproduction.read_calibration": {
        "study": "no argument named",
        "folder": "foreign errors, no argument named",
    },
    "ros.AllocationCore": {
        "thresholds": "foreign errors, no argument named",
    },
    "ros.CoreSettings": {
        "watchdogs": "foreign errors",
    },
    "ros.RunSettings": {
        "condition": "anything is taken",
        "rule": "NaN is taken",
        "correction": "NaN is taken",
        "topics": "foreign errors",
    },
    "studies.StudyColumns": {
        "dv": "NaN is taken",
        "within": "NaN is taken",
        "subject": "NaN is taken",
        "between": "NaN is taken",
        "order": "NaN is taken",
    },
    "studies.apa_p": {
        "p": "foreign errors, NaN is taken",
    },
    "studies.clopper_pearson": {
        "total": "foreign errors",
    },
    "studies.graded_covariance": {
        "sd": "foreign errors",
    },
    "studies.holm": {
        "p": "foreign errors, NaN is taken",
    },
    "studies.partial_eta_interval": {
        "df2": "foreign errors",
    },
    "studies.satisfaction_scale": {
        "points": "foreign errors",
        "items": "foreign errors",
        "reversed": "foreign errors",
    },
    "teleoperation.GivenSequence": {
        "robots": "NaN is taken",
    },
    "teleoperation.TeamChannel": {
        "delay": "NaN is taken",
    },
    "teleoperation.TeamTrial": {
        "start": "anything is taken",
    },
    "teleoperation.packet_delay": {
        "received": "foreign errors",
    },
    "teleoperation.team_graph": {
        "require_connected": "foreign errors, anything is taken, no difference",
    },
    "testbeds.following_operator": {
        "participant": "foreign errors",
    },
    "testbeds.plot_energies": {
        "session": "foreign errors",
    },
    "trust.parameter": {
        "default": "anything is taken",
        "low": "anything is taken",
        "high": "anything is taken",
    },
    "trust.predict": {
        "model": "foreign errors",
        "panel": "foreign errors",
        "free": "foreign errors, anything is taken",
        "known": "anything is taken, no difference",
    },
    "trust.simulate_ratings": {
        "model": "foreign errors",
        "panel": "foreign errors",
        "rng": "foreign errors",
    },
}
"""Faults of the other rooms, by name and argument."""
