from .parameters import (
    parameter_draws as parameter_draws,
    parameter_grid as parameter_grid,
)
from .run import (
    CampaignError as CampaignError,
    CampaignWarning as CampaignWarning,
    read_campaign as read_campaign,
    run_campaign as run_campaign,
)
from .sensitivity import SobolIndices as SobolIndices, sobol_indices as sobol_indices
