from .answers import (
    allocation_answers as allocation_answers,
    simulated_answers as simulated_answers,
)
from .ground_robot import (
    ASSUMPTIONS as ASSUMPTIONS,
    Operator as Operator,
    OperatorNumbers as OperatorNumbers,
    driving_style as driving_style,
    joystick as joystick,
    operator as operator,
)
from .teleoperator import (
    REACH as REACH,
    TELEOPERATOR_ASSUMPTIONS as TELEOPERATOR_ASSUMPTIONS,
    Teleoperator as Teleoperator,
)
