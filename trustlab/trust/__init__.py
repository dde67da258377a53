"""Models of trust of this dissertation and of the field, fitted to people and compared."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
