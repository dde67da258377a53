"""What the dissertation prints, as strings, from data/published/."""

from functools import cache
from pathlib import Path

import pandas as pd

from trustlab.models.checks import did_you_mean, one_of
from trustlab.models.tsc import HumanModel, RobotModel, TscModel


class _MissingError(KeyError, ValueError):
    __str__ = ValueError.__str__  # a KeyError shows its words in quotation marks


class ByName(dict):
    """A dictionary by name whose error, of key and of value, lists its names."""

    def __missing__(self, key):
        meant, names = did_you_mean(key, self), ", ".join(map(repr, self))
        raise _MissingError(f"nothing is called {key!r:.60}{meant} (there are {names})")


def data_folder(name: str) -> Path:
    """Return a folder of data/ that comes with the package, installed or in the repository."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "data" / name
    return installed if installed.is_dir() else package.parent / "data" / name


def published_folder() -> Path:
    """Return the folder of printed tables."""
    return data_folder("published")


def published_table(number: str) -> pd.DataFrame:
    """
    Return a printed table as strings, trailing zeros kept.

    Parameters
    ----------
    number : str
        The table's number in the dissertation, for example "2.1".

    Returns
    -------
    pandas.DataFrame
        The first column is the index (the first two for Table 2.3); columns as printed.

    Raises
    ------
    ValueError
        If there is no such table; the error lists those there are.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.published_table("2.1").loc["beta"].tolist()
    ['0.95', '0.81', '0.8', '0.75', '0.71']
    """
    folder = published_folder()
    paths = {
        p.stem.removeprefix("table_").replace("_", "."): p
        for p in sorted(folder.glob("table_*.csv"))
    }
    name = one_of("number", str(number).strip() if isinstance(number, float) else number, paths)
    return _read(paths[name], 2 if name == "2.3" else 1).copy()


@cache
def _read(path: Path, levels: int = 1) -> pd.DataFrame:
    """Return a printed table, read once: every simulated run asks for several."""
    return pd.read_csv(path, dtype=str, index_col=list(range(levels)))


def printed_pilot() -> dict[str, str]:
    """Return the pilot operator's parameters as printed in Sections 2.2.2 and 2.2.3."""
    return _read(published_folder() / "pilot.csv")["pilot"].to_dict()


def published_models() -> dict[str, TscModel]:
    """
    Return the printed models: the pilot operator and the participants of Table 2.1.

    Returns
    -------
    dict of str to TscModel
        Keys "pilot", "1" … "5". b_pr follows from (2.3); the printed one is this, rounded to four
        decimals.

    Examples
    --------
    >>> import trustlab as tl
    >>> list(tl.published_models())
    ['pilot', '1', '2', '3', '4', '5']
    """
    return ByName(_models())


@cache
def _models() -> dict[str, TscModel]:
    """Return the models, made once."""
    models, pilot = {}, printed_pilot()
    for name, printed in ({"pilot": pilot} | published_table("2.1").to_dict()).items():
        value = {key: float(printed[key]) for key in pilot}
        human = HumanModel(value["a_r"], value["beta"], value["P_h_min"], value["P_h_max"])
        robot = RobotModel(value["a_pr"], value["P_r_min"], value["P_r_max"], value["P_h_max"])
        models[name] = TscModel(robot, human)
    return models
