"""
``python -m trustlab.publishing NOTEBOOK CHAPTER``: run a notebook and write the book's chapter.

Make decides from times of change which notebooks are run; Sphinx and MyST-NB make the book.
"""

import argparse
import os
import signal
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

from trustlab.models.files import write_atomically
from trustlab.publishing.chapter import chapter, empty_chapter
from trustlab.publishing.parameters import DataAbsentError
from trustlab.publishing.provenance import external_data, provenance
from trustlab.publishing.run import (
    SETTINGS,
    CellError,
    anonymous,
    chosen_parameters,
    declared_parameters,
    execute,
)


def main(words: list[str] | None = None) -> int:
    """
    Return 0, 1 if the notebook failed, 2 for a wrong command, 130 if interrupted.

    A notebook that fails is a chapter that says so, and nothing else of it; Make runs it again.
    """
    parser = argparse.ArgumentParser(prog="python -m trustlab.publishing", description=__doc__)
    parser.add_argument("notebook", type=Path)
    parser.add_argument("chapter", type=Path)
    parser.add_argument(
        "-p",
        nargs=2,
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        help="a parameter, for the notebooks that declare it",
    )
    options = parser.parse_args(words)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does
    root, path = Path.cwd(), options.notebook.resolve()
    os.environ |= SETTINGS
    if external_data(root).is_dir():
        os.environ["TRUSTLAB_DATA"] = str(external_data(root))
    began, skipped = time.monotonic(), False
    failure = ""
    started = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    try:
        parameters = chosen_parameters(path, options.p)
        run = execute(path, parameters, path.parent)
        values = declared_parameters(path) | parameters
        origin = provenance(root, path, values) | {"Started": started}
        origin["Time taken"] = f"{time.monotonic() - began:.1f} s"
        page = chapter(run, origin)
    except DataAbsentError as error:
        page = empty_chapter(path, f"**Skipped: {error}**")
        skipped = True
    except CellError as error:
        failure = anonymous(str(error), root)
        page = empty_chapter(path, "**This report failed.** Nothing of it is shown.", failure)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"interrupted: {path.stem} is not half made", file=sys.stderr, flush=True)
        os._exit(130)  # the kernel ends with the process that started it; threads would wait
    write_atomically(options.chapter, anonymous(page, root))
    if failure or skipped:  # as if from before everything that it depends on
        os.utime(options.chapter, (0, 0))
    word = "failed" if failure else "skipped" if skipped else "run"
    print(f"{path.stem} … {word} in {time.monotonic() - began:.1f} s", flush=True)
    if failure:
        print(f"\n── {path.stem} failed in {failure}", file=sys.stderr)
    return int(bool(failure))


if __name__ == "__main__":
    sys.exit(main())
