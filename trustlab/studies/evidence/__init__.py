"""Evidence beyond a significant difference: equivalence, Bayes factors, simultaneous intervals, agreement."""
