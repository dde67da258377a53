"""
A campaign on disk: what it is, and one file per finished chunk.

The name of a chunk says which runs it holds, digests of their parameters and of its content: so a
campaign that grew finds what it can use, and damage is seen, before anything is read.
"""

import contextlib
import fcntl
import gzip
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.identity import differences, parameter_texts, versions
from trustlab.campaign.table import assembled, decoded, encoded
from trustlab.campaign.worker import Outcome
from trustlab.models.digest import digest
from trustlab.models.files import PARTIAL, write_atomically

FORMAT = 2
MANIFEST = "campaign.json"
CHUNKS = "chunks"
LOCK = ".lock"
WRITTEN = {MANIFEST, CHUNKS, LOCK}
CHUNK = re.compile(r"runs-(\d+)-(\d+)-([0-9a-f]{32})-([0-9a-f]{32})\.json\.gz")
REMEDY = "restore it, use another folder, or fresh=True to remove what is there"


class Chunk(NamedTuple):
    """A file with the outcomes of runs `first` to `last` − 1."""

    first: int
    last: int
    parameters: str
    content: str
    path: Path

    def read(self) -> tuple[list[dict], list[Outcome]]:
        """Return parameters, as far as a file keeps them, and outcomes."""
        try:
            data = gzip.decompress(self.path.read_bytes())
        except (OSError, EOFError, ValueError) as error:
            raise self._damaged(str(error)) from error
        if digest(data) != self.content:
            raise self._damaged("its content does not have the digest in its name")
        return decoded(data)

    def _damaged(self, reason: str) -> CampaignError:
        return CampaignError(
            f"{self.path} is damaged: {reason}; delete it, and its runs are repeated"
        )


class CampaignFolder:
    """The files of one campaign, open in one process at a time; `chunks` in the order of runs."""

    def __init__(
        self,
        path: object,
        identity: dict,
        parameters: Sequence[Mapping],
        fresh: bool,
        other_versions: Sequence[str],
    ):
        self.path = folder_path(path)
        self.names: list[str] = identity["names"]
        with contextlib.ExitStack() as stack, writing_in(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            stack.enter_context(_locked(self.path))
            if fresh:
                self._clear()
            # What was being written when a process ended.
            for leftover in self.path.rglob(f"*{PARTIAL}*"):
                leftover.unlink(missing_ok=True)
            self._open(identity, parameters, other_versions)
            self.close = stack.pop_all().close  # until then, other processes are kept out

    def _open(self, identity: dict, parameters: Sequence[Mapping], accepted: Sequence[str]) -> None:
        """Begin a campaign, or check that the one in the folder is the same, perhaps shorter."""
        refuse(self.path, "other files", {f.name for f in self.path.iterdir()} - WRITTEN)
        (self.path / CHUNKS).mkdir(exist_ok=True)
        self.chunks = _chunks(self.path)
        content = {"format": FORMAT, "runs": len(parameters), **identity, "versions": versions()}
        if (self.path / MANIFEST).exists():
            manifest = _manifest(self.path)
            self._check_same(manifest, identity, parameters)
            content["versions"] = self._merged_versions(manifest["versions"], accepted)
            if content == manifest:
                return
        elif self.chunks:
            raise CampaignError(
                f"{self.path} is half a campaign: {len(self.chunks)} chunks, but {MANIFEST}, "
                f"which says of what, is missing; {REMEDY}"
            )
        text = json.dumps(content, indent=1)
        write_atomically(self.path / MANIFEST, text)

    def _check_same(self, manifest: dict, identity: dict, parameters: Sequence[Mapping]) -> None:
        """Raise if the folder holds another campaign, and say what changed."""
        changes = [
            f"the task changed: {t}" for t in differences(manifest["task"], identity["task"])
        ]
        if manifest["seed"] != identity["seed"]:
            changes.append(f"seed was {manifest['seed']}, is {identity['seed']}")
        if manifest["names"] != self.names:
            before, after = ", ".join(manifest["names"]), ", ".join(self.names)
            changes.append(f"parameters were {before}, are {after}")
        else:
            changes += self._changed_parameters(parameters)
        if changes:
            raise CampaignError(
                f"{self.path} holds another campaign: {'; '.join(changes)}. Use another folder "
                "for this one, or fresh=True to remove what is there"
            )

    def _changed_parameters(self, parameters: Sequence[Mapping]) -> list[str]:
        """Say which stored runs have other parameters now; new runs come after all others."""
        for chunk in self.chunks:
            runs = f"runs {chunk.first} to {chunk.last - 1}"
            if chunk.last > len(parameters):
                return [f"it has {runs}, of {len(parameters):,} runs now"]
            if _digest_of(parameters[chunk.first : chunk.last], self.names) != chunk.parameters:
                return [
                    f"parameters changed: {runs} have other values, or another order (a campaign "
                    "may grow: runs that are added come last, as does a value that is added to the "
                    "first axis of a grid)"
                ]
        return []

    def _merged_versions(self, before: dict, accepted: Sequence[str]) -> dict:
        """Return the versions of all runs; raise if the user has not accepted a mixture."""
        merged = {}
        refused = []
        for name, version in versions().items():
            known = before.get(name, "not recorded").split(", ")
            merged[name] = ", ".join(dict.fromkeys([*known, version]))
            if known != [version] and name not in accepted:
                refused.append(name)
        if refused:
            changes = [
                f"{name} was {before.get(name, 'not recorded')}, is {versions()[name]}"
                for name in refused
            ]
            raise CampaignError(
                f"{self.path} was begun with other versions, which may give other numbers: "
                f"{'; '.join(changes)}. Go on with those, or use another folder, fresh=True to "
                f"remove what is there, or other_versions={refused} to have both in one table"
            )
        return merged

    def _clear(self) -> None:
        """Remove a campaign, chunks first: after a kill the folder is refused, not trusted."""
        refuse(self.path, "other files", {f.name for f in self.path.iterdir()} - WRITTEN)
        for file in (self.path / CHUNKS).glob("*"):
            if CHUNK.fullmatch(file.name) or PARTIAL in file.name:
                file.unlink()
        (self.path / MANIFEST).unlink(missing_ok=True)

    def store(self, first: int, parameters: Sequence[Mapping], outcomes: Sequence[Outcome]) -> None:
        """Write a finished chunk, complete or not at all."""
        data = encoded(parameters, outcomes)
        last = first + len(outcomes)
        digests = f"{_digest_of(parameters, self.names)}-{digest(data)}"
        path = self.path / CHUNKS / f"runs-{first:010d}-{last:010d}-{digests}.json.gz"
        remedy = (
            "finished chunks before it are safe: make room or restore access, and call again "
            "with the same arguments"
        )
        with writing_in(path.parent, remedy):
            write_atomically(path, gzip.compress(data, compresslevel=1, mtime=0))

    def outcomes(self) -> list[Outcome]:
        """Read the outcomes of all runs, in their order."""
        return [outcome for chunk in _chunks(self.path) for outcome in chunk.read()[1]]


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
    >>> runs = tl.parameter_grid(upper=[0.2, 0.3])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     run = tl.run_campaign(task, runs, seed=0, n_jobs=1, out=folder)
    ...     table = tl.read_campaign(folder)
    >>> table.equals(run)
    True
    """
    path = Path(folder)
    if not (path / MANIFEST).is_file():
        raise CampaignError(f"{path} holds no campaign: {MANIFEST} is not there")
    manifest = _manifest(path)
    runs: list[int] = []
    parameters: list[dict] = []
    outcomes: list[Outcome] = []
    for chunk in _chunks(path):
        values, results = chunk.read()
        runs += range(chunk.first, chunk.last)
        parameters += values
        outcomes += results
    columns = {name: [values[name] for values in parameters] for name in manifest["names"]}
    table = assembled(runs, outcomes, columns)
    facts = {name: manifest[name] for name in ("runs", "versions")}
    table.attrs = facts | {"finished": len(table), "failed": int(table["failed"].sum())}
    return table


def _digest_of(parameters: Sequence[Mapping], names: list[str]) -> str:
    """Return a digest that is the same for equal parameters of runs, in their order."""
    return digest(*parameter_texts(parameters, names))


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


def refuse(folder: Path, kind: str, names: set[str]) -> None:
    """Raise if there are names of files that a folder must not hold."""
    names = {name for name in names if PARTIAL not in name}
    if names:
        raise CampaignError(
            f"{folder} holds {kind}, such as {min(names)}; give a new or empty folder"
        )


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder; the system lets them in however this process ends."""
    with (folder / LOCK).open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise CampaignError(
                f"another process is running a campaign in {folder}; wait, or use another"
            ) from None
        except OSError:  # not every network file system has locks
            pass
        yield


def _manifest(folder: Path) -> dict:
    """Read what campaign a folder holds."""
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        form = content["format"]
        complete = {"runs", "names", "task", "seed", "versions"} <= content.keys()
    except (OSError, LookupError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise CampaignError(
            f"{path} cannot be read ({type(error).__name__}: {error}); {REMEDY}"
        ) from error
    if form != FORMAT or not complete:
        raise CampaignError(
            f"{path} has format {form}, this version reads {FORMAT}; use the version "
            "of trustlab that wrote it, or another folder"
        )
    return content


def _chunks(folder: Path) -> list[Chunk]:
    """Return the chunks of a campaign, in the order of runs; no two may hold the same run."""
    chunks = []
    for file in (folder / CHUNKS).iterdir():
        match = CHUNK.fullmatch(file.name)
        if match:
            chunks.append(Chunk(int(match[1]), int(match[2]), match[3], match[4], file))
        elif PARTIAL not in file.name:
            raise CampaignError(f"{file} is no chunk of a campaign; remove it from the folder")
    chunks.sort()
    end = 0
    for chunk in chunks:
        if not end <= chunk.first < chunk.last:
            raise CampaignError(
                f"{chunk.path} holds runs {chunk.first} to {chunk.last - 1}, which other chunks "
                "hold too; remove it, and its runs are repeated"
            )
        end = chunk.last
    return chunks
