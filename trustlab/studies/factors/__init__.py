"""
Designs of several factors: within and between subjects, with covariates, and orders of conditions.
"""
