"""``python -m trustlab.publishing``: notebooks to reports, from the command line."""

import argparse
import signal
import sys
import time

from trustlab.publishing.html_report import duration
from trustlab.publishing.inputs import Checkout
from trustlab.publishing.notebooks import publish


def _parser():
    parser = argparse.ArgumentParser(
        prog="python -m trustlab.publishing",
        description="Run notebooks/NN_*.ipynb and write one self-contained HTML report each, and reports/index.html. "
        "Notebooks run with their own folder as working directory.",
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="notebooks to publish (01, 01_identification); all by default",
    )
    parser.add_argument(
        "--jobs", default="auto", metavar="N", help="notebooks run at once; auto: as many as there are CPUs"
    )
    parser.add_argument(
        "-p",
        dest="parameters",
        nargs=2,
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        help="a parameter notebooks declare",
    )
    parser.add_argument("--notebooks", metavar="DIR", help="folder of the notebooks (default: notebooks)")
    parser.add_argument("--reports", metavar="DIR", help="folder of the reports (default: reports)")
    parser.add_argument("--force", action="store_true", help="build also what is up to date")
    return parser


def _say(line):
    print(line, flush=True)


def _complain(built):
    failure = built.failure
    where = f", cell {failure['cell']}" if failure["cell"] is not None else ""
    lines = [f"\n── {built.name}{where} ──"]
    if failure["source"]:
        lines += [f"    {line}" for line in failure["source"].splitlines()] + [""]
    print("\n".join([*lines, failure["traceback"] or failure["error"], ""]), file=sys.stderr, flush=True)


def _interrupt(number, frame):
    raise KeyboardInterrupt


def main(arguments=None):
    """Publish as the command line says.

    Parameters
    ----------
    arguments : list of str, optional
        The words behind the command, by default those of this process.

    Returns
    -------
    int
        0 if every report stands, 1 if a notebook failed, 2 if the command cannot be followed, 130 if interrupted.
    """
    options = _parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, _interrupt)
    clock = time.monotonic()
    try:
        checkout = Checkout.find(notebooks=options.notebooks, reports=options.reports)
        if not checkout.external.is_dir():
            _say(
                "no third-party data (TRUSTLAB_DATA, else data/external, names no folder): sections that need it are left out"
            )
        built = publish(
            options.names,
            checkout=checkout,
            parameters=dict(options.parameters),
            jobs=options.jobs,
            force=options.force,
            report=_say,
            on_failure=_complain,
        )
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\ninterrupted: every kernel is ended, no report is half made", file=sys.stderr)
        return 130
    counts = {state: sum(one.state == state for one in built) for state in ("built", "up to date", "failed")}
    words = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    _say(f"{words}, in {duration(time.monotonic() - clock)}: {checkout.reports / 'index.html'}")
    return 1 if counts["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
