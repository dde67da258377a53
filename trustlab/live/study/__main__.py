"""
``python -m trustlab.live.study DIR``: serve the study that a folder holds, or one of C1 to C5 where
it holds none.
"""

import argparse
import sys
from pathlib import Path

from trustlab.live.study.plan import PLAN, LiveStudy


def main(words: list[str] | None = None) -> int:
    """Do what the command line says; return 0, or 2 where it cannot be done."""
    parser = argparse.ArgumentParser(prog="python -m trustlab.live.study", description=__doc__)
    parser.add_argument(
        "folder",
        metavar="DIR",
        help="the study's folder; without a study in it, C1 to C5 with 20 participants are planned",
    )
    parser.add_argument("--port", type=int, default=8765, help="port (default: 8765)")
    parser.add_argument("--url", default="", help="address of a proxy, as for LiveStudy.serve")
    parser.add_argument("--enrol", action="store_true", help="let people join by one link")
    options = parser.parse_args(words)
    try:
        new = not (Path(options.folder) / PLAN).exists()
        plan = LiveStudy(options.folder) if new else LiveStudy.open(options.folder)
        if new:
            print(
                "A new study: C1 to C5, 20 participants, seed 0. For another one, plan it with "
                "trustlab.LiveStudy first."
            )
        plan.serve(port=options.port, url=options.url, enrol=options.enrol)
    except (ModuleNotFoundError, ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
