"""Allocation of control: rules, limits, bounds, the steady cycle, and the correction of thresholds."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "correction.corrector": ["TargetWarning", "ThresholdCorrector"],
        "correction.dynamics": ["simulate_correction"],
        "correction.online": ["OnlineCorrection", "OnlineStep"],
        "correction.tests_in_a_row": ["CorrectionRun", "correct_pattern"],
        "correction.plan": ["CorrectionPlan", "CorrectionStatus"],
        "correction.incentive": ["incentive_bounds", "incentive_box"],
        "blending": ["BlendingStep", "OptimalBlending"],
        "bound_failures": ["bound_failures"],
        "cycle.invariant_bounds": ["InvariantBounds", "invariant_bounds"],
        "cycle.limit_cycle": ["LimitCycle", "limit_cycle"],
        "limits": ["StepBounds", "ThresholdLimits", "step_bounds", "threshold_limits"],
        "parameter_sweep": ["Sweep", "cycle_sensitivity", "sweep", "varied_model"],
        "rules": ["PerformanceRule", "ThresholdRule"],
        "simulation": ["simulate_allocation"],
        "steady_state": ["SteadyStateBounds", "steady_state_bounds"],
        "threshold_choice": ["ThresholdChoice", "choose_thresholds"],
        "suggestions": ["followed_suggestions"],
        "threshold_estimate": [
            "ThresholdEstimate",
            "estimate_thresholds",
            "relative_performance",
            "separation",
        ],
    },
)
