"""Analyses of scores from within-subject studies."""
