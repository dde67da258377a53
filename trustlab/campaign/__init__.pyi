from .errors import CampaignError as CampaignError, CampaignWarning as CampaignWarning
from .folder import read_campaign as read_campaign
from .parameters import (
    ParameterGrid as ParameterGrid,
    parameter_draws as parameter_draws,
    parameter_grid as parameter_grid,
)
from .run import run_campaign as run_campaign
from .sensitivity import SobolIndices as SobolIndices, sobol_indices as sobol_indices
