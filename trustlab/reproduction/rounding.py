"""What printed outputs can be when printed inputs vary within their rounding, and what change explains the rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from decimal import Decimal
from itertools import product

import numpy as np
import pandas as pd

from trustlab.models.checks import whole_number
from trustlab.reproduction.comparison import compare

__all__ = ["half_unit", "recompute", "smallest_change"]

Compute = Callable[[dict[str, float]], Mapping[str, float]]


def half_unit(printed: str) -> float:
    """
    Return half a unit of a printed number's last digit.

    Parameters
    ----------
    printed : str
        The number as printed, for example "0.320" (0.0005) or "5.44e-5" (5e-8).

    Raises
    ------
    ValueError
        If it is not a string with a finite number in it: a float has lost its trailing zeros.
    """
    try:
        exponent = Decimal(printed.strip()).as_tuple().exponent if isinstance(printed, str) else None
        half = 0.5 * float(Decimal(1).scaleb(exponent))
    except (ArithmeticError, TypeError, ValueError):
        half = math.nan
    if not math.isfinite(half) or not math.isfinite(float(printed)):
        raise ValueError(f"a printed number must be a string, for example '0.320', got {printed!r:.60}")
    return half


def _mapping(name: str, values) -> dict[str, str]:
    if not isinstance(values, Mapping) and not hasattr(values, "items"):
        raise ValueError(f"{name} must map names to numbers as printed, got {type(values).__name__}")
    found = dict(values.items())
    if not found:
        raise ValueError(f"{name} must hold at least one number as printed, got none")
    for text in found.values():
        half_unit(text)
    return found


def _callable(compute) -> None:
    if not callable(compute):
        raise ValueError(
            f"compute must be a function of a dictionary of inputs, got {type(compute).__name__}"
        )


def recompute(
    compute: Compute, inputs: Mapping[str, str], outputs: Mapping[str, str], draws: int = 500, seed: int = 0
) -> pd.DataFrame:
    """
    Recompute printed outputs from printed inputs, and their ranges when every input varies within its rounding.

    Parameters
    ----------
    compute : callable
        Takes inputs as a dictionary of floats and returns outputs by name; may raise ValueError where inputs are
        impossible, which is left out of the ranges.
    inputs, outputs : mapping of str to str
        Numbers as printed.
    draws : int
        Random points inside the box of rounding, besides its corners (all of them up to 12 inputs).
    seed : int
        Seed of the draws.

    Returns
    -------
    pandas.DataFrame
        Index `quantity`; columns recomputed, printed, low, high, verdict: "reproduced" (rounds to the printed number),
        "within rounding" (the range meets what rounds to it), else "not reproducible".

    Raises
    ------
    ValueError
        If nothing can be computed from the printed inputs, an output is not computed, or an argument is not understood.
    """
    _callable(compute)
    inputs, outputs = _mapping("inputs", inputs), _mapping("outputs", outputs)
    draws, seed = whole_number("draws", draws, least=0, most=10**6), whole_number("seed", seed, least=0)
    middle = {name: float(text) for name, text in inputs.items()}
    half = np.array([half_unit(text) for text in inputs.values()])
    names, centre = list(inputs), np.array(list(middle.values()))
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (draws, len(names)))
    if len(names) <= 12:
        points = np.concatenate([points, np.array(list(product((-1.0, 1.0), repeat=len(names))))])
    exact = compute(middle)
    missing = [name for name in outputs if name not in exact]
    if missing:
        raise ValueError(f"compute returns {', '.join(map(str, exact))}, but no {missing[0]!r}")
    low, high = dict(exact), dict(exact)
    for point in points:
        try:
            found = compute(dict(zip(names, centre + half * point, strict=True)))
        except ValueError:
            continue
        for name in outputs:
            low[name], high[name] = min(low[name], found[name]), max(high[name], found[name])
    rounds = compare({name: exact[name] for name in outputs}, outputs)["verdict"] == "rounds to it"
    rows = []
    for name, text in outputs.items():
        value, reach = float(text), half_unit(text)
        meets = low[name] <= value + reach and high[name] >= value - reach
        verdict = "reproduced" if rounds[name] else "within rounding" if meets else "not reproducible"
        rows.append((name, exact[name], text, low[name], high[name], verdict))
    columns = ["quantity", "recomputed", "printed", "low", "high", "verdict"]
    return pd.DataFrame(rows, columns=columns).set_index("quantity")


def smallest_change(
    compute: Compute, inputs: Mapping[str, str], output: str, printed: str, units: int = 400
) -> pd.DataFrame:
    """
    Find which single printed input, changed least, makes an output round to its printed value.

    Parameters
    ----------
    compute : callable
        As for `recompute`.
    inputs : mapping of str to str
        Numbers as printed.
    output : str
        The output to explain.
    printed : str
        Its printed value.
    units : int
        Farthest change to try, in units of an input's last digit.

    Returns
    -------
    pandas.DataFrame
        One row per input that can explain it, least change first: input, printed, needed, units (of its last digit).

    Raises
    ------
    ValueError
        If the output is not computed, or an argument is not understood.
    """
    _callable(compute)
    inputs, reach = _mapping("inputs", inputs), half_unit(printed)
    units = whole_number("units", units, most=10**5)
    middle = {name: float(text) for name, text in inputs.items()}
    target = float(printed)
    exact = compute(middle)
    if not isinstance(output, str) or output not in exact:
        raise ValueError(f"compute returns {', '.join(map(str, exact))}, but no {output!r}")
    rows = []
    for name, text in inputs.items():
        unit = 2.0 * half_unit(text)
        for k in sorted(range(-units, units + 1), key=abs):
            try:
                found = compute(middle | {name: middle[name] + k * unit})[output]
            except ValueError:
                continue
            if abs(found - target) <= reach:
                rows.append((name, text, middle[name] + k * unit, k))
                break
    table = pd.DataFrame(rows, columns=["input", "printed", "needed", "units"])
    return table.sort_values("units", key=np.abs, ignore_index=True)
