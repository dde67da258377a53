"""The WebAssembly file in wasmtime, as a page uses it: the arrays of a run in its memory."""

import base64
import struct

import pytest

from trustlab.live import build

wasmtime = pytest.importorskip("wasmtime")


class Module:
    """A run whose periods wasmtime computes."""

    def __init__(self, entry, memory):
        engine = wasmtime.Engine()
        self.store = wasmtime.Store(engine)
        module = wasmtime.Module(engine, build.WASM.read_bytes())
        self.exports = wasmtime.Instance(self.store, module, []).exports(self.store)
        self.heap, self.entry, self.plan, self.periods = self.exports["memory"], entry, memory, 0
        self.status = top = (self.exports["__heap_base"].value(self.store) + 64) & ~15
        size = sum(array["size"] + 16 for array in memory["arrays"])
        self.heap.grow(self.store, size // 65_536 + 2)
        self.at = {}
        top += 32
        names = memory["addresses"]
        for array in [*memory["arrays"], {"name": "addresses", "size": 8 * len(names)}]:
            self.at[array["name"]] = top
            if "data" in array:
                self.heap.write(self.store, base64.b64decode(array["data"]), top)
            top = (top + array["size"] + 15) & ~15
        places = struct.pack(f"<{len(names)}q", *(self.at[name] for name in names))
        self.heap.write(self.store, places, self.at["addresses"])

    def period(self, *command):
        """Compute a period; return how it ended, -1 for well."""
        first = self.periods * self.plan["every"]
        self.periods += 1
        arguments = first, first + self.plan["every"], *map(float, command), self.at["addresses"]
        status = self.status, self.status + 16
        assert self.exports[self.entry](self.store, *status, *arguments) == 0
        return struct.unpack("<i", self.heap.read(self.store, self.status, self.status + 4))[0]

    def numbers(self, array, offset, count=1):
        """Return numbers of an array."""
        where = self.at[array] + offset
        return list(
            struct.unpack(f"<{count}d", self.heap.read(self.store, where, where + 8 * count))
        )
