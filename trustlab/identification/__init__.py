"""Sessions in, models out."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "arx": ["ArxResult", "arx"],
        "errors": ["IdentificationError"],
        "fit_result": ["FitResult"],
        "human": ["fit_human"],
        "robot": ["fit_robot"],
        "transfer_function": ["fit_transfer_function"],
        "tsc": ["fit_tsc"],
    },
)
