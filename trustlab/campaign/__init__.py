"""Many runs of one task: seeds, chunks, files, resume, sensitivity."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
