"""Simulated tasks that write sessions: stand-ins for testbeds with people."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
