"""trustlab: trust models from logged sessions, thresholds, teleoperation and within-subject statistics."""
__version__ = "0.1.0"
