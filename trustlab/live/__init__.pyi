from .condition import LiveCondition as LiveCondition
from .study.plan import LiveStudy as LiveStudy
from .study.recorded import RecordedStudy as RecordedStudy, read_live_study as read_live_study
from .tasks.ground_robot import DriveSettings as DriveSettings
from .tasks.team import (
    LeadingSettings as LeadingSettings,
    policy_agreement as policy_agreement,
)
from .tasks.teleoperation import TeleoperationSettings as TeleoperationSettings
from .widget import (
    LiveGroundRobot as LiveGroundRobot,
    LiveTeam as LiveTeam,
    LiveTracking as LiveTracking,
)
