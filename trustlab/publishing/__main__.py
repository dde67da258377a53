"""``python -m trustlab.publishing``: notebooks to reports, from the command line."""

import argparse
import io
import signal
import sys
import textwrap
import time

from trustlab.publishing.notebooks import Built, publish
from trustlab.publishing.provenance import Checkout, duration


def _arguments(words: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m trustlab.publishing",
        description="Run notebooks/NN_*.ipynb and write one self-contained HTML report each, and "
        "reports/index.html. Notebooks run with their own folder as working directory.",
    )
    add = parser.add_argument
    add(
        "names", nargs="*", metavar="NAME", help="notebooks (01, 01_identification); all by default"
    )
    add(
        "-p",
        nargs=2,
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        help="a declared parameter",
    )
    add(
        "--jobs",
        default="auto",
        metavar="N",
        type=_jobs,
        help="notebooks run at once; auto: one per CPU",
    )
    add("--notebooks", metavar="DIR", help="folder of the notebooks (default: notebooks)")
    add("--reports", metavar="DIR", help="folder of the reports (default: reports)")
    add("--timeout", metavar="SECONDS", type=float, help="time limit of each cell (default: none)")
    add("--force", action="store_true", help="build also what is up to date")
    return parser.parse_args(words)


def _jobs(text: str) -> int | str:
    return text if text == "auto" else int(text)


def _complain(built: Built) -> None:
    failure = built.failure or {}
    words = [f"\n── {built.name}{built.where} ──", textwrap.indent(failure["source"], "    "), ""]
    print(*words, failure["traceback"], "", sep="\n", file=sys.stderr, flush=True)


def main(words: list[str] | None = None) -> int:
    """
    Publish as the command line says; return 0, 1 if a notebook failed, 2 for a wrong command, 130
    if interrupted.
    """
    options = _arguments(words)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # not every locale has "…"
    signal.signal(
        signal.SIGTERM, signal.default_int_handler
    )  # ends as Ctrl-C does: no kernel stays
    clock = time.monotonic()
    try:
        checkout = Checkout.find(notebooks=options.notebooks, reports=options.reports)
        if not checkout.external.is_dir():
            print(
                "no third-party data in TRUSTLAB_DATA or data/external: what needs them is left out"
            )
        built = publish(
            options.names,
            checkout=checkout,
            parameters=dict(options.p),
            jobs=options.jobs,
            force=options.force,
            timeout=options.timeout,
            report=lambda line: print(line, flush=True),
            on_failure=_complain,
        )
    except (ModuleNotFoundError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:  # a full disk, a folder that is not to be written
        print(f"error: {error}; make room, or name another folder with --reports", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\ninterrupted: every kernel is ended, no report is half made", file=sys.stderr)
        return 130
    counts = {
        state: sum(report.state == state for report in built)
        for state in ("built", "up to date", "failed")
    }
    told = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    print(f"{told}, in {duration(time.monotonic() - clock)}: {checkout.reports / 'index.html'}")
    return 1 if counts["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
