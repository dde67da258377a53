from .fit import fit as fit
from .log import LogSettings as LogSettings
from .model import IdentificationError as IdentificationError, Model as Model
from .posterior.density import Prior as Prior
from .posterior.population import Population as Population, fit_population as fit_population
from .posterior.result import Posterior as Posterior
from .posterior.sampling import sample_posterior as sample_posterior
from .regression import ArxResult as ArxResult, arx as arx
from .result import FitResult as FitResult
from .transfer_function import fit_transfer_function as fit_transfer_function
from .tsc import (
    HUMAN as HUMAN,
    ROBOT as ROBOT,
    TSC as TSC,
    fit_human as fit_human,
    fit_robot as fit_robot,
    fit_tsc as fit_tsc,
)
