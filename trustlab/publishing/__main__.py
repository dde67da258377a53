"""``python -m trustlab.publishing``: notebooks to a book, from the command line."""

import argparse
import os
import signal
import sys
from pathlib import Path

from trustlab.publishing.book import publish, write_book
from trustlab.publishing.provenance import external_data


def _arguments(words: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m trustlab.publishing",
        description="Run notebooks/NN_*.ipynb where their inputs changed, and write the book of "
        "docs/ and them to reports/index.html.",
    )
    add = parser.add_argument
    add("names", nargs="*", metavar="NAME", help="notebooks (01, 01_identification); default: all")
    add(
        "-p",
        nargs=2,
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        help="a declared parameter",
    )
    add("--jobs", default="auto", metavar="N", help="notebooks run at once; auto: CPUs + 1")
    add("--timeout", metavar="SECONDS", type=float, help="time limit of each cell (default: none)")
    add("--force", action="store_true", help="run also what is up to date")
    add("--no-run", action="store_true", help="run nothing: write the book of what was run")
    return parser.parse_args(words)


def main(words: list[str] | None = None) -> int:
    """
    Publish as the command line says; return 0, 1 if a notebook or a page failed, 2 for a wrong
    command, 130 if interrupted.
    """
    options = _arguments(words)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does
    root = Path.cwd()
    built = []
    try:
        if not external_data(root).is_dir():
            print("no data in TRUSTLAB_DATA or data/external: what needs them is left out")
        if not options.no_run:
            built = publish(
                options.names,
                root=root,
                parameters=dict(options.p),
                jobs=options.jobs if options.jobs == "auto" else int(options.jobs),
                force=options.force,
                timeout=options.timeout,
                report=lambda line: print(line, flush=True),
            )
        whole = write_book(root)
    except (ModuleNotFoundError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\ninterrupted: no report is half made", file=sys.stderr, flush=True)
        os._exit(130)  # kernels end with the process that started them; threads would wait
    failed = [notebook for notebook in built if notebook.failure]
    for notebook in failed:
        print(f"\n── {notebook.name} failed in {notebook.failure}", file=sys.stderr)
    if not whole:
        print("\nthe book is not whole: python -m sphinx docs reports says why", file=sys.stderr)
    print(f"{len(built) - len(failed)} of {len(built)} notebooks: reports/index.html")
    return 0 if whole and not failed else 1


if __name__ == "__main__":
    sys.exit(main())
