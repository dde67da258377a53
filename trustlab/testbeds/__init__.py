"""Simulated tasks that write sessions: stand-ins for testbeds with people."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "ground_robot.correction_run": ["run_correction"],
        "ground_robot.course": ["Course"],
        "ground_robot.conditions": ["drive_modes", "identification_session", "run_condition"],
        "ground_robot.run": ["GroundRobotRun"],
        "ground_robot.participants": ["published_model", "published_operator", "published_thresholds"],
        "ground_robot.pioneer": ["Pioneer"],
        "robot_team": ["simulate_team"],
        "team_run": ["TeamRun"],
        "teleoperation_measures": ["teleoperation_measures"],
        "teleoperation_plots": ["plot_alpha", "plot_energies", "plot_signals", "plot_trajectory"],
        "uav_tracking": ["TrackingTask", "simulate_teleoperation", "tracking_vehicle"],
    },
)
