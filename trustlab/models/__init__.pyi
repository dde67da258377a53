from .human import HumanModel as HumanModel
from .published import published_models as published_models, published_table as published_table
from .robot import RobotModel as RobotModel
from .trust import (
    LogisticScaling as LogisticScaling,
    StepScaling as StepScaling,
    TrustModel as TrustModel,
)
from .tsc import TscModel as TscModel
from .uav import PRINTED_UAV as PRINTED_UAV, TransferFunction as TransferFunction
