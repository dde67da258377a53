"""What the dissertation prints, as strings, and the models with the printed parameters."""

from trustlab.models.published import PILOT, ByName, published_folder, published_models, published_table

__all__ = ["PILOT", "ByName", "published_folder", "published_models", "published_table"]
