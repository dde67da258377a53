"""
What a live study has recorded so far: sessions, measures, answers, and a report with the whole
analysis.
"""

import csv
import io
import os
import zipfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from trustlab.live.log import read_log
from trustlab.live.study.pages import Step
from trustlab.live.study.participant import Attempt, progress_of
from trustlab.live.study.plan import EVENTS, PLAN, LiveStudy, file_origin, read_links
from trustlab.live.task import LEAST_ROWS
from trustlab.live.trial import Record
from trustlab.models.display import Result
from trustlab.models.extras import extra
from trustlab.models.files import path_of, write_atomically
from trustlab.sessions.session import Session
from trustlab.sessions.vocabulary import VOCABULARY
from trustlab.studies.order_effects import OrderEffects, order_effects
from trustlab.studies.questionnaires import ScaleScores, score
from trustlab.studies.repeated_measures import RepeatedMeasures, repeated_measures

KEYS = ["participant", "position", "condition"]
REHEARSAL = "scripted hands, no person took part"
FACTS = (
    "attempt",
    "verified",
    "thresholds_from",
    "period_median",
    "period_max",
    "delay",
    "seen_late",
)
"""Metadata of a drive that its measures begin with."""


MEANINGS = Path(__file__).with_name("export.csv")
"""Names, units and meanings of the columns that are no signals."""

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a spreadsheet takes for the beginning of a formula."""

PACKAGE = Path(__file__).parents[2]
NOTEBOOK = Path(__file__).with_name("report.ipynb")


class ParticipantRecord:
    """
    A participant's way through the study, their events up to the first line that was changed, where
    these lead to, and what is wrong with their file.

    `link` is what was written down of the events beside the study.
    """

    def __init__(self, plan: LiveStudy, code: str, link: str | None):
        path = plan.folder / code / f"{EVENTS}.jsonl"
        reading = read_log(path, file_origin(plan.digest, code, EVENTS))
        self.steps, self.events = plan.steps(code), reading.entries
        self.progress = progress_of(self.events)
        self.fault = reading.fault if link or path.exists() else ""  # else nothing has happened yet
        if not self.fault and link not in (None, *reading.links):
            self.fault = f"{path.name}: its last lines are missing"


class RecordedDrive(NamedTuple):
    """
    An attempt at a drive that events tell of, whether it is the one that was driven to its end,
    what its log says, and what is wrong with that.
    """

    attempt: Attempt
    finished: bool
    record: Record | None
    fault: str


def read_live_study(folder: str | os.PathLike) -> "RecordedStudy":
    """
    Read what a live study has recorded, finished or not; nothing in the folder changes.

    Parameters
    ----------
    folder : path-like
        The study's folder.

    Returns
    -------
    RecordedStudy

    Raises
    ------
    ValueError
        If there is no study in the folder, or its plan is not as it was frozen.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> folder = tempfile.mkdtemp() + "/rehearsal"
    >>> plan = tl.LiveStudy(folder, ["C1", "C3"], participants=4, seed=0, rehearsal=True)
    >>> tl.read_live_study(plan.folder).participants[["participant", "order", "pages_done"]]
      participant  order  pages_done
    0         P01  C3 C1           0
    1         P02  C1 C3           0
    2         P03  C1 C3           0
    3         P04  C3 C1           0
    """
    return RecordedStudy(LiveStudy.open(folder))


class RecordedStudy(Result):
    """
    A live study as it stands on the disk.

    Parameters
    ----------
    plan : LiveStudy
        The frozen plan.

    Attributes
    ----------
    records : dict of str to ParticipantRecord
        What each participant's events say, by code.
    deleted : list of str
        Codes of the participants who were deleted.
    task : LiveTask
        What people do.
    origin : str
        What kind of data these are where no person took part; else empty.
    """

    def __init__(self, plan: LiveStudy):
        links = read_links(plan.folder)
        self.plan, self.task, self.deleted = plan, plan.task, plan.deleted()
        self.origin = REHEARSAL if plan.rehearsal else ""
        self.records = {
            code: ParticipantRecord(plan, code, links.get(code)) for code in plan.present()
        }

    @property
    def title(self) -> str:
        """Which study."""
        return self.plan.title

    @property
    def message(self) -> str:
        """The summary."""
        return self.summary()

    @cached_property
    def _drives(self) -> list[RecordedDrive]:
        """
        Every attempt at a drive that events tell of; one that was begun again before its first
        command is the same.
        """
        drives = []
        for code, record in self.records.items():
            begun = [(e["page"], e["attempt"]) for e in record.events if e["kind"] == "begin"]
            for page, number in dict.fromkeys(begun):
                attempt = Attempt(self.plan, code, record.steps[page], number)
                end = record.progress.done.get(page, {})
                finished = end.get("attempt") == number
                log = attempt.read(end["link"] if finished else None)
                drives.append(RecordedDrive(attempt, finished, *log))
        return drives

    @cached_property
    def _conditions(self) -> dict[tuple[str, str | None], RecordedDrive]:
        """
        The finished drive of each participant and condition, with what is wrong with the files that
        it rests on.
        """
        drives = {}
        for drive in self._drives:
            code, step = drive.attempt.code, drive.attempt.step
            if drive.finished and step.page.name == "drive":
                faults = filter(None, (self.records[code].fault, drive.fault))
                drives[code, step.condition] = drive._replace(fault="; ".join(faults))
        return drives

    @cached_property
    def _sessions(self) -> list[Session]:
        return [
            drive.attempt.session(drive.record, drive.fault)
            for drive in self._conditions.values()
            if drive.record and len(drive.record.rows) >= LEAST_ROWS
        ]

    def faults(self) -> pd.DataFrame:
        """
        Return which files are not as the study wrote them.

        Every line is linked to the lines before it and to the plan, the last link of everybody's
        events is kept beside the study, and every drive is replayed from its commands. A drive is
        `verified` if nothing is wrong with its log and its participant's events. What
        links cannot prove: that nobody wrote all lines anew who also has the file beside the study,
        or cut the last lines of a drive that is not finished.

        Returns
        -------
        pandas.DataFrame
            Columns participant, file, fault; no rows if nothing was changed.
        """
        rows = [(code, f"{EVENTS}.jsonl", record.fault) for code, record in self.records.items()]
        rows += [
            (drive.attempt.code, drive.attempt.path.name, drive.fault) for drive in self._drives
        ]
        return _with_reason(rows, ["participant", "file", "fault"])

    def sessions(self) -> list[Session]:
        """Return the sessions of all drives under a condition, the last attempt of each."""
        return list(self._sessions)

    @property
    def participants(self) -> pd.DataFrame:
        """
        Where everybody is.

        A row per participant who was not deleted: participant, group (if there are groups), order,
        pages_done, pages, drives (finished, of those under a condition), complete, ended,
        withdrawn, completion (code of who enrolled), attention (checks of attention that were
        answered otherwise than expected), model (where model and thresholds come from), why (they
        stand in), restarts, notes; scores of the questionnaires that belong to no drive.
        """
        rows = []
        for code, record in self.records.items():
            now, pages = record.progress, len(record.steps) - 1
            model = now.model or {}
            done = [step for step in record.steps if step.index in now.done]
            rows.append(
                {
                    "participant": code,
                    "order": " ".join(self.plan.orders[code]),
                    "pages_done": len(now.done),
                    "pages": pages,
                    "drives": sum(step.page.name == "drive" for step in done),
                    "complete": len(now.done) == pages,
                    "ended": now.ended,
                    "withdrawn": now.withdrawn,
                    "completion": now.completion,
                    "attention": sum(_inattentive(step, now.answers(step.index)) for step in done),
                    "model": model.get("source", ""),
                    "why": model.get("why", ""),
                    "restarts": sum(now.attempts.values()),
                    "notes": "; ".join(note["text"] for note in now.notes if "text" in note),
                }
            )
        return self._labelled(self._with_scores(pd.DataFrame(rows), "participant"))

    def _with_scores(self, table: pd.DataFrame, *keys: str) -> pd.DataFrame:
        """Join the scores of those questionnaires that are answered once for each of the keys."""
        for scored in self.scores().values():
            if ("condition" in scored.scores) == ("condition" in keys):
                columns = scored.scores.filter(regex="_(raw|mean|subscale)$").columns
                table = table.merge(scored.scores[[*keys, *columns]], how="left", on=[*keys])
        return table

    def _labelled(self, frame: pd.DataFrame, group: bool = True) -> pd.DataFrame:
        """Add groups, if there are any; say where numbers come from, if not from people."""
        if group and self.plan.groups and len(frame):
            frame.insert(1, "group", frame["participant"].map(self.plan.groups))
        if self.origin:
            frame.attrs["origin"] = self.origin
        return frame

    def answers(self) -> pd.DataFrame:
        """
        Return all answers.

        Returns
        -------
        pandas.DataFrame
            A row per answer: participant, position and condition (NaN and None for pages that
            belong to no drive), page, item, answer (NaN where it is words), text.
        """
        rows = []
        for code, record in self.records.items():
            for step in record.steps:
                place = (code, step.position, step.condition, step.page.name)
                for item, answer in record.progress.answers(step.index).items():
                    parts = (np.nan, answer) if isinstance(answer, str) else (answer, "")
                    rows.append((*place, item, *parts))
        frame = pd.DataFrame(rows, columns=[*KEYS, "page", "item", "answer", "text"])
        types = {"position": float, "answer": float, "text": "str"}
        return self._labelled(frame.astype(types), group=False)

    def scores(self) -> dict[str, ScaleScores]:
        """
        Return the scores of every questionnaire that is scored and answered, by the name of its
        page; answers in a file that was changed are not scored.
        """
        answers = self.answers()
        changed = [code for code, record in self.records.items() if record.fault]
        answers = answers[~answers["participant"].isin(changed)]
        scores = {}
        for page in self.plan.pages:
            rows = answers[answers["page"] == page.name]
            if page.scored and len(rows):
                form = page.questionnaire
                rows = rows[rows["item"].isin(form.items)]
                condition = "condition" if page.section == "each" else None
                keys = ["participant", "condition"] if condition else ["participant"]
                wide = rows.pivot_table("answer", keys, "item", sort=False).reset_index()
                wide.attrs = answers.attrs
                scores[page.name] = score(wide, form, subject="participant", condition=condition)
        return scores

    @property
    def measures(self) -> pd.DataFrame:
        """
        The measures of every finished drive under a condition, and the scores of the questionnaires
        after it.

        A row per drive: participant, position, condition, synthetic, attempt, verified (whether a
        replay of its commands gives its rows and its files are as they were written),
        thresholds_from, period_median and period_max [s] of the log, pauses, delay (how old the
        pictures were on which the person acted, 97th percentile [s]), seen_late (whether that is
        more than a period beyond the camera's); the measures of the
        task, for the ground robot those of `run_condition` (p_r, p_h, r, tsc, path_error, speed,
        manual_share, switches, laps, duration, lap_time, suggestions, followed_percent);
        tlx_raw, trust_mean, satisfaction_mean and whatever other questionnaires score, NaN where
        they are not answered yet.
        """
        rows = []
        for session in self._sessions:
            meta = session.metadata
            rows.append(
                {
                    "participant": meta.participant,
                    "position": meta.more["position"],
                    "condition": meta.condition,
                    "synthetic": meta.synthetic,
                    **{name: meta.more.get(name, np.nan) for name in FACTS},
                    "pauses": len(meta.more["pauses"]),
                    **self.task.measures(session),
                }
            )
        if not rows:
            return pd.DataFrame(columns=[*KEYS, "verified"])
        return self._labelled(self._with_scores(pd.DataFrame(rows), "participant", "condition"))

    def exclusions(self) -> pd.DataFrame:
        """
        Return what an analysis leaves out, and why.

        Returns
        -------
        pandas.DataFrame
            Columns participant, condition, reason: drives that are not finished or have a
            file with a fault, and the participants who are left out with them, as every condition
            is needed of each.
        """
        rows = []
        for code, record in self.records.items():
            for condition in self.plan.orders[code]:
                drive = self._conditions.get((code, condition))
                undriven = record.fault or "not driven to its end"
                rows.append((code, condition, drive.fault if drive else undriven))
        return _with_reason(rows, ["participant", "condition", "reason"])

    def complete(self) -> pd.DataFrame:
        """Return the measures of those participants who have all conditions, each verified."""
        measures, left_out = self.measures, set(self.exclusions()["participant"])
        return measures[~measures["participant"].isin(left_out)].reset_index(drop=True)

    def analysis(self, dv: str) -> RepeatedMeasures:
        """
        Return the repeated-measures analysis of one measure over the conditions, of the complete
        participants who have it; all others who have begun are in `.excluded`.

        Parameters
        ----------
        dv : str
            A column of `measures`.

        Raises
        ------
        ValueError
            If there are too few such participants, or the measure has no variance.
        """
        between, order = "group" if self.plan.groups else None, self.plan.content["conditions"]
        rows = [
            (code, condition)
            for code, record in self.records.items()
            if record.progress.done or record.fault
            for condition in self.plan.orders[code]
        ]
        begun = self._labelled(pd.DataFrame(rows, columns=["participant", "condition"]))
        frame = begun.merge(self._for_analysis(), how="left")
        return repeated_measures(
            frame, dv, "condition", "participant", between=between, order=order, missing="listwise"
        )

    def order_effects(self, dv: str) -> OrderEffects:
        """
        Return the tests of sequence, position and carry-over of one measure, of complete
        participants.

        Parameters
        ----------
        dv : str
            A column of `measures`.

        Raises
        ------
        ValueError
            As for `analysis`.
        """
        order = self.plan.content["conditions"]
        return order_effects(
            self._for_analysis(), dv, "condition", "position", subject="participant", order=order
        )

    def _for_analysis(self) -> pd.DataFrame:
        frame = self.complete()
        if frame.empty:
            raise ValueError("0 participants have all conditions; exclusions() says why")
        return frame

    def summary(self) -> str:
        """
        Return in a sentence or two how many took part, are complete, are left out, and were
        deleted.
        """
        complete = self.complete()["participant"].nunique()
        begun = sum(bool(record.progress.done) for record in self.records.values())
        origin = f" Rehearsal: {self.origin}." if self.origin else ""
        return (
            f"{len(self.plan.orders)} participants planned, {begun} begun, {complete} complete "
            f"and verified; {len(self.deleted)} deleted at their request or the lab's, of whom "
            f"nothing is left.{origin}"
        )

    def report(self, path: str | os.PathLike | None = None) -> Path:
        """
        Write the report of the study: a notebook with the whole analysis, run by papermill and laid
        out like all reports.

        Parameters
        ----------
        path : path-like, optional
            Where; `report.html` in the study's folder when not given. Deleting a participant
            removes reports there, and only there.

        Returns
        -------
        pathlib.Path
            The page.

        Raises
        ------
        ValueError
            If a cell of the notebook fails.
        ModuleNotFoundError
            If the extra ``reports`` is not installed.
        """
        from trustlab.publishing.chapter import chapter
        from trustlab.publishing.run import anonymous, execute, provenance

        with extra("reports"):
            import nbformat
            from nbconvert import HTMLExporter

        folder = self.plan.folder
        target = folder / "report.html" if path is None else Path(path)
        run = execute(NOTEBOOK, {}, folder)
        origin = provenance(PACKAGE.parent, NOTEBOOK, run) | {"Data": PLAN}
        exporter = HTMLExporter(template_name="basic", embed_images=True, exclude_input=True)
        body, _ = exporter.from_notebook_node(nbformat.reads(chapter(run, origin), as_version=4))
        page = NOTEBOOK.with_suffix(".html").read_text(encoding="utf-8")
        page = page.replace("{body}", body).replace(str(folder), folder.name)
        write_atomically(target.absolute(), anonymous(page, PACKAGE.parent))
        return target

    def export(self, path: str | os.PathLike | None = None) -> Path:
        """
        Write everything as one zip: participants, answers, measures, samples of every drive,
        exclusions and faults, each as CSV and Parquet, and a README with what columns mean. The
        words of the items are in `study.json`.

        Parameters
        ----------
        path : path-like, optional
            Where; `report-data.zip` in the study's folder when not given. Deleting a participant
            removes it there, and only there.

        Returns
        -------
        pathlib.Path
            The zip.
        """
        tables = {
            "participants": self.participants,
            "answers": self.answers(),
            "measures": self.measures,
            "samples": samples_of(self._sessions),
            "exclusions": self.exclusions(),
            "faults": self.faults(),
        }
        target = self.plan.folder / "report-data.zip" if path is None else path_of("path", path)
        write_export(target, tables, f"{self.title}. {self.message}", self.task.name)
        return target

    def table(self) -> pd.DataFrame:
        """Return `measures`."""
        return self.measures


def _with_reason(rows: list[tuple[str, str, str]], columns: list[str]) -> pd.DataFrame:
    return pd.DataFrame([row for row in rows if row[-1]], columns=columns)


def _inattentive(step: Step, answers: dict) -> int:
    """Return how many checks of attention on a page were answered otherwise than expected."""
    return sum(
        item.expected is not None and answers.get(item.name, item.expected) != item.expected
        for item in step.page.items
    )


# files
# --------------------------------------------------------------------------------------------------


def write_export(
    path: Path, tables: Mapping[str, pd.DataFrame], about: str, task: str = ""
) -> None:
    """
    Write tables by name, and a README with what is said about them as a whole, and what columns
    mean in a task, as a zip.

    Entries carry no time of writing, so that the same study gives the same bytes. In a CSV file an
    apostrophe stands before words that a spreadsheet would take for a formula.
    """
    files: dict[str, str | bytes] = {}
    for name, table in tables.items():
        words = table.select_dtypes(["object", "string"]).map(_harmless)
        files[f"{name}.csv"] = table.assign(**words).to_csv(index=False)
        files[f"{name}.parquet"] = table.to_parquet(index=False)
    files["README.txt"] = _readme(tables, about, task)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in files.items():
            entry = zipfile.ZipInfo(name)
            entry.external_attr = 0o644 << 16  # else unzip makes files that nobody may read
            archive.writestr(entry, text, zipfile.ZIP_DEFLATED)
    write_atomically(path, content.getvalue())


def _harmless(value: object) -> object:
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def _readme(tables: Mapping[str, pd.DataFrame], about: str, task: str) -> str:
    """Return what the columns mean, with their units."""
    with MEANINGS.open(encoding="utf-8", newline="") as file:
        own = {name: (unit, meaning) for name, unit, meaning in csv.reader(file)}
    lines = [about, ""]
    for name, table in tables.items():
        lines += [f"{name}.csv, {name}.parquet: {len(table)} rows"]
        for column in map(str, table):
            unit, meaning = own.get(f"{task}.{column}") or own.get(column) or _score(column)
            if name == "samples" and (signal := VOCABULARY.get(column)):  # not a drive's mean of it
                unit, meaning = unit if signal.unit == "measure" else signal.unit, signal.meaning
            lines.append(f"  {column}{f' [{unit}]' if unit else ''}: {meaning}")
    return "\n".join(lines) + "\n"


def _score(column: str) -> tuple[str, str]:
    """Return unit and meaning of the score of a questionnaire."""
    page, _, kind = column.rpartition("_")
    return "", f"{SCORES[kind]} {page}" if kind in SCORES else ""


SCORES = dict.fromkeys(("raw", "mean"), "mean score of the questionnaire")
SCORES["subscale"] = "score of the subscale"


def samples_of(sessions: list[Session]) -> pd.DataFrame:
    """Return every sample of drives as one table."""
    tables = {}
    for session in sessions:
        meta = session.metadata
        tables[meta.participant, meta.more["position"], meta.condition] = session.data
    names = ["participant", "position", "condition", "t"]
    return pd.concat(tables, names=names).reset_index() if tables else pd.DataFrame()
