"""The table: on the terminal, as CSV, and as one HTML page that needs nothing else."""

from __future__ import annotations

import csv
import html
from datetime import UTC, datetime
from pathlib import Path

from benchmarks import machine
from benchmarks.timing import Row

FOLDER = Path(__file__).resolve().parent.parent / "reports"
HEADINGS = ("case", "ours", "peer", "ours_ms", "peer_ms", "ratio", "goal", "met", "note")
METHOD = (
    "Median [least–greatest] of repetitions taken in turns, ours, peer, ours, peer …; ratio = "
    "peer's time / ours within each turn, so above 1 ours is faster. A repetition lasts at least "
    "5 ms (a quicker call is repeated and averaged). One BLAS thread everywhere; data in memory; "
    "freed memory stays with the process (glibc), which favours the peers; first calls "
    "(compilation) not counted unless a row says so. Peers' results were checked against ours "
    "before timing."
)


def cells(row: Row) -> list[str]:
    """
    Return a row as text, in the order of HEADINGS.

    Parameters
    ----------
    row : Row
        What was measured.
    """
    spreads = [spread.text() if spread else "" for spread in (row.ours_ms, row.peer_ms, row.ratio)]
    met = {True: "yes", False: "NO", None: ""}[row.met]
    if row.fault:
        spreads, met = ["", "", ""], "NOT COMPARED"
    return [row.case, row.ours, row.peer, *spreads, row.goal, met, row.fault or row.note]


def line(row: Row) -> str:
    """
    Return a row as one line, for progress.

    Parameters
    ----------
    row : Row
        What was measured.
    """
    _, _, peer, ours_ms, peer_ms, ratio, goal, met, note = cells(row)
    if row.fault:
        return f"{peer}: {met}: {note}"
    parts = [
        ours_ms and f"ours {ours_ms} ms",
        peer_ms and f"peer {peer_ms} ms",
        ratio and f"ratio {ratio}",
    ]
    parts += [goal and f"goal {goal}: {met}", note if not row.ours_ms else ""]
    return f"{peer}: " + ", ".join(part for part in parts if part)


def table(rows: list[Row]) -> str:
    """
    Return the numbers as an aligned table; ours and notes are in the files.

    Parameters
    ----------
    rows : list of Row
        What was measured.
    """
    shown = (0, 2, 3, 4, 5, 6, 7)
    lines = [[HEADINGS[i] for i in shown]] + [[cells(row)[i] for i in shown] for row in rows]
    lines = [[_cut(line[0], 34), _cut(line[1], 62), *line[2:]] for line in lines]
    widths = [max(len(line[i]) for line in lines) for i in range(len(shown))]
    text = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        for line in lines
    ]
    return "\n".join([text[0], "-" * len(text[0]), *text[1:]])


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"


def write(rows: list[Row], seconds: float) -> None:
    """
    Write benchmarks.csv and benchmarks.html.

    Parameters
    ----------
    rows : list of Row
        What was measured.
    seconds : float
        How long the whole run took.
    """
    FOLDER.mkdir(exist_ok=True)
    facts = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "duration": f"{seconds:.0f} s",
    } | machine.facts()
    _write_csv(FOLDER / "benchmarks.csv", rows)
    (FOLDER / "benchmarks.html").write_text(_page(rows, facts), encoding="utf-8")


def _write_csv(path: Path, rows: list[Row]) -> None:
    parts = ("median", "min", "max")
    spreads = [f"{name}_{part}" for name in ("ours_ms", "peer_ms", "ratio") for part in parts]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["case", "ours", "peer", *spreads, "goal", "met", "note"])
        for row in rows:
            numbers = []
            for spread in (row.ours_ms, row.peer_ms, row.ratio):
                numbers += [spread.median, spread.low, spread.high] if spread else ["", "", ""]
            case, ours, peer, *_, goal, met, note = cells(row)
            writer.writerow([case, ours, peer, *numbers, goal, met, note])


STYLE = """
body {
  font: 15px/1.45 system-ui, sans-serif; color: #1c2430;
  max-width: 90rem; margin: 2rem auto; padding: 0 1rem;
}
h1 { font-size: 1.5rem; }
h2 { font-size: 1.1rem; margin-top: 2rem; }
table { border-collapse: collapse; width: 100%; }
th, td {
  text-align: left; vertical-align: top; padding: .4rem .6rem; border-bottom: 1px solid #d8dde5;
}
th { border-bottom: 2px solid #1c2430; }
.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
.n small { display: block; color: #667; }
.yes { color: #176b3a; font-weight: 600; }
.no { color: #b3261e; font-weight: 600; }
.fault td { background: #fdecea; }
.note { color: #556; font-size: .88em; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1rem; }
dt { color: #556; }
dd { margin: 0; }
"""


def _page(rows: list[Row], facts: dict[str, str]) -> str:
    body, case = [], None
    for row in rows:
        name, ours, peer, *spreads, goal, met, note = (html.escape(cell) for cell in cells(row))
        if row.case != case:
            body.append(f'<tr><th colspan="6"><br>{name}</th></tr>')
            case = row.case
        numbers = "".join(f'<td class="n">{_stacked(text)}</td>' for text in spreads)
        kind = {"yes": "yes", "": ""}.get(met, "no")
        body.append(
            f'<tr class="{"fault" if row.fault else ""}"><td>{peer}<div class="note">ours: '
            f'{ours}</div><div class="note">{note}</div></td>{numbers}<td>{goal}</td><td '
            f'class="{kind}">{met}</td></tr>'
        )
    known = "".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd>" for k, v in facts.items())
    heads = "".join(f'<th class="n">{words}</th>' for words in ("ours, ms", "peer, ms", "ratio"))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>trustlab: benchmarks</title><style>{STYLE}</style></head><body>"
        f"<h1>Benchmarks</h1><p>{html.escape(METHOD)}</p>"
        f"<table><thead><tr><th>peer</th>{heads}<th>goal</th><th>met</th></tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table>"
        f"<h2>Measured on</h2><dl>{known}</dl></body></html>\n"
    )


def _stacked(text: str) -> str:
    median, _, spread = text.partition(" ")
    return f"{median}<small>{spread}</small>" if spread else median
