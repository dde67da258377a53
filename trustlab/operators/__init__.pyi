from .answers import simulated_answers as simulated_answers
from .ground_robot import (
    ASSUMPTIONS as ASSUMPTIONS,
    Operator as Operator,
    operator as operator,
)
from .teleoperator import (
    TELEOPERATOR_ASSUMPTIONS as TELEOPERATOR_ASSUMPTIONS,
    Teleoperator as Teleoperator,
)
