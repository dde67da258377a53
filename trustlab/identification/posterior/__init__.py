"""
What a log says of a person, as draws: priors, likelihood, coordinates, sampling, populations.
"""
