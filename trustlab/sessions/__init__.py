"""Logged runs: read, check, measure."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submodules=["metrics", "recipes"],
    submod_attrs={
        "errors": ["RecipeError", "SessionError"],
        "external": ["external_data"],
        "metrics": ["tracking_error"],
        "readers": ["read_session", "read_sessions"],
        "recipes": ["Recipe", "list_recipes", "load_recipe"],
        "session": ["Metadata", "Session"],
        "vocabulary": ["vocabulary"],
        "writers": ["write_session"],
    },
)
