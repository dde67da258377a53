from .fit_result import FitResult as FitResult
from .fitting import fit as fit
from .human import fit_human as fit_human
from .posterior.population import Population as Population, fit_population as fit_population
from .posterior.priors import Prior as Prior
from .posterior.result import Posterior as Posterior
from .posterior.sampling import sample_posterior as sample_posterior
from .regression import ArxResult as ArxResult, arx as arx
from .robot import fit_robot as fit_robot
from .robot_performance import robot_structure as robot_structure
from .runs import LogSettings as LogSettings
from .structure import (
    IdentificationError as IdentificationError,
    LinearForm as LinearForm,
    Parameter as Parameter,
    Structure as Structure,
)
from .transfer_function import fit_transfer_function as fit_transfer_function
from .tsc import fit_tsc as fit_tsc
