"""Notebooks to a book: run, checked, with their provenance; and the house style of figures."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submodules=["figures"],
    submod_attrs={
        "figures": ["caption", "use_house_style"],
        "parameters": ["DataAbsentError", "only_parameters", "required_data"],
    },
)
