"""Sessions in, models out."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "fit_result": ["FitResult"],
        "fitting": ["fit"],
        "human": ["fit_human"],
        "regression": ["ArxResult", "arx"],
        "robot": ["fit_robot"],
        "structure": ["IdentificationError", "LinearForm", "Parameter", "Structure"],
        "transfer_function": ["fit_transfer_function"],
        "tsc": ["fit_tsc"],
    },
)
