from .anova import (
    partial_eta_interval as partial_eta_interval,
    repeated_measures_batch as repeated_measures_batch,
)
from .designs import (
    DesignBalance as DesignBalance,
    LatinSquareDesign as LatinSquareDesign,
    design_balance as design_balance,
    latin_square_design as latin_square_design,
    participants_needed as participants_needed,
)
from .mixed import (
    FormulaModel as FormulaModel,
    MixedModel as MixedModel,
    formula_model as formula_model,
    mixed_model as mixed_model,
)
from .order_effects import OrderEffects as OrderEffects, order_effects as order_effects
from .ordinal import OrdinalModel as OrdinalModel, ordinal_model as ordinal_model
from .paired import (
    PairedTTest as PairedTTest,
    bayes_factor as bayes_factor,
    equivalence as equivalence,
    paired_t_test as paired_t_test,
)
from .pairs import holm as holm
from .population import (
    Conditions as Conditions,
    StudyColumns as StudyColumns,
    graded_covariance as graded_covariance,
)
from .power import (
    PowerAnalysis as PowerAnalysis,
    Simulation as Simulation,
    SmallestN as SmallestN,
    clopper_pearson as clopper_pearson,
    power_analysis as power_analysis,
    smallest_n as smallest_n,
)
from .questionnaires import (
    NASA_TLX as NASA_TLX,
    TRUST_CHECKLIST as TRUST_CHECKLIST,
    Questionnaire as Questionnaire,
    Reliability as Reliability,
    ScaleScores as ScaleScores,
    cronbach_alpha as cronbach_alpha,
    satisfaction_scale as satisfaction_scale,
    score as score,
    tlx_weights as tlx_weights,
)
from .repeated_measures import (
    RepeatedMeasures as RepeatedMeasures,
    repeated_measures as repeated_measures,
)
from .report import StudyReport as StudyReport, report as report
from .virtual_study import VirtualStudy as VirtualStudy, virtual_study as virtual_study
from .winsorize import Winsorized as Winsorized, winsorize as winsorize
from .words import apa_p as apa_p
