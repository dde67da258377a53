from .condition_run import ConditionRun as ConditionRun
from .ground_robot.course import Course as Course
from .ground_robot.kernel import (
    Pioneer as Pioneer,
    identification_session as identification_session,
)
from .populations import (
    OperatorPopulation as OperatorPopulation,
    TeleoperatorPopulation as TeleoperatorPopulation,
    following_operator as following_operator,
    published_operator as published_operator,
)
from .robot_team import (
    TeamLoop as TeamLoop,
    simulate_team as simulate_team,
)
from .team_run import TeamRun as TeamRun
from .team_testbed import RobotTeam as RobotTeam
from .teleoperation_measures import (
    plot_energies as plot_energies,
    teleoperation_measures as teleoperation_measures,
)
from .testbed import (
    GroundRobot as GroundRobot,
    Testbed as Testbed,
    UavFollowing as UavFollowing,
    UavTracking as UavTracking,
    run_condition as run_condition,
)
from .uav_tracking import (
    TeleoperationLoop as TeleoperationLoop,
    TrackingTask as TrackingTask,
    simulate_teleoperation as simulate_teleoperation,
    tracking_vehicle as tracking_vehicle,
)
