from .core import (
    AllocationCore as AllocationCore,
    CoreSettings as CoreSettings,
    Decision as Decision,
    Watchdog as Watchdog,
)
from .node import Allocation as Allocation
from .recorded import (
    RobotRun as RobotRun,
    measures_table as measures_table,
    read_run as read_run,
)
from .run import (
    RunSettings as RunSettings,
    Topic as Topic,
    read_toml as read_toml,
)

__all__ = [
    "Allocation",
    "AllocationCore",
    "CoreSettings",
    "Decision",
    "RobotRun",
    "RunSettings",
    "Topic",
    "Watchdog",
    "measures_table",
    "read_run",
    "read_toml",
]
