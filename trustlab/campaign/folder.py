"""A campaign on disk: what it is, and one Parquet file per finished chunk."""

import contextlib
import hashlib
import json
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.identity import differences, parameter_texts, versions
from trustlab.campaign.table import assembled

FORMAT = 1
MANIFEST = "campaign.json"
CHUNKS = "chunks"
LOCK = ".lock"
CHUNK = re.compile(r"runs-(\d+)-(\d+)-([0-9a-f]{32})\.parquet")
PARTIAL = ".partial-"
ENTRIES = {
    "format": int,
    "runs": int,
    "parameters": str,
    "names": list,
    "task": dict,
    "seed": str,
    "versions": dict,
}
OWN = {MANIFEST, CHUNKS, LOCK}
REMEDY = "restore it, use another folder, or fresh=True to remove what is there"


class Folder:
    """
    The files of one campaign, opened by one process at a time; `spans` are first run, end and file
    of each chunk.
    """

    def __init__(
        self,
        path: object,
        identity: dict,
        parameters: Sequence[Mapping],
        fresh: bool,
        other_versions: Sequence[str],
    ):
        self.path = folder_path(path)
        with contextlib.ExitStack() as stack, writing_in(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            stack.enter_context(_held(self.path))
            if fresh:
                self._clear()
            if (self.path / MANIFEST).exists():
                self._check_same(identity, parameters)
                self._check_versions(other_versions)
            else:
                self._create(identity, parameters)
            for leftover in self.path.rglob(
                f"*{PARTIAL}*"
            ):  # what was being written when a process ended
                leftover.unlink(missing_ok=True)
            self.spans = _spans(self.path, len(parameters))
            self.close = stack.pop_all().close  # until then, other processes are kept out

    def _create(self, identity: dict, parameters: Sequence[Mapping]) -> None:
        """Write the manifest; chunks that are there without one are never trusted."""
        _refuse_foreign(self.path)
        chunks = self.path / CHUNKS
        chunks.mkdir(exist_ok=True)
        if any(chunks.glob("*.parquet")):
            raise CampaignError(
                f"{self.path} is half a campaign: {len(list(chunks.glob('*.parquet')))} chunks, "
                f"but {MANIFEST}, which says of what, is missing; {REMEDY}"
            )
        digest = _digest_of(parameters, identity["names"])
        content = {"format": FORMAT, "runs": len(parameters), "parameters": digest, **identity}
        self._write_manifest(content | {"versions": versions()})

    def _write_manifest(self, content: dict) -> None:
        text = json.dumps(content, indent=1, ensure_ascii=False)
        write_whole(self.path / MANIFEST, text.encode("utf-8", "backslashreplace"))

    def _check_versions(self, accepted: Sequence[str]) -> None:
        """
        Raise if results of other versions would be mixed with those of the folder, unless the user
        accepts it.
        """
        content = _manifest(self.path)
        before = content["versions"]
        changed = {name: now for name, now in versions().items() if before.get(name) != now}
        refused = [name for name in changed if name not in accepted]
        if refused:
            said = "; ".join(
                f"{name} was {before.get(name, 'not recorded')}, is {changed[name]}"
                for name in refused
            )
            raise CampaignError(
                f"{self.path} was begun with other versions, which may give other numbers: "
                f"{said}. Go on with those, or use another folder, fresh=True to remove what is "
                f"there, or other_versions={refused} to have both in one table"
            )
        for name, now in changed.items():
            known = before.get(name, "not recorded").split(", ")
            before[name] = ", ".join(dict.fromkeys([*known, now]))
        if changed:
            self._write_manifest(content)

    def _check_same(self, identity: dict, parameters: Sequence[Mapping]) -> None:
        """Raise if the folder holds another campaign, and say what changed."""
        before, names = _manifest(self.path), identity["names"]
        changed = [
            f"the task changed: {text}" for text in differences(before["task"], identity["task"])
        ]
        if before["seed"] != identity["seed"]:
            changed.append(f"seed was {before['seed']}, is {identity['seed']}")
        if before["names"] != names:
            changed.append(f"parameters were {', '.join(before['names'])}, are {', '.join(names)}")
        if _digest_of(parameters, names) != before["parameters"]:
            runs, now = before["runs"], len(parameters)
            found = (
                f"{runs:,} runs then, {now:,} now"
                if runs != now
                else "runs have other values, or another order"
            )
            changed.append(f"parameters changed: {found}")
        if changed:
            raise CampaignError(
                f"{self.path} holds another campaign: {'; '.join(changed)}. Use another folder "
                "for this one, or fresh=True to remove what is there"
            )

    def _clear(self) -> None:
        """
        Remove a campaign, chunks first, so that a kill leaves a folder that is refused rather than
        trusted.
        """
        _refuse_foreign(self.path)
        for file in (self.path / CHUNKS).glob("*"):
            if CHUNK.fullmatch(file.name) or PARTIAL in file.name:
                file.unlink()
        (self.path / MANIFEST).unlink(missing_ok=True)

    def add(self, table: pa.Table) -> None:
        """Write a finished chunk under a name that holds its digest, complete or not at all."""
        first = table["run"][0].as_py()
        last = first + len(table)
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        data = sink.getvalue().to_pybytes()
        path = self.path / CHUNKS / f"runs-{first:010d}-{last:010d}-{_digest(data)}.parquet"
        safe = (
            "finished chunks before it are safe: make room or restore access, and call again "
            "with the same arguments"
        )
        with writing_in(path.parent, safe):
            write_whole(path, data)
        self.spans.append((first, last, path))

    def __iter__(self) -> Iterator[pa.Table]:
        """Read the finished chunks one after the other."""
        for _, _, path in self.spans:
            yield _read_chunk(path)


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
        The columns of `run_campaign`, one row per finished run, in the order of runs; parameters
        that are not plain values are text. `attrs` holds runs, finished, failed, and the versions
        with which they were run.

    Raises
    ------
    CampaignError
        If there is no campaign in the folder, or a file of it is damaged.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> def task(upper, seed):
    ...     return {"double": 2 * upper}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     run = tl.run_campaign(task, [{"upper": 0.2}, {"upper": 0.3}], seed=0, n_jobs=1, out=folder)
    ...     table = tl.read_campaign(folder)
    >>> table.equals(run)
    True
    """
    path = Path(folder)
    if not (path / MANIFEST).is_file():
        raise CampaignError(f"{path} holds no campaign: {MANIFEST} is not there")
    manifest = _manifest(path)
    chunks = [_read_chunk(file) for _, _, file in _spans(path, manifest["runs"])]
    if chunks:
        table = assembled(chunks, manifest["names"], None)
    else:
        table = pd.DataFrame(columns=["run", *manifest["names"], "failed", "error", "traceback"])
    facts = {name: manifest[name] for name in ("runs", "versions")}
    table.attrs = facts | {"finished": len(table), "failed": int(table["failed"].sum())}
    return table


def write_whole(path: Path, data: bytes) -> None:
    """
    Write a file so that it is there complete or not at all, whenever the process or the machine
    stops.
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


def _digest_of(parameters: Sequence[Mapping], names: list[str]) -> str:
    """Return a digest that is the same for equal parameters of all runs, in their order."""
    digest = hashlib.sha256()
    for text in parameter_texts(parameters, names):
        digest.update(text.encode("utf-8", "backslashreplace") + b"\n")
    return digest.hexdigest()


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]


def folder_path(path: object) -> Path:
    """Return the path of a folder that is there or can be made."""
    if not isinstance(path, str | os.PathLike) or not os.fspath(path):
        raise CampaignError(f"out must be the path of a folder, got {path!r:.60}")
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise CampaignError(f"out must be a folder, but {folder} is a file; give another name")
    return folder


@contextlib.contextmanager
def writing_in(
    folder: Path, remedy: str = "choose a folder that has room and that you may write to"
) -> Iterator[None]:
    """Say in which folder the system refused to write."""
    try:
        yield
    except OSError as error:
        raise CampaignError(
            f"cannot write in {folder}: {error.strerror or error}; {remedy}"
        ) from error


def refuse(folder: Path, what: str, names: set[str]) -> None:
    """Raise if there are names of files that a folder must not hold."""
    if names:
        raise CampaignError(
            f"{folder} holds {what}, such as {min(names)}; give a new or empty folder"
        )


@contextlib.contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder; the system lets them in however this process ends."""
    with (folder / LOCK).open("a") as file:
        try:
            if sys.platform == "win32":
                import msvcrt

                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
            else:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):  # the second on Windows
            raise CampaignError(
                f"another process is running a campaign in {folder}; wait, or use another"
            ) from None
        except OSError:  # not every network file system has locks
            pass
        yield


def _refuse_foreign(folder: Path) -> None:
    """Raise if a folder holds files of others."""
    refuse(folder, "other files", {f.name for f in folder.iterdir() if PARTIAL not in f.name} - OWN)


def _manifest(folder: Path) -> dict:
    """Read what campaign a folder holds."""
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        wrong = [name for name, kind in ENTRIES.items() if not isinstance(content[name], kind)]
        texts = [*content["names"], *content["task"].values(), *content["versions"].values()]
        if wrong or not all(isinstance(text, str) for text in texts):
            raise ValueError(
                f"{', '.join(wrong) or 'names, task or versions'} is of no kind that a campaign "
                "writes"
            )
    except (OSError, LookupError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise CampaignError(
            f"{path} cannot be read ({type(error).__name__}: {error}); {REMEDY}"
        ) from error
    if content["format"] != FORMAT:
        raise CampaignError(
            f"{path} has format {content['format']}, this version reads {FORMAT}; use the version "
            "of trustlab that wrote it, or another folder"
        )
    return content


def _spans(folder: Path, runs: int) -> list[tuple[int, int, Path]]:
    """Return first run, end and file of each chunk, in order."""
    spans = []
    for file in (folder / CHUNKS).glob("*.parquet"):
        match = CHUNK.fullmatch(file.name)
        if not match:
            raise CampaignError(f"{file} is no chunk of a campaign; remove it from the folder")
        spans.append((int(match[1]), int(match[2]), file))
    spans.sort()
    end = 0
    for first, last, file in spans:
        if not end <= first < last <= runs:
            raise CampaignError(
                f"{file} holds runs {first} to {last - 1}, which other chunks hold too or the "
                f"campaign of {runs} runs does not have; remove it, and its runs are repeated"
            )
        end = last
    return spans


def _read_chunk(path: Path) -> pa.Table:
    first, last, digest = CHUNK.fullmatch(path.name).groups()
    try:
        data = path.read_bytes()
        if _digest(data) != digest:
            raise ValueError("its content does not have the digest in its name")
        table = pq.read_table(pa.BufferReader(data))
        table.select(["failed", "error", "traceback", "returned"])  # KeyError where one is missing
        if not np.array_equal(table["run"].to_numpy(), np.arange(int(first), int(last))):
            raise ValueError("it holds other runs than its name says")
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        raise CampaignError(
            f"{path} is damaged: {error}; delete it, and its runs are repeated"
        ) from error
    return table
