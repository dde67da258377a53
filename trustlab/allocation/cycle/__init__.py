"""
The model under rule (2.8) in steady state: its cycle, and bounds that hold for every trajectory.
"""
