"""Within-subject studies: design, score, analyse."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "analysis.apa": ["apa_number", "apa_p", "apa_table"],
        "analysis.pairwise": ["bonferroni", "holm"],
        "analysis.batch": ["RepeatedMeasuresBatch", "repeated_measures_batch"],
        "planning.closed_form_power": ["clopper_pearson", "noncentral_f_power", "noncentrality"],
        "planning.covariances": ["Conditions", "graded_covariance"],
        "analysis.effect_sizes": ["PartialEtaInterval", "partial_eta_interval"],
        "analysis.mixed_model": ["MixedModel", "mixed_model"],
        "analysis.repeated_measures": ["RepeatedMeasures", "repeated_measures"],
        "designs": [
            "DesignBalance",
            "LatinSquareDesign",
            "design_balance",
            "latin_square_design",
            "participants_needed",
            "williams_square",
        ],
        "questionnaires.nasa_tlx": ["TLX_RESCALINGS", "TLX_SCALES", "score_nasa_tlx", "tlx_weights"],
        "planning.populations": ["GroundRobotPopulation", "TeleoperatorPopulation"],
        "planning.power": ["PowerAnalysis", "power_analysis"],
        "planning.smallest_n": ["SmallestN", "smallest_n"],
        "planning.virtual_report": ["VirtualStudy"],
        "planning.virtual_study": ["virtual_study"],
        "analysis.paired_t_test": ["PairedTTest", "paired_t_test"],
        "questionnaires.likert": ["LikertScale", "ScaleScores", "Subscale", "score_likert"],
        "questionnaires.reliability": ["Reliability", "cronbach_alpha"],
        "questionnaires.satisfaction": ["satisfaction_scale", "score_satisfaction"],
        "questionnaires.trust_checklist": ["TRUST_CHECKLIST", "score_trust_checklist"],
        "analysis.winsorize": ["Winsorized", "winsorize"],
    },
)
