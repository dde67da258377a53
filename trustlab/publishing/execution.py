"""One notebook, run by papermill in a kernel of its own, and what went wrong in it."""

import contextlib
import os
import re
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

from trustlab.models.extras import extra
from trustlab.publishing.provenance import Checkout

with extra("reports"):
    import nbformat
    import papermill
    from jupyter_client.manager import AsyncKernelManager
    from nbclient.exceptions import CellTimeoutError
    from nbconvert.filters import strip_ansi
    from nbformat import NotebookNode
    from papermill.exceptions import PapermillExecutionError

# Libraries told to sum in one thread: with more, the last digits differ from machine to machine.
ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


class Kernels:
    """
    The kernels of one command: started in one folder and environment, and ended together when it is
    interrupted.
    """

    def __init__(self, checkout: Checkout, threads: int):
        self.running: list[AsyncKernelManager] = []
        self.ended = False
        self.folder = checkout.notebooks
        defaults = dict.fromkeys(ONE_THREAD, "1") | {"NUMBA_NUM_THREADS": str(threads)}
        self.environment = defaults | os.environ  # what the user has set stays
        self.environment |= {"PYTHONHASHSEED": "0", "TRUSTLAB_REPORT": "1"}
        self.environment["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
        if "TRUSTLAB_DATA" in os.environ or checkout.external.is_dir():
            self.environment["TRUSTLAB_DATA"] = str(checkout.external)

    def manager(self, scratch: str) -> type[AsyncKernelManager]:
        """
        Return the class that starts a kernel of this command; its sockets lie in the folder
        `scratch`.
        """
        kernels = self

        class Manager(AsyncKernelManager):
            def __init__(self, **options: Any):
                super().__init__(**options)
                self.connection_file = str(Path(scratch, "kernel.json"))
                # Sockets in a folder: kernels that start at the same time now and then take the
                # same ports.
                self.transport, self.ip = "ipc", str(Path(scratch, "kernel"))

            # The parent's is an alias, which mypy takes for another signature.
            async def start_kernel(self, **options: Any) -> None:  # type: ignore[override]
                own = {"IPYTHONDIR": str(Path(scratch, "ipython"))}  # nobody's own start-up files
                options |= {"cwd": str(kernels.folder), "env": kernels.environment | own}
                # At its end a kernel is interrupted first, and would log that as an error.
                options["extra_arguments"] = [
                    *options.get("extra_arguments", []),
                    "--log-level=CRITICAL",
                ]
                kernels.running.append(self)
                await super().start_kernel(**options)
                if kernels.ended:  # interrupted while this kernel started
                    kernels.end()

        return Manager

    def end(self) -> None:
        """End every kernel at once, with the processes that it started."""
        self.ended = True
        for manager in self.running:
            group = getattr(
                manager.provisioner, "pgid", None
            )  # each kernel leads a group of processes
            if manager.has_kernel and group:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(group, signal.SIGKILL)


class CellError(ValueError):
    """
    A notebook that failed: what happened, the index of its cell, that cell's source, and the
    traceback.
    """

    def __init__(self, words: str, cell: int | None = None, source: str = "", traceback: str = ""):
        super().__init__(strip_ansi(words).strip())
        self.cell, self.source = cell, source
        self.traceback = strip_ansi(traceback or words).strip()


def execute(
    path: Path, parameters: dict, kernels: Kernels, timeout: float | None = None
) -> NotebookNode:
    """Run a notebook, each cell at most `timeout` seconds, and return it with its outputs."""
    reached: list[tuple[int | None, str]] = [(None, "")]
    # A socket's path has some 100 characters at most; macOS's own folder for temporary files is
    # long.
    with tempfile.TemporaryDirectory(prefix="tl-", dir="/tmp") as scratch:
        try:
            return papermill.execute_notebook(
                nbformat.read(path, as_version=4),
                None,
                parameters=parameters,
                kernel_name="python3",
                language="python",
                progress_bar=False,
                execution_timeout=timeout,
                kernel_manager_class=kernels.manager(scratch),
                on_cell_execute=lambda cell, cell_index: reached.append((cell_index, cell.source)),
            )
        except PapermillExecutionError as error:
            words, traceback = f"{error.ename}: {error.evalue}", "\n".join(error.traceback)
            raise CellError(words, error.cell_index, error.source, traceback) from error
        except CellTimeoutError:
            raise CellError(
                f"the cell took longer than {timeout:g} s, the time limit", *reached[-1]
            ) from None
        except Exception as error:  # the kernel died, or never came up
            words = f"{type(error).__name__}: {error}"
            more = f"{words}\nThe kernel ended before the cell did (out of memory?)."
            raise CellError(words, *reached[-1], more) from error


def anonymous(text: str, checkout: Checkout) -> str:
    """Return a page or an error message with the paths of this machine replaced."""
    places = {
        checkout.external: "TRUSTLAB_DATA",
        checkout.root: ".",
        checkout.package.parent: ".",
        sys.prefix: ".venv",
        sys.base_prefix: "python",
        Path.home(): "~",
        tempfile.gettempdir(): "temporary",
    }
    words = {f"{place}/": f"{name}/".removeprefix("./") for place, name in places.items()}
    words |= {str(place): name for place, name in list(places.items())[:2]}
    longest_first = sorted(
        (re.escape(word) for word in words if len(word) > 2), key=len, reverse=True
    )
    # Embedded pictures come first and stay as they are: base64 may spell anything. A path begins
    # where nothing of it stands before: else the time would grow with the square of a long word's
    # length.
    cell = r"(?P<cell>(?<![\w.@+~/-])[\w.@+~/-]*ipykernel_\d+/\d+\.py)"
    pattern = "|".join([r"data:image/[^\"]*", cell, *longest_first])

    def named(match: re.Match[str]) -> str:
        return "this notebook" if match["cell"] else words.get(match[0], match[0])

    return re.sub(pattern, named, text)
