"""
The allocation rule on a robot: the decision core, fed with stamped messages, without middleware.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
