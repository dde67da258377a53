"""Trust models from logged sessions, thresholds, stable teleoperation and within-subject statistics."""

import lazy_loader as lazy

__version__ = "0.1.0"

_lazy_getattr, __dir__, __all__ = lazy.attach(
    __name__,
    submodules=["identification", "models", "publishing", "reproduction", "sessions"],
    submod_attrs={
        "models": ["HumanModel", "RobotModel", "TscModel"],
        "sessions": ["Metadata", "Session", "SessionError", "read_session", "read_sessions", "write_session"],
        "identification": ["IdentificationError", "arx", "fit_human", "fit_robot", "fit_tsc"],
        "reproduction": ["compare", "published_models", "published_table"],
    },
)
__getattr__ = _lazy_getattr
