"""
What a browser needs to compute a run: arrays by name and address, and where fields stand in them.
"""

from base64 import b64encode
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
from numba import from_dtype, types
from numba.extending import intrinsic


def offset(kind: np.dtype, name: str) -> int:
    """Return where a field of a record begins."""
    return kind.fields[name][1]


def plan_of(
    arrays: Mapping[str, np.ndarray], addresses: np.dtype, empty: Collection[str]
) -> dict[str, Any]:
    """
    Return arrays for a browser, and the names of a record of their addresses; what is empty before
    a run goes without content.
    """
    packed = []
    for name, array in arrays.items():
        content = np.ascontiguousarray(array)
        packed.append({"name": name, "size": content.nbytes})
        if name not in empty:
            packed[-1]["data"] = b64encode(content.tobytes()).decode()
    return {"arrays": packed, "addresses": list(addresses.names or ())}


@intrinsic
def pointer(typing_context, address):
    """Return an address as a pointer, for `numba.carray`."""

    def generate(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(types.voidptr))

    return types.voidptr(types.int64), generate


def entry(function: Callable, addresses: np.dtype) -> tuple[Callable, Any]:
    """
    Return a function of the samples' numbers (first, stop), a command, and the arrays' addresses,
    with numba's signature.
    """
    period = types.int64, types.int64, types.float64, types.float64, types.float64
    return function, types.int32(*period, types.CPointer(from_dtype(addresses)))
