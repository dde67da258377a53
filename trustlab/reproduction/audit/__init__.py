"""
The audit: every printed number that follows from others, recomputed, with a verdict and its reason.
"""
