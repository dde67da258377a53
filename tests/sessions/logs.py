"""Recipes and bags that tests of sessions share; bags are written by rosbags alone."""

import shutil

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from trustlab.sessions import Recipe

START = 1_700_000_000_123_456_789  # [ns]
NUMBER, TEXT = "std_msgs/msg/Float64", "std_msgs/msg/String"


def table_recipe(text: str) -> Recipe:
    """Return a recipe for tables, whose times are seconds where it does not say."""
    time = "" if "[time]" in text else '[time]\nunit = "s"'
    return Recipe.from_toml(f'kind = "table"\n{text}\n{time}')


def bag_recipe(text: str) -> Recipe:
    return Recipe.from_toml(f'kind = "bag"\n{text}')


def stamped(stamp: int) -> dict:
    """Return the header of a message measured at a time [ns]."""
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}


def message(store, kind: str, values=None):
    """Return a message of these values, dictionaries within; what is left out is zero or empty."""
    values, content = values or {}, {}
    for name, (node, detail) in store.fielddefs[kind][1]:
        value = values.get(name)
        if node == Nodetype.NAME:
            value = message(store, detail, value)
        elif node == Nodetype.ARRAY:
            value = np.zeros(detail[1])
        elif node == Nodetype.SEQUENCE and detail[0][0] == Nodetype.NAME:
            value = [message(store, detail[0][1], each) for each in value or []]
        elif node == Nodetype.SEQUENCE and value is None:
            value = np.zeros(0)
        elif value is None:
            value = {"string": "", "bool": False}.get(detail[0], 0)
        content[name] = value
    return store.types[kind](**content)


class Bag:
    """Messages by topic, for a ROS 1 bag (.bag), an .mcap file or a rosbag2 folder."""

    def __init__(self, path):
        self.path, self.ros1 = path, path.suffix == ".bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        self.entries = []

    def add(self, topic: str, seconds: float, kind: str, **values) -> None:
        stamp = START + round(seconds * 1e9)
        self.entries.append((topic, stamp, kind, message(self.store, kind, values)))

    def numbers(self, topic: str, times, values=0.5) -> "Bag":
        """Add numbers at times [s]; return the bag."""
        for t, value in zip(times, np.broadcast_to(values, len(times)), strict=True):
            self.add(topic, t, NUMBER, data=float(value))
        return self

    def write(self):
        """Write the bag; return its path."""
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        mcap = self.path.suffix == ".mcap"
        folder = self.path.with_suffix(".folder") if mcap else self.path
        plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
        topics = {}
        with (
            Writer1(folder)
            if self.ros1
            else Writer2(folder, version=8, storage_plugin=plugin) as writer
        ):
            for topic, stamp, kind, message in self.entries:
                if (topic, kind) not in topics:
                    connection = writer.add_connection(topic, kind, typestore=self.store)
                    topics[topic, kind] = connection
                writer.write(topics[topic, kind], stamp, serialize(message, kind))
        if mcap:
            next(folder.glob("*.mcap")).rename(self.path)
            shutil.rmtree(folder)
        return self.path


def write_table(table, path):
    """Write a table as pandas writes the format that the path's end names; return the path."""
    if path.suffix == ".parquet":
        table.to_parquet(path)
    else:
        table.to_csv(path, sep="\t" if ".tsv" in path.name else ",", index=False)
    return path
