"""Simulated tasks that write sessions: stand-ins for testbeds with people."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "correction_run": ["run_correction"],
        "course": ["Course"],
        "ground_robot": ["GroundRobotRun", "drive_modes", "identification_session", "run_condition"],
        "participants": ["published_model", "published_operator", "published_thresholds"],
        "pioneer": ["Pioneer"],
        "robot_team": ["simulate_team"],
        "team_run": ["TeamRun"],
        "teleoperation_measures": ["teleoperation_measures"],
        "teleoperation_plots": ["plot_alpha", "plot_energies", "plot_signals", "plot_trajectory"],
        "uav_tracking": ["TrackingTask", "simulate_teleoperation", "tracking_vehicle"],
    },
)
