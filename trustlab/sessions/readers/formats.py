"""Logs of PX4 (ULog) and of the lab streaming layer (XDF), MATLAB files and HDF5: what the extra [formats] reads."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trustlab.models.extras import extra
from trustlab.sessions.errors import RecipeError, SessionError, alternatives, damage_named, listed
from trustlab.sessions.readers.bags import Series, series_log
from trustlab.sessions.readers.tables import arrow_log
from trustlab.sessions.readers.unpacking import Budget
from trustlab.sessions.recipe import Recipe, TopicField, mapped
from trustlab.sessions.resampling import RawLog

# Name of a topic: its times [ns], and its fields by name.
Topics = dict[str, tuple[np.ndarray, dict[str, Any]]]


def _guard(format: str):
    return damage_named(f"not a {format} file, or a damaged or truncated one", "copy it again")


def read_topics(path: Path, recipe: Recipe | None, wanted: Sequence[str] | None) -> RawLog:
    """Return a stream per topic of a ULog or XDF file; a field is named as there, or channel[0] and so on in XDF."""
    with extra("formats"):
        import pyulog
        import pyxdf
    ulog = path.suffix.lower() == ".ulg"
    with _guard("ULog" if ulog else "XDF"):
        if ulog:
            topics = _ulog_topics(pyulog.ULog(str(path)).data_list)
        else:
            # Clocks are brought together by the offsets in the file, as its recorder means it; times are not smoothed.
            topics = _xdf_topics(pyxdf.load_xdf(str(path), dejitter_timestamps=False)[0])
    if recipe is None:
        raise SessionError(f"a {path.suffix} file needs a recipe (topics: {listed(topics)})")
    groups: dict[str, list[TopicField]] = {}
    for rule in (recipe.columns[name] for name in wanted):
        if isinstance(rule, TopicField):
            if rule.topic not in topics:
                hint = alternatives(rule.topic, topics, "it has")
                raise SessionError(f"topic {rule.topic!r} (for {rule.name}) is not in the file{hint}")
            groups.setdefault(rule.topic, []).append(rule)
    series = []
    for topic, rules in groups.items():
        stamps, fields = topics[topic]
        if recipe.time.of(topic) == "header" or not len(stamps):
            what = "has one time only, that of receipt" if len(stamps) else "has no messages"
            raise RecipeError(f"topic {topic!r} {what}")
        values = {rule.name: _field(topic, rule, fields) for rule in rules}
        series.append(Series((topic, ""), rules, stamps, np.arange(len(stamps)), values))
    return series_log(str(path), series, {} if ulog else {"clocks": "brought together by the offsets in the file"})


def _field(topic: str, rule: TopicField, fields: dict[str, Any]) -> np.ndarray:
    where = f"topic {topic!r}, field {rule.path.text!r} ({rule.name})"
    if rule.path.text not in fields:
        raise RecipeError(f"{where}: there is no such field{alternatives(rule.path.text, fields, 'it has')}")
    values = fields[rule.path.text]
    if rule.map:
        return np.array([mapped(rule.map, value, f"{where}, message {k} (from 0)") for k, value in enumerate(values)])
    if np.asarray(values).dtype.kind not in "biuf":
        raise RecipeError(f"{where}: holds texts, not numbers; give it a map")
    return np.asarray(values, dtype=float)


def _ulog_topics(data_list) -> Topics:
    topics = {}
    for data in data_list:
        name = data.name if data.multi_id == 0 else f"{data.name}:{data.multi_id}"
        topics[name] = (data.data["timestamp"].astype(np.int64) * 1000, dict(data.data))
    return topics


def _xdf_topics(streams) -> Topics:
    topics: Topics = {}
    for stream in streams:
        info, series = stream["info"], stream["time_series"]
        columns = list(np.asarray(series).T) if len(series) else []
        fields = {f"channel[{k}]": column for k, column in enumerate(columns)}
        described = (info.get("desc") or [None])[0] or {}
        channels = (described.get("channels") or [None])[0] or {}
        labels = [(channel.get("label") or [""])[0] for channel in channels.get("channel", [])]
        fields |= {str(label): column for label, column in zip(labels, columns, strict=False) if label}
        name = info["name"][0]
        if name in topics:
            raise SessionError(f"two streams are called {name!r}, so that neither can be named in a recipe")
        topics[name] = (np.round(np.asarray(stream["time_stamps"], dtype=float) * 1e9).astype(np.int64), fields)
    return topics


def read_arrays(path: Path, recipe: Recipe | None, wanted: Sequence[str] | None, budget: Budget) -> RawLog:
    """Return the table that arrays of a MATLAB or HDF5 file make: "name", "group/name", or "name[1]" of a matrix."""
    import pyarrow as pa

    with _guard("MATLAB or HDF5"):
        arrays = dict(_matlab_arrays(path, budget) if path.suffix.lower() == ".mat" else _hdf5_arrays(path, budget))

        def load(names: list[str]) -> Any:
            columns = {name: arrays[name]() for name in names}
            sizes = {name: len(column) for name, column in columns.items()}
            if len(set(sizes.values())) > 1:
                found = ", ".join(f"{name} {size}" for name, size in sizes.items())
                raise SessionError(f"the columns differ in their number of values: {found}")
            return pa.table(columns)

        return arrow_log(str(path), pa.schema([(name, pa.null()) for name in arrays]), 1, load, recipe, wanted)


Arrays = Iterator[tuple[str, Callable[[], np.ndarray]]]


def _columns(name: str, shape: tuple[int, ...], read: Callable[[], np.ndarray]) -> Arrays:
    """Yield the columns of an array: a row of values counts as a column of them."""
    if len(shape) == 1 or (len(shape) == 2 and 1 in shape):
        yield name, lambda: read().ravel()
    elif len(shape) == 2:
        for k in range(shape[1]):
            yield f"{name}[{k}]", partial(lambda k: read()[:, k], k)


def _matlab_arrays(path: Path, budget: Budget) -> Arrays:
    from scipy import io

    try:
        found = io.whosmat(path)
    except NotImplementedError:  # from version 7.3 on, these are HDF5 files with rows and columns changed over
        yield from _hdf5_arrays(path, budget, transposed=True)
        return
    budget.take(sum(8 * math.prod(shape) for _, shape, _ in found))
    for name, value in io.loadmat(path, simplify_cells=True).items():
        parts = {f"{name}.{own}": each for own, each in value.items()} if isinstance(value, dict) else {name: value}
        for own, each in parts.items():
            if isinstance(each, np.ndarray) and each.dtype.kind in "biuf":
                yield from _columns(own, each.shape, partial(np.asarray, each))


def _hdf5_arrays(path: Path, budget: Budget, transposed: bool = False) -> Arrays:
    with extra("formats"):
        import h5py

    def read(name: str) -> np.ndarray:
        with h5py.File(path, "r") as file:
            budget.take(8 * math.prod(file[name].shape))
            values = file[name][()]
        return values.T if transposed else values

    with h5py.File(path, "r") as file:
        shapes: dict[str, tuple[int, ...]] = {}
        file.visititems(
            lambda name, item: shapes.update({name: item.shape}) if isinstance(item, h5py.Dataset) else None
        )
    for name, shape in shapes.items():
        yield from _columns(name, shape[::-1] if transposed else shape, partial(read, name))
