"""Models of trust, one a file, by name."""

from trustlab.trust.dynamics.armav import SeriesTrust
from trustlab.trust.dynamics.asymmetric import SwitchedTrust
from trustlab.trust.dynamics.baselines import Constant, Habit, Persistence, RunningMean
from trustlab.trust.dynamics.beta import BetaTrust
from trustlab.trust.dynamics.cumulative import CumulativeTrust
from trustlab.trust.dynamics.dissertation import PerformanceTrust
from trustlab.trust.dynamics.edft import FieldTrust
from trustlab.trust.dynamics.optimo import GridTrust
from trustlab.trust.interface import TrustDynamics

BASELINES: dict[str, type[TrustDynamics]] = {
    "persistence": Persistence,
    "running_mean": RunningMean,
    "constant": Constant,
    "habit": Habit,
}
MODELS: dict[str, type[TrustDynamics]] = {
    "performance": PerformanceTrust,
    "series": SeriesTrust,
    "decision_field": FieldTrust,
    "optimo": GridTrust,
    "beta": BetaTrust,
    "asymmetric": SwitchedTrust,
    "memory_bias": CumulativeTrust,
}
