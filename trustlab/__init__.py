"""
Trust models from logged human-robot sessions: read, identify, compare with the printed numbers,
publish.
"""

import lazy_loader as lazy

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
