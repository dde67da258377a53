from .core import (
    CoreSettings as CoreSettings,
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
    "CoreSettings",
    "RobotRun",
    "RunSettings",
    "Topic",
    "Watchdog",
    "measures_table",
    "read_run",
    "read_toml",
]
