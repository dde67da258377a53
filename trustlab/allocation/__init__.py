"""
Allocation of control: rules, limits, bounds, the limit cycle, and the correction of thresholds.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
