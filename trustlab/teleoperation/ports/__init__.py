"""
The ports of a teleoperation loop, each with its compiled equations: device, waves, ledger,
passivity.
"""
