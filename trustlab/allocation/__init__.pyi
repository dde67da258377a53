from .blending import OptimalBlending as OptimalBlending
from .bounds import (
    SteadyStateBounds as SteadyStateBounds,
    steady_state_bounds as steady_state_bounds,
)
from .correction import (
    CorrectionPlan as CorrectionPlan,
    TargetWarning as TargetWarning,
    ThresholdCorrector as ThresholdCorrector,
    incentive_bounds as incentive_bounds,
    incentive_box as incentive_box,
)
from .correction_run import (
    CorrectionRun as CorrectionRun,
    OnlineCorrection as OnlineCorrection,
    OnlineStep as OnlineStep,
    run_correction as run_correction,
)
from .estimates import (
    ThresholdEstimate as ThresholdEstimate,
    estimate_thresholds as estimate_thresholds,
    followed_suggestions as followed_suggestions,
    relative_performance as relative_performance,
)
from .invariant import (
    InvariantBounds as InvariantBounds,
    invariant_bounds as invariant_bounds,
)
from .limits import (
    StepBounds as StepBounds,
    ThresholdLimits as ThresholdLimits,
    step_bounds as step_bounds,
    threshold_limits as threshold_limits,
)
from .optimum import (
    OptimalAllocation as OptimalAllocation,
    optimal_allocation as optimal_allocation,
)
from .rules import (
    PerformanceRule as PerformanceRule,
    ThresholdRule as ThresholdRule,
    simulate_allocation as simulate_allocation,
)
from .steady import LimitCycle as LimitCycle, limit_cycle as limit_cycle
from .thresholds import (
    ThresholdChoice as ThresholdChoice,
    choose_thresholds as choose_thresholds,
)
