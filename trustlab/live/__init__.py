"""
The same tasks driven by people in a browser: one physics, bit for bit, for notebooks and for
studies.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
