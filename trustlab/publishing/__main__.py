"""
``python -m trustlab.publishing NOTEBOOK CHAPTER``: run a notebook and write the book's chapter.

Make decides from times of change which notebooks are run; Sphinx and MyST-NB make the book.
"""

import argparse
import os
import signal
import sys
import time
from pathlib import Path

# nbformat would load a parser of addresses, which takes a second for each chapter, and not use it.
# Only here: in other processes somebody may.
sys.modules.setdefault("rfc3987_syntax", None)

from trustlab.publishing.chapter import chapter, empty_chapter  # noqa: E402
from trustlab.publishing.parameters import DataAbsentError  # noqa: E402
from trustlab.publishing.run import (  # noqa: E402
    SETTINGS,
    CellError,
    anonymous,
    execute,
    given_parameters,
    provenance,
)


def main(words: list[str] | None = None) -> int:
    """
    Return 0, or 1 if the notebook failed; a wrong command, or a file that cannot be read, exits
    with 2.

    A notebook that fails is a chapter that says so, and nothing else of it; one whose data are
    absent is a chapter that docs/conf.py leaves out. Make runs both again.
    """
    parser = argparse.ArgumentParser(prog="python -m trustlab.publishing", description=__doc__)
    parser.add_argument("notebook", type=Path)
    parser.add_argument("chapter", type=Path)
    parser.add_argument("-p", nargs=2, action="append", default=[], help="a parameter, its value")
    options = parser.parse_args(words)
    # Ctrl-C ends the process at once, and the kernel ends with it; threads would wait.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    root, path = Path.cwd(), options.notebook.resolve()
    data = os.environ.get("TRUSTLAB_DATA") or "data/external"
    os.environ |= SETTINGS | {"TRUSTLAB_DATA": os.path.abspath(data)}
    began, outcome = time.monotonic(), "run"
    try:
        run = execute(path, given_parameters(path, options.p), path.parent)
        page = chapter(run, provenance(root, path, run))
    except DataAbsentError as error:
        outcome = "skipped"
        page = empty_chapter(path, f"**Skipped: {error}**")
    except CellError as error:
        outcome = "failed"
        failure = anonymous(str(error), root)
        page = empty_chapter(path, "**This report failed.** Nothing of it is shown.", failure)
        print(f"\n── {path.stem} failed in {failure}", file=sys.stderr)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    options.chapter.write_text(anonymous(page, root), encoding="utf-8")
    if outcome != "run":  # as if from before everything that it depends on
        os.utime(options.chapter, (0, 0))
    print(f"{path.stem} … {outcome} in {time.monotonic() - began:.1f} s", flush=True)
    return int(outcome == "failed")


if __name__ == "__main__":
    sys.exit(main())
