"""Real-time correction of an operator's thresholds, (2.40)-(2.44)."""
