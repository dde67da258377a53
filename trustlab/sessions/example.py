"""The sessions that come with the package."""

from trustlab.models.checks import did_you_mean
from trustlab.models.published import data_folder
from trustlab.sessions import Session, read_session


def example(name: str = "pilot") -> Session:
    """
    Read a session that comes with trustlab.

    Parameters
    ----------
    name : {"pilot"}
        The pilot operator of the dissertation, simulated: 33 minutes at 10 Hz, with `mode`, `p_r`
        and `p_h` [m/s].

    Returns
    -------
    Session
        The session, marked as synthetic in its metadata.

    Raises
    ------
    ValueError
        If there is no such session; the error lists those there are.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.sessions.example("pilot")
    >>> session.metadata.synthetic
    True
    """
    paths = {path.stem: path for path in data_folder("sessions").glob("*.csv")}
    if name not in paths:
        raise ValueError(
            f"no example is called {name!r}{did_you_mean(name, paths)}; "
            f"there are: {', '.join(sorted(paths))}"
        )
    return read_session(paths[name])
