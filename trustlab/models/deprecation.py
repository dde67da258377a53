"""Old names that keep working for one version: each use warns and says the new name."""

import warnings
from collections.abc import Callable, Mapping


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that `old` is now called `new`; call it from the function or property that has the old name."""
    warnings.warn(f"{old} is now {new}; the old name goes with the next version", DeprecationWarning, stacklevel)


def old_names(module: str, find: Callable[[str], object], renamed: Mapping[str, str]) -> Callable[[str], object]:
    """Return a module's `__getattr__` that also finds names by which things were once exported."""

    def find_renamed(name: str) -> object:
        if name in renamed:
            warn_renamed(f"{module}.{name}", f"{module}.{renamed[name]}")
            return find(renamed[name])
        return find(name)

    return find_renamed
