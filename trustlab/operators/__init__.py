"""Simulated operators, stand-ins for people: who drives, flies, decides and answers."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "answers": ["simulated_answers"],
        "ground_robot": ["Operator", "OperatorNumbers", "driving_style", "joystick", "operator"],
        "teleoperator": ["REACH", "Teleoperator", "graded_teleoperators"],
    },
)
