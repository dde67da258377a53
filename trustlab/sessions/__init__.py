"""Logged runs: read, check, measure."""

import lazy_loader as lazy

from trustlab.models.deprecation import old_names

_lazy_getattr, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
__getattr__ = old_names(__name__, _lazy_getattr, {"recipes": "recipe"})
