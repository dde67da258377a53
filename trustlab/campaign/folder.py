"""A campaign on disk: what it is, its parameters, and one Parquet file per finished chunk."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.identity import differences, parameter_texts
from trustlab.campaign.table import assembled

__all__ = ["Folder", "read_campaign"]

FORMAT = 1
MANIFEST, PARAMETERS, CHUNKS, LOCK = "campaign.json", "parameters.parquet", "chunks", ".lock"
CHUNK = re.compile(r"runs-(\d+)-(\d+)-([0-9a-f]{32})\.parquet")
PARTIAL = ".partial-"
ROWS = 65_536
"""Parameters in one piece of their file: no more than that are in memory as text."""


class Folder:
    """
    The files of one campaign; opened by one process at a time.

    Parameters
    ----------
    path : str or os.PathLike
        The folder; made if it is not there.
    identity : dict
        Task, seed and names of parameters, as text.
    parameters : sequence of dict
        Parameters of all runs.
    names : list of str
        Their names.
    fresh : bool
        Whether to remove an earlier campaign from the folder.

    Raises
    ------
    CampaignError
        If the folder cannot be written, is in use, holds other files, is damaged, or holds another campaign.
    """

    def __init__(
        self, path: object, identity: dict, parameters: Sequence[Mapping], names: list[str], fresh: bool
    ):
        self.path = _made(path)
        self._lock = _locked(self.path)
        try:
            if fresh:
                self._clear()
            self.spans = self._resumed(identity, parameters, names)
        except BaseException:
            self.close()
            raise

    def _resumed(
        self, identity: dict, parameters: Sequence[Mapping], names: list[str]
    ) -> list[tuple[int, int, Path]]:
        manifest = self.path / MANIFEST
        if not manifest.exists():
            _refuse_foreign(self.path)
            (self.path / CHUNKS).mkdir(exist_ok=True)
            digest = self._write_parameters(parameters, names)
            content = {"format": FORMAT, "runs": len(parameters), "parameters": digest, **identity}
            write_whole(
                manifest,
                json.dumps(content, indent=1, ensure_ascii=False).encode("utf-8", "backslashreplace"),
            )
        else:
            before = _manifest(self.path)
            changed = _changed(before, identity)
            digest = hashlib.sha256()
            for text in parameter_texts(parameters, names):
                digest.update(text.encode("utf-8", "backslashreplace") + b"\n")
            if digest.hexdigest() != before["parameters"]:
                changed.append(self._parameters_differ(parameters, names))
            if changed:
                raise CampaignError(
                    f"{self.path} holds another campaign: {'; '.join(changed)}. Use another folder for this one, or "
                    "fresh=True to remove what is there"
                )
        for leftover in [*self.path.glob(f"*{PARTIAL}*"), *(self.path / CHUNKS).glob(f"*{PARTIAL}*")]:
            leftover.unlink(missing_ok=True)  # what was being written when the process ended
        return _spans(self.path, len(parameters))

    def _write_parameters(self, parameters: Sequence[Mapping], names: list[str]) -> str:
        digest, schema = hashlib.sha256(), pa.schema([("parameters", pa.string())])
        partial = self.path / f"{PARAMETERS}{PARTIAL}{os.getpid()}"
        with partial.open("wb") as file, pq.ParquetWriter(file, schema, compression="zstd") as writer:
            piece: list[str] = []
            for text in parameter_texts(parameters, names):
                clean = text.encode("utf-8", "backslashreplace")
                digest.update(clean + b"\n")
                piece.append(clean.decode())
                if len(piece) == ROWS:
                    writer.write_table(pa.table({"parameters": piece}, schema))
                    piece = []
            if piece:
                writer.write_table(pa.table({"parameters": piece}, schema))
        _synced(partial)
        os.replace(partial, self.path / PARAMETERS)
        return digest.hexdigest()

    def _parameters_differ(self, parameters: Sequence[Mapping], names: list[str]) -> str:
        """Return where the parameters of the folder differ first from those given."""
        n = _manifest(self.path)["runs"]
        counts = "" if n == len(parameters) else f"{n:,} runs then, {len(parameters):,} now; "
        now = parameter_texts(parameters, names)
        run = 0
        try:
            file = pq.ParquetFile(self.path / PARAMETERS)
            for batch in file.iter_batches(columns=["parameters"]):
                for old in batch.column(0).to_pylist():
                    new = next(now, None)
                    if new is None:
                        return f"parameters changed: {counts}all {run:,} given are as they were"
                    if new.encode("utf-8", "backslashreplace").decode() != old:
                        return f"parameters changed: {counts}run {run} had {_cut(old)}, now has {_cut(new)}"
                    run += 1
        except (OSError, pa.ArrowException) as error:
            return f"parameters changed: {counts}those of the folder cannot be read ({error})"
        return f"parameters changed: {counts}the first {run:,} are as they were"

    def _clear(self) -> None:
        """Remove a campaign, chunks first, so that a kill leaves a folder that is refused rather than trusted."""
        _refuse_foreign(self.path, ours=True)
        for file in (self.path / CHUNKS).glob("*"):
            if CHUNK.fullmatch(file.name) or PARTIAL in file.name:
                file.unlink()
        for name in (MANIFEST, PARAMETERS):
            (self.path / name).unlink(missing_ok=True)

    def add(self, first: int, last: int, table: pa.Table) -> None:
        """
        Write a finished chunk: under a name that holds its digest, complete or not at all.

        Parameters
        ----------
        first, last : int
            Its first run and the one after its last.
        table : pyarrow.Table
            What `table.encoded` returned.

        Raises
        ------
        CampaignError
            If it cannot be written.
        """
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        data = sink.getvalue().to_pybytes()
        name = f"runs-{first:010d}-{last:010d}-{hashlib.sha256(data).hexdigest()[:32]}.parquet"
        path = self.path / CHUNKS / name
        try:
            write_whole(path, data)
        except OSError as error:
            raise CampaignError(
                f"cannot write {path}: {error.strerror or error}; finished chunks before it are safe: make room or "
                "restore access, and call again with the same arguments to go on"
            ) from error
        self.spans.append((first, last, path))

    def tables(self) -> Iterator[pa.Table]:
        """Yield the finished chunks."""
        for _, _, path in self.spans:
            yield _read_chunk(path)

    def close(self) -> None:
        """Let other processes use the folder."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def read_campaign(folder: str | os.PathLike) -> pd.DataFrame:
    """
    Read what a campaign has written so far, while it runs or after it was killed.

    Parameters
    ----------
    folder : str or os.PathLike
        The `out` of `run_campaign`.

    Returns
    -------
    pandas.DataFrame
        The columns of `run_campaign`, one row per finished run, in the order of runs; parameters that are not plain values
        are text. `attrs` holds runs, finished and failed.

    Raises
    ------
    CampaignError
        If there is no campaign in the folder, or a file of it is damaged.
    """
    path = Path(folder)
    if not (path / MANIFEST).is_file():
        raise CampaignError(f"{path} holds no campaign: {MANIFEST} is not there")
    manifest = _manifest(path)
    chunks = [_read_chunk(file) for _, _, file in _spans(path, manifest["runs"])]
    if not chunks:
        names = ["run", *manifest["names"], "failed", "error", "traceback"]
        table = pd.DataFrame({name: [] for name in names})
    else:
        table = assembled(chunks, manifest["names"], None)
    table.attrs = {"runs": manifest["runs"], "finished": len(table), "failed": int(table["failed"].sum())}
    return table


def write_whole(path: Path, data: bytes) -> None:
    """
    Write a file so that it is there complete or not at all, whenever the process or the machine stops.

    Parameters
    ----------
    path : pathlib.Path
        Where.
    data : bytes
        What.
    """
    partial = path.with_name(f"{path.name}{PARTIAL}{os.getpid()}")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise
    _synced(path.parent)


def _synced(path: Path) -> None:
    with contextlib.suppress(OSError):  # some systems cannot open or sync a folder
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _made(path: object) -> Path:
    if not isinstance(path, str | os.PathLike) or not str(path):
        raise CampaignError(f"out must be the path of a folder, got {path!r}")
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise CampaignError(f"out must be a folder, but {folder} is a file; give another name")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f"probe{PARTIAL}{os.getpid()}"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise CampaignError(
            f"cannot write in {folder}: {error.strerror or error}; choose a folder that you may write to"
        ) from error
    return folder


def _locked(folder: Path) -> object:
    """Hold the folder for this process; the system lets go when it ends, however it ends."""
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        return None
    file = (folder / LOCK).open("a")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise CampaignError(
            f"another process is running a campaign in {folder}; wait for it, stop it, or use another folder"
        ) from None
    except OSError:  # a file system without locks
        pass
    return file


def _refuse_foreign(folder: Path, ours: bool = False) -> None:
    """Refuse a folder with files of others, or with chunks of which nothing says what they are."""
    own = {PARAMETERS, LOCK, *((MANIFEST, CHUNKS) if ours else (CHUNKS,))}
    others = sorted(f.name for f in folder.iterdir() if f.name not in own and PARTIAL not in f.name)
    if others:
        raise CampaignError(
            f"{folder} holds other files ({', '.join(others[:3])}{' …' if len(others) > 3 else ''}) and no campaign; give a "
            "new or empty folder"
        )
    chunks = [] if ours or not (folder / CHUNKS).is_dir() else list((folder / CHUNKS).glob("*.parquet"))
    if chunks:
        raise CampaignError(
            f"{folder} is half a campaign: {len(chunks)} chunks, but {MANIFEST}, which says of what, is missing; restore "
            "it, use another folder, or fresh=True to remove what is there"
        )


def _manifest(folder: Path) -> dict:
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        known = (
            content["format"],
            content["runs"],
            content["parameters"],
            content["names"],
            content["task"],
            content["seed"],
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CampaignError(
            f"{path} cannot be read ({type(error).__name__}: {error}); restore it, use another folder, or fresh=True to "
            "remove what is there"
        ) from error
    if known[0] != FORMAT:
        raise CampaignError(
            f"{path} has format {known[0]}, this version reads {FORMAT}; use the version of trustlab that wrote it, or "
            "another folder"
        )
    return content


def _changed(before: dict, now: dict) -> list[str]:
    said = [f"the task changed: {text}" for text in differences(before["task"], now["task"])]
    if before["seed"] != now["seed"]:
        said.append(f"seed was {before['seed']}, is {now['seed']}")
    if before["names"] != now["names"]:
        said.append(f"parameters were {', '.join(before['names'])}, are {', '.join(now['names'])}")
    return said


def _spans(folder: Path, runs: int) -> list[tuple[int, int, Path]]:
    """Return first run, end and file of each chunk, in order."""
    spans = []
    for file in (folder / CHUNKS).glob("*.parquet"):
        match = CHUNK.fullmatch(file.name)
        if not match:
            raise CampaignError(f"{file} is no chunk of a campaign; remove it from the folder")
        spans.append((int(match[1]), int(match[2]), file))
    spans.sort(key=lambda span: span[:2])
    end = 0
    for first, last, file in spans:
        if not end <= first < last <= runs:
            raise CampaignError(
                f"{file} holds runs {first} to {last - 1}, which other chunks hold too or the campaign of {runs} runs does not "
                "have; remove it, and its runs are repeated"
            )
        end = last
    return spans


def _read_chunk(path: Path) -> pa.Table:
    first, last, digest = CHUNK.fullmatch(path.name).groups()
    try:
        data = path.read_bytes()
        if hashlib.sha256(data).hexdigest()[:32] != digest:
            raise ValueError("its content does not have the digest in its name")
        table = pq.read_table(pa.BufferReader(data))
        if not np.array_equal(table["run"].to_numpy(), np.arange(int(first), int(last))):
            raise ValueError("it holds other runs than its name says")
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        raise CampaignError(f"{path} is damaged: {error}; delete it, and its runs are repeated") from error
    return table


def _cut(text: str) -> str:
    return text if len(text) <= 200 else text[:197] + "…"
