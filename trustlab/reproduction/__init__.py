"""The printed numbers, and ours beside them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "comparison": ["compare", "matching_digits"],
        "published": ["published_models", "published_table"],
        "rounding": ["recompute", "smallest_change"],
    },
)
