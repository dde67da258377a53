"""The printed numbers, and ours beside them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "audit": ["audit"],
        "comparison": ["compare", "matching_digits"],
        "conflicts": ["Feasibility", "compare_adjustments", "feasibility"],
        "published": ["published_models", "published_table"],
        "published_study": ["PublishedStudy", "published_studies"],
        "reconstruction": ["Reconstruction", "ReconstructionError", "reconstruct", "reconstruct_study"],
        "rounding": ["recompute", "smallest_change"],
        "study_checks": ["PublishedStudyError"],
    },
)
