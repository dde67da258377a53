"""Parameters of a notebook that papermill runs."""

from collections.abc import Mapping, Sequence

from trustlab.models.checks import did_you_mean

PLAIN = (str, int, float, bool, list, tuple, dict, type(None))
IPYTHON = ("In", "Out")


def only_parameters(space: Mapping[str, object], declared: Sequence[str]) -> None:
    """
    Refuse a parameter that a notebook does not have: papermill only warns and runs without it.

    Parameters
    ----------
    space : mapping
        `globals()` of the notebook, right after its parameters.
    declared : sequence of str
        The names of its parameters.

    Raises
    ------
    ValueError
        If there is another plain value, with the nearest parameter.
    """
    for name, value in space.items():
        if name.startswith("_") or name in (*declared, *IPYTHON) or not isinstance(value, PLAIN):
            continue
        raise ValueError(
            f"this notebook has no parameter {name!r}{did_you_mean(name, declared)} "
            f"(it has {', '.join(declared)})"
        )
