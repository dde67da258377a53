"""
The TOML files of the recipes that come with the package; `trustlab.sessions.recipe` says what a
recipe may hold.
"""

from trustlab.models.checks import warn_renamed


def __getattr__(name: str) -> object:
    """Find the names that this place once had."""
    from trustlab.sessions import recipe

    if name.startswith("_") or not hasattr(recipe, name):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warn_renamed(f"{__name__}.{name}", f"{recipe.__name__}.{name}")
    return getattr(recipe, name)
