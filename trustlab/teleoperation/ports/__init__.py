"""
The ports of a teleoperation loop, with their compiled equations: the device, and waves between.
"""
