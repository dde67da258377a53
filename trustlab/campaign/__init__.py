"""Many runs of one task: seeds, chunks, executors, files, resume."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "errors": ["CampaignError", "CampaignWarning"],
        "folder": ["read_campaign"],
        "parameters": ["ParameterGrid", "parameter_draws", "parameter_grid"],
        "run": ["run_campaign"],
        "sensitivity": ["SobolIndices", "sobol_indices"],
    },
)
