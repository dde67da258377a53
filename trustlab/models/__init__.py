"""Equations, and nothing else."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "robot": ["RobotModel"],
        "human": ["HumanModel"],
        "tsc": ["TscModel"],
        "trust": ["LogisticScaling", "StepScaling", "TrustModel"],
        "uav": ["PRINTED_UAV", "TransferFunction"],
        "published": ["published_models", "published_table"],
    },
)
