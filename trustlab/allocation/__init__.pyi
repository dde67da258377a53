from .blending import BlendingStep as BlendingStep, OptimalBlending as OptimalBlending
from .correction.correction_run import (
    CorrectionRun as CorrectionRun,
    run_correction as run_correction,
)
from .correction.corrector import (
    TargetWarning as TargetWarning,
    ThresholdCorrector as ThresholdCorrector,
)
from .correction.dynamics import simulate_correction as simulate_correction
from .correction.incentive import (
    incentive_bounds as incentive_bounds,
    incentive_box as incentive_box,
)
from .correction.model_tests import ModelTests as ModelTests
from .correction.online import OnlineCorrection as OnlineCorrection, OnlineStep as OnlineStep
from .correction.plan import CorrectionPlan as CorrectionPlan, CorrectionStatus as CorrectionStatus
from .correction.setting import (
    CorrectionSetting as CorrectionSetting,
    CorrectionTest as CorrectionTest,
)
from .cycle.intervals import RangeIntervals as RangeIntervals
from .cycle.invariant_bounds import (
    InvariantBounds as InvariantBounds,
    invariant_bounds as invariant_bounds,
)
from .cycle.limit_cycle import LimitCycle as LimitCycle, limit_cycle as limit_cycle
from .decision.optimum import (
    OptimalAllocation as OptimalAllocation,
    optimal_allocation as optimal_allocation,
)
from .decision.posterior_choice import PosteriorChoice as PosteriorChoice
from .limits import (
    StepBounds as StepBounds,
    ThresholdLimits as ThresholdLimits,
    step_bounds as step_bounds,
    threshold_limits as threshold_limits,
)
from .rules import PerformanceRule as PerformanceRule, ThresholdRule as ThresholdRule
from .simulation import simulate_allocation as simulate_allocation
from .steady_ranges import SteadyRanges as SteadyRanges
from .steady_state import (
    SteadyStateBounds as SteadyStateBounds,
    steady_state_bounds as steady_state_bounds,
)
from .suggestions import followed_suggestions as followed_suggestions
from .threshold_choice import (
    ThresholdChoice as ThresholdChoice,
    choose_thresholds as choose_thresholds,
)
from .threshold_estimate import (
    ThresholdEstimate as ThresholdEstimate,
    estimate_thresholds as estimate_thresholds,
    relative_performance as relative_performance,
    separation as separation,
)
