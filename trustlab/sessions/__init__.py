"""Logged runs: read, check, measure."""

import lazy_loader as lazy

from trustlab.models.deprecation import old_names

_lazy_getattr, __dir__, __all__ = lazy.attach(
    __name__,
    submodules=["metrics", "recipe"],
    submod_attrs={
        "errors": ["RecipeError", "SessionError"],
        "external": ["external_data"],
        "metadata": ["Metadata"],
        "metrics": ["tracking_error"],
        "plots": ["plot_by_participant", "plot_paths"],
        "readers": ["read_session", "read_sessions"],
        "recipe": ["Recipe", "list_recipes", "load_recipe"],
        "session": ["Session"],
        "vocabulary": ["vocabulary"],
        "writers": ["write_session"],
    },
)
__getattr__ = old_names(__name__, _lazy_getattr, {"recipes": "recipe"})
