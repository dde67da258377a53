"""The printed numbers, and ours beside them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "audit.audit": ["audit"],
        "audit.plots": ["part_of", "plot_ranges", "plot_slips", "plot_verdicts", "verdict_counts"],
        "comparison": ["compare", "matching_digits", "recompute", "smallest_change"],
        "published": ["published_models", "published_table"],
        "published_study": ["PublishedStudy", "PublishedStudyError", "published_studies"],
        "reconstruction.feasibility": ["Feasibility", "compare_adjustments", "feasibility"],
        "reconstruction.reconstruction": [
            "Reconstruction",
            "ReconstructionError",
            "reconstruct",
            "reconstruct_study",
        ],
    },
)
