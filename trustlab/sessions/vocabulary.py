"""The columns a session can have: their units, ranges and meaning; and the units in which a log may hold them."""

import math
from dataclasses import dataclass

from trustlab.models.checks import shown
from trustlab.sessions.errors import alternatives


@dataclass(frozen=True)
class Column:
    """One column: `unit` is SI, "1" for a pure number, "measure" for the unit of the performance measure."""

    name: str
    unit: str
    meaning: str
    low: float | None = None
    high: float | None = None


def _axes(stem: str, unit: str, meaning: str) -> list[Column]:
    return [Column(f"{stem}_{axis}", unit, f"{meaning}, {axis} axis") for axis in "xyz"]


VOCABULARY: dict[str, Column] = {
    column.name: column
    for column in [
        Column("mode", "1", "who drives: 1 manual, 0 autonomous, between them the manual share α", 0.0, 1.0),
        Column("p_r", "measure", "robot performance P_r as measured"),
        Column("p_h", "measure", "human performance P_h as measured"),
        Column("r", "1", "human utilization r", 0.0, 1.0),
        Column("tsc", "1", "trust and self-confidence TSC"),
        Column("path_error", "m", "deviation e from the path or target (a distance)", 0.0),
        Column("step_distance", "m", "distance Δd from the previous sample", 0.0),
        Column("v_command", "m/s", "linear velocity commanded by the operator"),
        Column("w_command", "rad/s", "angular velocity commanded by the operator ((2.7) takes |ω|)"),
        Column("suggested_mode", "1", "mode suggested by the decision aid; −1 for no suggestion", -1.0, 1.0),
        *_axes("robot", "m", "robot position"),
        *_axes("reference", "m", "position of the path or target"),
        *_axes("human", "m", "position commanded by the operator"),
        *_axes("u_h", "1", "the operator's command u_h"),
        *_axes("u_a", "1", "the autonomous controller's command u_a"),
        *_axes("u_i", "1", "the ideal command u_i"),
        *_axes("velocity", "m/s", "robot velocity"),
        Column("yaw", "rad", "robot heading"),
        Column("alpha", "1", "share α of the operator in the command (3.1)", 0.0, 1.0),
        Column("beta", "1", "force feedback scaling β", 0.0),
        Column("trust_hr", "1", "human-to-robot trust T_hr, in units of its model"),
        Column("trust_rh", "1", "robot-to-human trust T_rh, in units of its model"),
        *_axes("device", "m", "position of the haptic device"),
        *_axes("device_velocity", "m/s", "velocity of the haptic device"),
        *_axes("r_m", "m/s", "output r_m of the haptic device"),
        *_axes("f_h", "N", "force of the operator's hand"),
        *_axes("f_m", "N", "force feedback at the haptic device"),
        *_axes("r_s", "m/s", "command at the robot's port, scaled by α"),
        *_axes("f_s", "N", "force feedback at the robot's port"),
        *_axes("guide", "N", "force at the haptic device less the channel's own damping: what guidance adds"),
        Column(
            "port_share",
            "1",
            "share that the passivity controller lets pass, of a port's velocity or of the force",
            0.0,
            1.0,
        ),
        Column("energy_operator", "J", "energy given by the operator's hand so far"),
        Column("energy_device", "J", "energy stored in the haptic device, V_hd"),
        Column("energy_dissipated", "J", "energy dissipated in the haptic device so far"),
        Column("energy_channel", "J", "energy in the channel: what went in less what came out so far"),
        Column("energy_robot", "J", "energy taken by the robot's port so far"),
        Column("energy_port", "J", "energy taken by the operator's port so far, ∫ r_mᵀ f_m dt"),
        Column("energy_target", "J", "energy that the moving target gave to the guiding spring so far"),
    ]
}


def vocabulary():
    """
    Return the vocabulary of session columns as a table.

    Returns
    -------
    pandas.DataFrame
        Index `column`; columns unit, low, high, meaning. The index of a session, t, is in seconds.
    """
    import pandas as pd

    table = pd.DataFrame(VOCABULARY.values()).rename(columns={"name": "column"}).set_index("column")
    return table[["unit", "low", "high", "meaning"]]


_SIZES = {
    "1": {"1": 1.0, "%": 0.01, "percent": 0.01},
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "m/s": {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001, "km/h": 1.0 / 3.6},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0},
}
UNITS = {unit: (si, size) for si, sizes in _SIZES.items() for unit, size in sizes.items()}
"""Name of a unit: its SI unit, and how many of those it is."""


def to_si(unit: str, wanted: str) -> float:
    """Return the factor that converts a unit to the SI unit wanted; "measure" takes any unit."""
    if not isinstance(unit, str) or unit not in UNITS:
        raise ValueError(f"unknown unit {shown(unit)}{alternatives(unit, UNITS)}")
    base, factor = UNITS[unit]
    if wanted not in (base, "measure"):
        remedy = "; leave the unit out" if wanted == "1" else ""
        raise ValueError(f"{unit!r} measures {base}, but {wanted} is needed{remedy}")
    return factor
