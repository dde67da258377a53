from .comparison import (
    MEASURES as MEASURES,
    TrustComparison as TrustComparison,
    compare_trust_models as compare_trust_models,
    recover_trust_models as recover_trust_models,
)
from .driving import TrustInLoop as TrustInLoop
from .dynamics import BASELINES as BASELINES, MODELS as MODELS
from .dynamics.linear import LinearTrust as LinearTrust
from .fitting import TrustFit as TrustFit, fit_trust as fit_trust
from .interface import (
    BetaRating as BetaRating,
    Event as Event,
    GridRating as GridRating,
    NormalRating as NormalRating,
    TrustDynamics as TrustDynamics,
    parameter as parameter,
)
from .likelihood import predict as predict, simulate_ratings as simulate_ratings
from .panel import Panel as Panel
from .people import read_people as read_people
