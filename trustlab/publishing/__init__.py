"""
Notebooks to reports: run, checked, self-contained, with their provenance; and the house style of
figures.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submodules=["figures", "notebooks", "provenance"],
    submod_attrs={
        "figures": ["caption", "label_synthetic", "use_house_style"],
        "provenance": ["Checkout"],
        "mathml": ["to_mathml"],
        "notebooks": ["Built", "publish"],
    },
)
