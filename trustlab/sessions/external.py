"""Where third-party data lie, which the repository does not carry."""

import os
from pathlib import Path


def external_data(name: str) -> Path | None:
    """
    Return the folder of a third-party data set, or None where it is absent.

    Parameters
    ----------
    name : str
        The data set's folder, for example "autonomy_cl_trust"; looked for in the folder that the
        environment variable TRUSTLAB_DATA names, or else in data/external of the repository.
    """
    location = os.environ.get("TRUSTLAB_DATA")
    root = Path(location) if location else Path(__file__).resolve().parents[2] / "data" / "external"
    folder = root / name
    return folder if folder.is_dir() else None
