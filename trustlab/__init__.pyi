__version__: str

from . import (
    allocation as allocation,
    campaign as campaign,
    identification as identification,
    models as models,
    operators as operators,
    publishing as publishing,
    reproduction as reproduction,
    sessions as sessions,
    studies as studies,
    teleoperation as teleoperation,
    testbeds as testbeds,
)
from .allocation import (
    OnlineCorrection as OnlineCorrection,
    OptimalBlending as OptimalBlending,
    PerformanceRule as PerformanceRule,
    ThresholdCorrector as ThresholdCorrector,
    ThresholdRule as ThresholdRule,
    choose_thresholds as choose_thresholds,
    correct_pattern as correct_pattern,
    cycle_sensitivity as cycle_sensitivity,
    estimate_thresholds as estimate_thresholds,
    followed_suggestions as followed_suggestions,
    incentive_bounds as incentive_bounds,
    invariant_bounds as invariant_bounds,
    limit_cycle as limit_cycle,
    relative_performance as relative_performance,
    simulate_allocation as simulate_allocation,
    steady_state_bounds as steady_state_bounds,
    sweep as sweep,
    threshold_limits as threshold_limits,
)
from .campaign import (
    parameter_draws as parameter_draws,
    parameter_grid as parameter_grid,
    read_campaign as read_campaign,
    run_campaign as run_campaign,
    sobol_indices as sobol_indices,
)
from .identification import (
    IdentificationError as IdentificationError,
    LinearForm as LinearForm,
    Parameter as Parameter,
    Structure as Structure,
    arx as arx,
    fit as fit,
    fit_human as fit_human,
    fit_robot as fit_robot,
    fit_transfer_function as fit_transfer_function,
    fit_tsc as fit_tsc,
)
from .models import (
    HumanModel as HumanModel,
    RobotModel as RobotModel,
    TransferFunction as TransferFunction,
    TrustModel as TrustModel,
    TscModel as TscModel,
)
from .operators import (
    Operator as Operator,
    Teleoperator as Teleoperator,
    graded_teleoperators as graded_teleoperators,
    simulated_answers as simulated_answers,
)
from .reproduction import (
    PublishedStudy as PublishedStudy,
    audit as audit,
    compare as compare,
    feasibility as feasibility,
    model_effects as model_effects,
    printed_effects as printed_effects,
    published_models as published_models,
    published_studies as published_studies,
    published_table as published_table,
    reconstruct as reconstruct,
    reconstruct_study as reconstruct_study,
    simulated_effects as simulated_effects,
)
from .sessions import (
    Metadata as Metadata,
    Session as Session,
    SessionError as SessionError,
    read_session as read_session,
    read_sessions as read_sessions,
    write_session as write_session,
)
from .studies import (
    cronbach_alpha as cronbach_alpha,
    design_balance as design_balance,
    latin_square_design as latin_square_design,
    order_effects as order_effects,
    paired_t_test as paired_t_test,
    power_analysis as power_analysis,
    repeated_measures as repeated_measures,
    repeated_measures_batch as repeated_measures_batch,
    score_likert as score_likert,
    score_nasa_tlx as score_nasa_tlx,
    score_satisfaction as score_satisfaction,
    score_trust_checklist as score_trust_checklist,
    smallest_n as smallest_n,
    virtual_study as virtual_study,
    winsorize as winsorize,
)
from .teleoperation import (
    EnergyLedger as EnergyLedger,
    HapticDevice as HapticDevice,
    PassivityController as PassivityController,
    Scattering as Scattering,
    Scheme as Scheme,
    channel_run as channel_run,
    tune_transparency as tune_transparency,
)
from .testbeds import (
    TeleoperationLoop as TeleoperationLoop,
    TrackingTask as TrackingTask,
    run_condition as run_condition,
    simulate_team as simulate_team,
    simulate_teleoperation as simulate_teleoperation,
    teleoperation_measures as teleoperation_measures,
)
