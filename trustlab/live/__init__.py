"""The same tasks driven by people in a browser, in notebooks and in studies."""

import lazy_loader as lazy

_lazy_getattr, __dir__, __all__ = lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Return a public name; one whose extra is missing is absent, as hasattr expects."""
    try:
        return _lazy_getattr(name)
    except ModuleNotFoundError as error:
        raise AttributeError(str(error)) from error
