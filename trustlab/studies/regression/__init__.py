"""Regressions of trials: mixed models by formula, logistic models, effects of order."""
