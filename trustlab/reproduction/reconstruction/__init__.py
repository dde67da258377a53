"""Data that have the statistics a study prints, or a proof that there are none."""
