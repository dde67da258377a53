"""
Decisions under uncertainty, and the optimum of all switching policies.
"""
