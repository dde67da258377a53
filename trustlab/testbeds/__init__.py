"""Simulated tasks that write sessions: stand-ins for testbeds with people."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "course": ["Course"],
        "ground_robot": ["GroundRobotRun", "drive_modes", "identification_session", "run_condition"],
        "pioneer": ["Pioneer"],
    },
)
