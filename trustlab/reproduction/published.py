"""What the dissertation prints, as strings, and the models with the printed parameters."""

from trustlab.models.published import (
    ByName,
    printed_pilot,
    published_folder,
    published_models,
    published_table,
)

__all__ = ["ByName", "printed_pilot", "published_folder", "published_models", "published_table"]
