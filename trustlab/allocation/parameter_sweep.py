"""Maps of the steady cycle over thresholds and model parameters, and what it depends on most."""

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.cycle.limit_cycle import limit_cycle
from trustlab.campaign.parameters import parameter_grid
from trustlab.campaign.run import run_campaign
from trustlab.campaign.sensitivity import SobolIndices, sobol_indices
from trustlab.models.checks import finite_array, finite_number, of_class, one_of, whole_number
from trustlab.models.display import axes_or_new
from trustlab.models.tsc import HumanModel, RobotModel, TscModel, gain_of_human_performance

# What is mapped, all of the steady cycle under rule (2.8).
QUANTITIES = {
    "mean_p_r": "mean robot performance",
    "p_r_low": "least robot performance",
    "p_r_high": "greatest robot performance",
    "mean_r": "mean utilization",
    "r_low": "least utilization",
    "r_high": "greatest utilization",
    "dwell_manual_low": "least manual dwell time [samples]",
    "dwell_manual_high": "greatest manual dwell time [samples]",
    "dwell_autonomous_low": "least autonomous dwell time [samples]",
    "dwell_autonomous_high": "greatest autonomous dwell time [samples]",
}

PARAMETERS = tuple(
    f"{part}.{field.name}"
    for part, kind in (("robot", RobotModel), ("human", HumanModel))
    for field in fields(kind)
)
THRESHOLDS = ("lower", "upper")


@dataclass(frozen=True, eq=False)
class Sweep:
    """
    The steady cycle at every point of a grid.

    Parameters
    ----------
    axes : dict of numpy.ndarray
        Values by name of what was varied.
    points : pandas.DataFrame
        One row per point.
    """

    axes: dict[str, np.ndarray]
    points: pd.DataFrame

    def table(self) -> pd.DataFrame:
        """
        Return one row per point.

        Returns
        -------
        pandas.DataFrame
            What was varied, lower and upper; exists (whether the rule keeps switching), mean_p_r,
            p_r_low, p_r_high, mean_r, r_low, r_high, dwell times in samples, NaN where there is no
            cycle; and `reason` in words.
        """
        return self.points.copy()

    def plot(
        self, quantity: str = "mean_p_r", x: str | None = None, y: str | None = None, axes=None
    ):
        """
        Map a quantity over one or two of what was varied; blank where the rule stops switching.

        Parameters
        ----------
        quantity : str
            A key of `QUANTITIES`.
        x, y : str, optional
            What to put on the axes; the first and second varied when not given. With y, what else
            was varied must have one value; with one thing varied, a line is drawn.
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ValueError
            If a name is unknown or more was varied than is shown.
        """
        one_of("quantity", quantity, QUANTITIES)
        names = list(self.axes)
        x = names[0] if x is None else x
        y = next((name for name in names if name != x), None) if y is None else y
        one_of("x, among what was varied,", x, names)
        if y is not None:
            one_of("y, among what was varied,", y, names)
        if x == y:
            raise ValueError(f"x and y must be different, both are {x!r}")
        hidden = [name for name in names if name not in (x, y) and self.axes[name].size > 1]
        if hidden:
            raise ValueError(
                f"{hidden[0]} was varied too; a map shows two: sweep one value of it, or name it "
                "x or y"
            )
        axes = axes_or_new(axes, figsize=(5.6, 4.2))
        if y is None:
            axes.plot(self.points[x], self.points[quantity], "o-", ms=3, color="#0072b2")
            axes.set_ylabel(QUANTITIES[quantity])
        else:
            grid = self.points.pivot_table(
                index=y, columns=x, values=quantity, dropna=False, aggfunc="first"
            )
            grid = grid.reindex(index=np.sort(self.axes[y]), columns=np.sort(self.axes[x]))
            image = axes.pcolormesh(
                grid.columns, grid.index, grid.to_numpy(dtype=float), shading="nearest"
            )
            axes.figure.colorbar(image, ax=axes, label=QUANTITIES[quantity])
            axes.set_ylabel(_label(y))
        axes.set_xlabel(_label(x))
        missing = int((~self.points["exists"]).sum())
        note = f"; blank: no cycle ({missing} of {len(self.points)} points)" if missing else ""
        axes.set_title(f"steady cycle of the model{note}", fontsize="small")
        return axes


def _label(name: str) -> str:
    return {"lower": "lower threshold $TSC_l$", "upper": "upper threshold $TSC_u$"}.get(name, name)


def varied_model(tsc: TscModel, values: Mapping[str, float]) -> TscModel:
    """
    Return a model with some parameters changed.

    b_pr follows (2.3) where it does in `tsc`, and else stays as it was given; the robot's P_h,max
    follows the operator's where the two are equal in `tsc`. A value given for either takes
    precedence.

    Parameters
    ----------
    tsc : TscModel
        The model.
    values : dict of float
        By name: robot.a, robot.p_min, robot.p_max, robot.p_h_max, robot.b, human.a, human.beta,
        human.p_min, human.p_max.

    Raises
    ------
    ValueError
        If a name is unknown or the parameters make no model.
    """
    parts = {"robot": {}, "human": {}}
    for name, value in values.items():
        part, _, field = one_of("what is varied", name, PARAMETERS).partition(".")
        parts[part][field] = value
    robot = tsc.robot
    human = tsc.human
    if (
        "p_max" in parts["human"]
        and "p_h_max" not in parts["robot"]
        and robot.p_h_max == human.p_max
    ):
        parts["robot"]["p_h_max"] = parts["human"]["p_max"]
    follows = gain_of_human_performance(robot.a, robot.p_min, robot.p_max, robot.p_h_max)
    if parts["robot"] and abs(robot.b - follows) <= 1e-12 * follows:
        parts["robot"].setdefault("b", None)
    return TscModel(replace(robot, **parts["robot"]), replace(human, **parts["human"]))


def cycle_at(
    tsc: TscModel,
    lower: float | None,
    upper: float | None,
    starts: int,
    seed: object,
    **values: float,
) -> dict:
    """Return the measures of one steady cycle: the task of a campaign, which needs no seed."""
    lower = values.pop("lower", lower)
    upper = values.pop("upper", upper)
    try:
        cycle = limit_cycle(varied_model(tsc, values), lower, upper, starts)
    except ValueError as error:
        nothing = dict.fromkeys(QUANTITIES, math.nan)
        return {"exists": False, **nothing, "reason": f"not defined: {error}"}
    measures = {name: float(getattr(cycle, name)) for name in QUANTITIES}
    return {"exists": cycle.exists} | measures | {"reason": cycle.reason}


def sweep(
    tsc: TscModel,
    axes: Mapping[str, Iterable[float]],
    *,
    lower: float | None = None,
    upper: float | None = None,
    starts: int = 1,
    **campaign: Any,
) -> Sweep:
    """
    Map performance, utilization and dwell times of the cycle over thresholds and parameters.

    Parameters
    ----------
    tsc : TscModel
        The model around which parameters are varied.
    axes : dict of array_like
        Values by name: lower, upper, robot.a … human.p_max (as in `varied_model`). Every
        combination is a point; where it makes no model, or TSC_l is not below TSC_u, `reason` says
        so and there are no numbers.
    lower, upper : float, optional
        Thresholds, where they are not varied.
    starts : int
        As in `limit_cycle`: 1 is the quick setting, one motion per point.
    **campaign : object
        n_jobs, out and progress, as in `run_campaign`.

    Returns
    -------
    Sweep
        `.table()` and `.plot(quantity)`.

    Raises
    ------
    ValueError
        If a name is unknown, values are not finite, or a threshold is missing or given twice.

    Examples
    --------
    >>> import trustlab as tl
    >>> swept = tl.sweep(tl.published_models()["2"], {"upper": [0.25, 0.30, 0.35]}, lower=0.0)
    >>> swept.table()[["upper", "mean_p_r"]].round(3)
       upper  mean_p_r
    0   0.25     0.320
    1   0.30     0.322
    2   0.35     0.325
    """
    names = _checked(tsc, axes, lower, upper)
    values: dict[str, Any] = {name: finite_array(name, axes[name]) for name in names}
    for name, array in values.items():
        if np.unique(array).size < array.size:
            raise ValueError(f"{name} has a value twice; give each once")
    task = functools.partial(
        cycle_at, tsc=tsc, lower=lower, upper=upper, starts=whole_number("starts", starts)
    )
    table = run_campaign(task, parameter_grid(**values), **campaign)
    if table["failed"].any():
        bad = table[table["failed"]].iloc[0]
        raise ValueError(f"the point {bad[names].to_dict()} failed: {bad['error']}")
    fixed = {
        name: float(value)
        for name, value in zip(THRESHOLDS, (lower, upper), strict=True)
        if value is not None
    }
    return Sweep(values, table.assign(**fixed)[[*names, *fixed, "exists", *QUANTITIES, "reason"]])


def cycle_sensitivity(
    tsc: TscModel,
    ranges: Mapping[str, object],
    n: int = 256,
    *,
    lower: float | None = None,
    upper: float | None = None,
    quantities: tuple[str, ...] = (
        "mean_p_r",
        "mean_r",
        "dwell_manual_high",
        "dwell_autonomous_high",
    ),
    **options: Any,
) -> SobolIndices:
    """
    Return Sobol' indices of the steady cycle: which thresholds and parameters it depends on most.

    Parameters
    ----------
    tsc : TscModel
        The model around which parameters are varied.
    ranges : dict
        By name, as in `sweep`: (low, high) or a scipy.stats distribution.
    n : int
        Points in each of two samples, a power of 2; n (parameters + 2) cycles are computed.
    lower, upper : float, optional
        Thresholds, where they are not varied.
    quantities : tuple of str
        Keys of `QUANTITIES`.
    **options : object
        seed, level and resamples, as in `sobol_indices`; n_jobs, out and progress, as in
        `run_campaign`.

    Returns
    -------
    SobolIndices
        `.table()` and `.plot()`.

    Raises
    ------
    ValueError
        If a name is unknown, a threshold is missing or given twice, or the rule stops switching at
        a point: narrow the ranges then.

    Examples
    --------
    >>> import trustlab as tl
    >>> tsc = tl.published_models()["2"]
    >>> ranges = {"upper": (0.2, 0.35), "human.a": (0.998, 0.9995)}
    >>> options = {"quantities": ("mean_r",), "n_jobs": 1}
    >>> indices = tl.cycle_sensitivity(tsc, ranges, n=16, lower=0.0, **options)
    >>> indices.table()[["parameter", "total"]].round(1)
      parameter  total
    0     upper    1.0
    1   human.a    0.0
    """
    _checked(tsc, ranges, lower, upper)
    if isinstance(quantities, str) or not quantities or not set(quantities) <= set(QUANTITIES):
        raise ValueError(f"quantities must be among {', '.join(QUANTITIES)}, got {quantities!r}")
    task = functools.partial(cycle_at, tsc=tsc, lower=lower, upper=upper, starts=1)
    return sobol_indices(task, ranges, n, results=list(quantities), **options)


def _checked(tsc: object, axes: object, lower: object, upper: object) -> list[str]:
    """Return the names varied, each known, each threshold given once."""
    of_class("tsc", tsc, TscModel)
    if not isinstance(axes, Mapping) or not axes:
        raise ValueError(
            "give what to vary by name, such as {'lower': [0.0, 0.1], 'human.beta': [0.7, 0.8]}"
        )
    for name in axes:
        one_of("what is varied", name, (*THRESHOLDS, *PARAMETERS))
    for name, value in (("lower", lower), ("upper", upper)):
        if (value is None) == (name not in axes):
            remedy = (
                "give it a value, or vary it"
                if value is None
                else "do not give it where it is varied"
            )
            raise ValueError(
                f"threshold {name} is {'missing' if value is None else 'there twice'}: {remedy}"
            )
        if value is not None:
            finite_number(name, value)
    return list(axes)
