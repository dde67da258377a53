from .condition import LiveCondition as LiveCondition
from .ground_robot import LiveGroundRobot as LiveGroundRobot
from .hand import live_difficulty as live_difficulty
from .study.live_study import LiveStudy as LiveStudy
from .study.recorded import RecordedStudy as RecordedStudy, read_live_study as read_live_study
from .study.settings import DriveSettings as DriveSettings
from .tracking import LiveTracking as LiveTracking
