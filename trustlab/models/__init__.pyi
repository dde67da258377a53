from .published import published_models as published_models, published_table as published_table
from .trust import TrustModel as TrustModel
from .tsc import (
    HumanModel as HumanModel,
    RobotModel as RobotModel,
    TscModel as TscModel,
)
from .uav import PRINTED_UAV as PRINTED_UAV, TransferFunction as TransferFunction
