"""Who drives: rules, limits, bounds and the exact cycle."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "correction": ["TargetWarning", "ThresholdCorrector"],
        "correction_dynamics": ["simulate_correction"],
        "correction_online": ["OnlineCorrection", "OnlineStep"],
        "correction_pattern": ["CorrectionRun", "correct_pattern"],
        "correction_plan": ["CorrectionPlan", "CorrectionStatus"],
        "incentive": ["incentive_bounds", "incentive_box"],
        "blending": ["BlendingStep", "OptimalBlending"],
        "bound_failures": ["bound_failures"],
        "invariant_bounds": ["InvariantBounds", "invariant_bounds"],
        "limit_cycle": ["LimitCycle", "limit_cycle"],
        "limits": ["ThresholdLimits", "threshold_limits"],
        "parameter_sweep": ["Sweep", "cycle_sensitivity", "sweep", "varied_model"],
        "performance_rule": ["PerformanceRule"],
        "simulation": ["simulate_allocation"],
        "steady_state": ["SteadyStateBounds", "steady_state_bounds"],
        "step_bounds": ["StepBounds", "step_bounds"],
        "threshold_choice": ["ThresholdChoice", "choose_thresholds"],
        "suggestions": ["followed_suggestions"],
        "threshold_estimate": [
            "ThresholdEstimate",
            "estimate_thresholds",
            "relative_performance",
            "separation",
        ],
        "threshold_rule": ["ThresholdRule"],
    },
)
