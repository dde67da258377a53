"""Trust models from logged human-robot sessions: read, identify, compare with the printed numbers, publish."""

import lazy_loader as lazy

__version__ = "0.1.0"

_lazy_getattr, __dir__, __all__ = lazy.attach(
    __name__,
    submodules=[
        "allocation",
        "identification",
        "models",
        "operators",
        "publishing",
        "reproduction",
        "sessions",
        "testbeds",
    ],
    submod_attrs={
        "models": ["HumanModel", "RobotModel", "TscModel"],
        "sessions": ["Metadata", "Session", "SessionError", "read_session", "read_sessions", "write_session"],
        "allocation": [
            "PerformanceRule",
            "ThresholdRule",
            "choose_thresholds",
            "estimate_thresholds",
            "followed_suggestions",
            "invariant_bounds",
            "limit_cycle",
            "relative_performance",
            "simulate_allocation",
            "steady_state_bounds",
            "threshold_limits",
        ],
        "identification": ["IdentificationError", "arx", "fit_human", "fit_robot", "fit_tsc"],
        "operators": ["Operator"],
        "reproduction": ["compare", "published_models", "published_table"],
    },
)
__getattr__ = _lazy_getattr
