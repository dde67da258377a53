"""Readers: from files of a lab to sessions."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__, submod_attrs={"file": ["read_session"], "folder": ["read_sessions"]}
)
