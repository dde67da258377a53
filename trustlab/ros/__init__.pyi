from .decision import (
    AllocationCore as AllocationCore,
    Decision as Decision,
)
from .inputs import Watchdog as Watchdog
from .settings import CoreSettings as CoreSettings

__all__ = ["AllocationCore", "CoreSettings", "Decision", "Watchdog"]
