"""
How guidance changes a comparison of schemes: simulated operators fly every scheme under every
guidance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np
import pandas as pd

from trustlab.campaign.run import run_campaign
from trustlab.models.checks import one_of, whole_number
from trustlab.models.display import axes_or_new
from trustlab.operators.teleoperator import Teleoperator
from trustlab.teleoperation.loop.schemes import SCHEMES, scheme_named
from trustlab.teleoperation.loop.settings import STUDY_NAMES
from trustlab.testbeds.populations import TeleoperatorPopulation
from trustlab.testbeds.teleoperation_measures import teleoperation_measures
from trustlab.testbeds.uav_tracking import simulate_teleoperation

# Keywords of `simulate_teleoperation` by the name under which a table shows them.
VARIANTS: Mapping[str, Mapping] = MappingProxyType(
    {
        "as printed, guard off": {"guidance": "through_channel", "guard": "off"},
        "as printed": {"guidance": "through_channel", "guard": "cancel"},
        "tank, empty": {"guidance": "tank"},
        "tank, 1 J": {"guidance": "tank", "tank": 1.0},
        "at the operator": {"guidance": "at_operator"},
        "two-port": {"guidance": "two_port"},
    }
)


@dataclass(frozen=True)
class GuidanceComparison:
    """
    Measures of simulated operators in every scheme under every guidance.

    Parameters
    ----------
    runs : pandas.DataFrame
        A row per run: guidance, and the columns of `teleoperation_measures`.
    """

    runs: pd.DataFrame

    def table(self) -> pd.DataFrame:
        """
        Return one row per guidance and scheme.

        Returns
        -------
        pandas.DataFrame
            guidance, scheme, n; tracking_error, its sd, guidance_felt, energy_target (means over
            operators); energy_port_min (the least of all runs: what the operator's port gave out at
            most [J]); better_than_m (share of operators who track better than in scheme M under the
            same guidance; NaN without M).
        """
        wide = self.runs.set_index(["guidance", "participant", "scheme"])[  # noqa: PD010
            "tracking_error"
        ].unstack()
        rows = []
        for (guidance, scheme), group in self.runs.groupby(["guidance", "scheme"], sort=False):
            here = wide.loc[guidance]
            better = float((here[scheme] < here["M"]).mean()) if "M" in here else np.nan
            row = {"guidance": guidance, "scheme": scheme, "n": len(group)}
            row |= {
                name: group[name].mean()
                for name in ("tracking_error", "guidance_felt", "energy_target")
            }
            row |= {
                "sd": group["tracking_error"].std(),
                "energy_port_min": group["energy_port_min"].min(),
            }
            rows.append(row | {"better_than_m": better})
        names = (
            "tracking_error",
            "sd",
            "guidance_felt",
            "energy_target",
            "energy_port_min",
            "better_than_m",
        )
        frame = pd.DataFrame(rows)[["guidance", "scheme", "n", *names]]
        frame.attrs["origin"] = "simulated operators"
        return frame

    def _repr_html_(self) -> str:
        return self.table().to_html()

    def plot(self, ax=None):
        """
        Plot the mean tracking error by scheme, a line per guidance.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes
        """
        ax = axes_or_new(ax, figsize=(7.6, 3.6))
        for mark, (guidance, group) in zip(
            "osD^vPX*", self.table().groupby("guidance", sort=False), strict=False
        ):
            ax.plot(group["scheme"], group["tracking_error"], f"{mark}-", lw=1.0, label=guidance)
        ax.set(ylabel="mean tracking error [m]", title="Synthetic data: simulated operators")
        ax.set_ylim(bottom=0.0)
        ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        return ax


def compare_guidance(
    operators: int = 30,
    schemes: Sequence[str] = tuple(SCHEMES),
    study: str = "main",
    seed: int = 0,
    duration: float = 120.0,
    variants: Mapping[str, Mapping] = VARIANTS,
    n_jobs: int = -1,
) -> GuidanceComparison:
    """
    Let simulated operators fly every scheme under every guidance.

    Every operator has one path, one series of losses of the target, delays and noise, the same in
    all runs, and the same as in `simulated_effects` with as many operators and this seed.

    Parameters
    ----------
    operators : int
        How many, of `TeleoperatorPopulation`.
    schemes : sequence of str
        Which schemes.
    study : {"main", "preliminary"}
        Whose settings.
    seed : int
        Of operators and runs.
    duration : float
        Of a run [s].
    variants : mapping of str to mapping
        Keywords of `simulate_teleoperation` by the name to show; the guidances of this package when
        not given.
    n_jobs : int
        Processes, as of `run_campaign`.

    Returns
    -------
    GuidanceComparison

    Raises
    ------
    ValueError
        If an argument is out of range.
    RuntimeError
        If a run fails; its error is quoted.
    """
    operators, seed = whole_number("operators", operators), whole_number("seed", seed, least=0)
    one_of("study", study, STUDY_NAMES)
    cells = [
        {"guidance": name, "scheme": scheme_named(scheme).name, "participant": number + 1}
        for name in variants
        for scheme in schemes
        for number in range(operators)
    ]
    fixed = {"operators": operators, "study": study, "start": seed, "duration": duration}
    plans = [cell | fixed | {"variant": dict(variants[str(cell["guidance"])])} for cell in cells]
    runs = run_campaign(_flown, plans, seed=seed, n_jobs=n_jobs, progress=False)
    if runs["failed"].any():
        raise RuntimeError(f"a run failed: {runs.loc[runs['failed'], 'error'].iloc[0]}")
    return GuidanceComparison(runs)


@lru_cache
def _people(operators: int, start: int, study: str) -> list[Teleoperator]:
    """Return the operators of a comparison."""
    population = TeleoperatorPopulation(study)
    rows = population.draw(operators, start).to_dict("records")
    return [population.person(row) for row in rows]


def _flown(
    guidance, scheme, participant, operators, study, start, duration, variant, seed
) -> dict[str, float]:
    """
    Return the measures of one run; its seed is the operator's, not the campaign's, so that all runs
    are paired.
    """
    person = _people(operators, start, study)[participant - 1]
    stream = np.random.SeedSequence(start, spawn_key=(participant - 1,))
    run = simulate_teleoperation(scheme, person, study, seed=stream, duration=duration, **variant)
    row = teleoperation_measures(run).iloc[0].drop(["participant", "scheme", "synthetic"])
    return {name: float(value) for name, value in row.items()}
