"""Within-subject studies: design, score, analyse."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "batch": ["RepeatedMeasuresBatch", "repeated_measures_batch"],
        "closed_form_power": ["clopper_pearson", "noncentral_f_power", "noncentrality"],
        "covariances": ["Conditions", "graded_covariance"],
        "effect_sizes": ["PartialEtaInterval", "partial_eta_interval"],
        "mixed_model": ["MixedModel", "mixed_model"],
        "repeated_measures": ["RepeatedMeasures", "repeated_measures"],
        "designs": [
            "DesignBalance",
            "LatinSquareDesign",
            "design_balance",
            "latin_square_design",
            "participants_needed",
            "williams_square",
        ],
        "nasa_tlx": ["TLX_RESCALINGS", "TLX_SCALES", "score_nasa_tlx", "tlx_weights"],
        "populations": ["GroundRobotPopulation", "TeleoperatorPopulation"],
        "power": ["PowerAnalysis", "power_analysis"],
        "smallest_n": ["SmallestN", "smallest_n"],
        "virtual_report": ["VirtualStudy"],
        "virtual_study": ["virtual_study"],
        "paired_t_test": ["PairedTTest", "paired_t_test"],
        "questionnaires": ["LikertScale", "ScaleScores", "Subscale", "score_likert"],
        "reliability": ["Reliability", "cronbach_alpha"],
        "satisfaction": ["satisfaction_scale", "score_satisfaction"],
        "trust_checklist": ["TRUST_CHECKLIST", "score_trust_checklist"],
        "winsorize": ["Winsorized", "winsorize"],
    },
)
