"""Whole runs on small notebooks, in a checkout of their own."""

import base64
import contextlib
import json
import multiprocessing
import os
import selectors
import signal
import subprocess
import sys
import time
from html.parser import HTMLParser
from unittest import mock

import nbformat
import numpy as np
import psutil
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from trustlab.publishing.__main__ import main
from trustlab.publishing.index_page import held, write_index
from trustlab.publishing.notebooks import publish
from trustlab.publishing.provenance import Checkout, input_digest, list_files
from trustlab.publishing.report_page import page_faults

PICTURE = """from IPython.display import Image, display
import base64, pathlib
display(Image(data=base64.b64decode("%s"), format="png", alt="one dot"))
print("data at", pathlib.Path.cwd().parent / "trustlab" / "a.py")"""
DOT = (
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9aw"
    "AAAABJRU5ErkJggg=="
)


def write(root, name, *cells):
    nbformat.write(new_notebook(cells=list(cells)), root / "notebooks" / f"{name}.ipynb")


def tagged(source, tag):
    cell = new_code_cell(source)
    cell.metadata["tags"] = [tag]
    return cell


def make(root):
    for name in ("notebooks", "trustlab", "data/published"):
        (root / name).mkdir(parents=True)
    (root / "trustlab" / "a.py").write_text("a = 1\n")
    (root / "data" / "published" / "t.csv").write_text("1\n")
    return root


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Build three notebooks, one of which fails, over an earlier report of it."""
    root = make(tmp_path_factory.mktemp("checkout"))
    write(
        root,
        "01_good",
        new_markdown_cell("# A good one\n\nIt shows $a_r$ and succeeds."),
        tagged("seed = 7\nsize = 2\nlevel = 0.5", "parameters"),
        new_code_cell(PICTURE % DOT),
        new_code_cell("print('seed is', seed)"),
    )
    write(
        root,
        "02_bad",
        new_markdown_cell("# A bad one"),
        tagged("x = 0", "parameters"),
        new_code_cell("y = 1 / x"),
    )
    write(root, "03_plain", new_markdown_cell("# A plain one\n\nWords."))
    (root / "reports").mkdir()
    (root / "reports" / "02_bad.html").write_text("old")
    (root / "reports" / "benchmarks.html").write_text("<title>Bench &amp; marks</title>")
    lines, failed = [], []
    checkout = Checkout.find(root)
    built = publish(
        checkout=checkout, parameters={"seed": "5"}, report=lines.append, on_failure=failed.append
    )
    return checkout, built, lines, failed


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))


def test_good_report_is_complete_in_itself(world):
    checkout, built, _, _ = world
    text = (checkout.reports / "01_good.html").read_text()
    tags = Page(text).tags
    names = [tag for tag, _ in tags]
    assert built[0].state == "built"
    assert not page_faults(text)
    assert names.count("script") == 1  # the page's own, by its hash
    assert "'sha256-" in text
    assert "math" in names
    pictures = [attrs for tag, attrs in tags if tag == "img"]
    assert pictures == [{"src": f"data:image/png;base64,{DOT}", "alt": "one dot"}]
    assert ("html", {"lang": "en"}) in tags
    assert "<title>A good one</title>" in text


def test_provenance_and_parameters_are_in_the_report(world):
    checkout, *_ = world
    text = (checkout.reports / "01_good.html").read_text()
    assert 'id="provenance"' in text
    assert "not a git checkout" in text
    assert "data/published/t.csv" in text
    assert "5 <em>(seed)</em> <em>(given for this run)</em>" in text
    assert "seed is 5" in text
    assert "numba" in text


def test_no_path_of_this_machine_is_in_a_report(world):
    checkout, *_ = world
    for page in checkout.reports.glob("*.html"):
        assert str(checkout.root) not in page.read_text()
    assert "data at trustlab/a.py" in (checkout.reports / "01_good.html").read_text()


def test_failing_notebook_leaves_no_report_and_says_where(world):
    checkout, built, lines, failed = world
    assert [one.state for one in built] == ["built", "failed", "built"]
    assert failed == [built[1]]
    assert failed[0].failure["cell"] == 3
    assert failed[0].failure["source"] == "y = 1 / x"
    assert "ZeroDivisionError: division by zero" in failed[0].failure["traceback"]
    assert "\x1b" not in failed[0].failure["traceback"]
    assert not (checkout.reports / "02_bad.html").exists()
    assert any("FAILED in cell 3" in line for line in lines)
    assert any(line.startswith("01_good … built in ") for line in lines)
    assert {path.suffix for path in (checkout.reports / ".build").iterdir()} == {".json"}


def test_index_has_a_card_for_each(world):
    checkout, *_ = world
    text = (checkout.reports / "index.html").read_text()
    assert not page_faults(text)
    assert text.count('<li class="card') == 3
    assert '<a href="01_good.html">A good one</a>' in text
    assert "<math" in text
    assert "data:image/png;base64," in text
    assert "failed in cell 3" in text
    assert 'href="02_bad.html"' not in text
    assert '<a href="./benchmarks.html">Bench &amp; marks</a>' in text
    assert text.count(base64.b64encode(b"\x89PNG")[:4].decode()) >= 1


def test_index_links_the_documentation_where_it_is(tmp_path):
    checkout = Checkout.find(make(tmp_path))
    index = checkout.reports / "index.html"
    with held(checkout, print):
        write_index(checkout, [], "")
        assert "docs/index.html" not in index.read_text()
        (checkout.reports / "docs").mkdir()
        (checkout.reports / "docs" / "index.html").touch()
        write_index(checkout, [], "")
    assert '<a href="docs/index.html">Documentation</a>' in index.read_text()


def test_rebuilt_only_when_an_input_changed(world):
    checkout, *_ = world
    plain = {"names": ["03"], "checkout": checkout}
    assert publish(**plain)[0].state == "up to date"
    assert publish(["01"], checkout=checkout, parameters={"seed": 5})[0].state == "up to date"
    (checkout.package / "a.py").write_text("a = 2\n")
    assert publish(**plain)[0].state == "built"
    assert publish(**plain)[0].state == "up to date"
    assert "older than its inputs" in (checkout.reports / "index.html").read_text()


@pytest.mark.parametrize("value", ["inf", "nan"])
def test_index_is_written_after_a_run_with_a_parameter_that_is_not_finite(world, value):
    checkout, *_ = world
    (checkout.reports / "index.html").unlink()
    given = {"level": value}
    assert publish(["01"], checkout=checkout, parameters=given)[0].state == "built"
    assert f"level = {value}" in (checkout.reports / "index.html").read_text()
    assert publish(["01"], checkout=checkout, parameters=given)[0].state == "up to date"
    assert publish(["01"], checkout=checkout, parameters={"seed": 5})[0].state == "built"


def test_unknown_parameter_is_refused_before_any_run(world, capsys):
    checkout, *_ = world
    words = ["--notebooks", str(checkout.notebooks), "-p", "sed", "1", "--force"]
    before = (checkout.reports / "index.html").stat().st_mtime_ns
    assert main(words) == 2
    said = capsys.readouterr()
    assert "did you mean 'seed'" in said.err
    assert "01_good: seed, size, level" in said.err
    assert "running" not in said.out
    assert (checkout.reports / "index.html").stat().st_mtime_ns == before


def test_command_line_tells_of_failure_and_builds_what_was_deleted(world, capsys):
    checkout, *_ = world
    (checkout.reports / "03_plain.html").unlink()
    assert main(["--notebooks", str(checkout.notebooks), "02", "03_plain"]) == 1
    said = capsys.readouterr()
    assert "03_plain … built" in said.out
    assert (checkout.reports / "03_plain.html").is_file()
    assert "02_bad in cell 3" in said.err
    assert "    y = 1 / x" in said.err
    assert "ZeroDivisionError" in said.err
    assert str(checkout.reports / "index.html") in said.out


def test_kernel_that_dies_is_a_failure_of_its_cell(tmp_path):
    root = make(tmp_path)
    write(root, "01_dies", new_markdown_cell("# Dies"), new_code_cell("import os; os._exit(1)"))
    failure = publish(checkout=Checkout.find(root))[0].failure
    assert failure["cell"] == 2
    assert "The kernel ended" in failure["traceback"]
    assert not (root / "reports" / "01_dies.html").exists()


@pytest.mark.parametrize("package", ["papermill", "nbconvert", "latex2mathml.converter"])
def test_missing_extra_is_named_before_anything_runs(tmp_path, package):
    root = make(tmp_path)
    write(root, "01_a", new_markdown_cell("# A"))
    code = (
        f"import sys; sys.modules[{package!r}] = None\n"
        "from trustlab.publishing.__main__ import main\n"
        f"sys.exit(main(['--notebooks', {str(root / 'notebooks')!r}]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 2
    assert 'pip install "trustlab[reports]"' in done.stderr
    assert package.partition(".")[0] in done.stderr
    assert not (root / "reports").exists()


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_interrupt_leaves_neither_report_nor_kernel(tmp_path):
    root = make(tmp_path)
    write(
        root,
        "01_long",
        new_code_cell(
            "import os, pathlib, "
            "time\npathlib.Path('pid').write_text(str(os.getpid()))\ntime.sleep(1000)"
        ),
    )
    command = [sys.executable, "-m", "trustlab.publishing", "--notebooks", str(root / "notebooks")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    mark = root / "notebooks" / "pid"
    while not (mark.exists() and mark.read_text()) and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130, said
    assert "interrupted" in said
    assert not psutil.pid_exists(int(mark.read_text()))
    assert not list((root / "reports").glob("*.html"))
    assert not list((root / "reports" / ".build").iterdir())


def command(root, *words, **variables):
    """Return the publishing command as a process of its own."""
    line = [
        sys.executable,
        "-m",
        "trustlab.publishing",
        "--notebooks",
        str(root / "notebooks"),
        *words,
    ]
    return subprocess.Popen(
        line,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | variables,
        cwd=root,
    )


def test_two_commands_at_once_and_a_locale_without_an_ellipsis(tmp_path):
    root = make(tmp_path)
    wait = "import pathlib, time\nwhile not pathlib.Path('go').exists(): time.sleep(0.05)"
    write(root, "01_a", new_markdown_cell("# A"), new_code_cell(wait))
    both = [
        command(root, PYTHONIOENCODING="ascii", TRUSTLAB_DATA=str(root / "data")) for _ in range(2)
    ]
    streams = selectors.DefaultSelector()
    for one in both:
        streams.register(one.stdout, selectors.EVENT_READ)
    second = next(iter(streams.select(timeout=300)))[
        0
    ].fileobj  # the first says nothing before its notebook is done
    assert "waiting for its end" in second.readline()
    (root / "notebooks" / "go").touch()
    said = [one.communicate(timeout=300) for one in both]
    assert [one.returncode for one in both] == [0, 0], said
    assert sorted(out.splitlines()[-1].partition(",")[0] for out, _ in said) == [
        "1 built",
        "1 up to date",
    ]
    assert any("01_a ? built in" in out for out, _ in said)


def test_cell_that_takes_longer_than_the_limit_fails_and_its_kernel_ends(tmp_path, capsys):
    root = make(tmp_path)
    write(
        root,
        "01_slow",
        new_code_cell("import os, time; open('pid', 'w').write(str(os.getpid())); time.sleep(60)"),
    )
    assert main(["--notebooks", str(root / "notebooks"), "--timeout", "1"]) == 1
    assert "the cell took longer than 1 s" in capsys.readouterr().err
    assert not psutil.pid_exists(int((root / "notebooks" / "pid").read_text()))
    assert main(["--notebooks", str(root / "notebooks"), "--timeout", "0"]) == 2
    assert "timeout must be positive" in capsys.readouterr().err


def test_what_cannot_be_written_is_a_sentence(tmp_path, capsys):
    root = make(tmp_path)
    write(root, "01_a", new_markdown_cell("# A"))
    words = ["--notebooks", str(root / "notebooks")]
    (root / "reports").write_text(
        "a file where the folder should be"
    )  # as on a read-only file system, root is refused here
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert "--reports" in said
    (root / "reports").unlink()
    (root / "reports").mkdir()
    (root / "reports" / ".01_a.html.partial").symlink_to("/dev/full")
    assert main(words) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert not list((root / "reports").glob("*.html"))
    assert main(words) == 0


@pytest.mark.parametrize(
    "forged",
    [
        "[]",
        "[" * 100_000,
        '{"digest": "DIGEST"}',
        '{"digest": "DIGEST", "failure": "x"}',
        '{"digest": "DIGEST", "seconds": "x", "started": "x", "sentence": "", "thumbnail": "", '
        '"title": ""}',
        '{"digest": "DIGEST", "sources": "", "seconds": 1.0, "started": "x", "parameters": '
        '{}, "thumbnail": "\\"><script>", "title": "<script>1</script>", "sentence": '
        '"<script>1</script>"}',
    ],
)
def test_forged_record_is_built_again(tmp_path, forged):
    root = make(tmp_path)
    write(root, "01_a", new_markdown_cell("# A"))
    checkout = Checkout.find(root)
    (root / "reports" / ".build").mkdir(parents=True)
    (root / "reports" / "01_a.html").write_text("old")
    digest = input_digest(checkout, root / "notebooks" / "01_a.ipynb")
    (root / "reports" / ".build" / "01_a.json").write_text(forged.replace("DIGEST", digest))
    assert publish(checkout=checkout)[0].state == "built"
    assert not page_faults((root / "reports" / "index.html").read_text())


def test_links_in_circles_pipes_and_broken_links_end(tmp_path):
    root = make(tmp_path)
    data = root / "data"
    (data / "a").mkdir()
    (data / "b").mkdir()
    (data / "a" / "x.csv").write_text("1")
    for link, to in {
        "a/b": "b",
        "b/a": "a",
        "up": "..",
        "self": ".",
        "again": "a",
        "gone": "nowhere",
    }.items():
        (data / link).symlink_to(data / to)
    os.mkfifo(data / "pipe")
    found = [path.relative_to(data).as_posix() for path in list_files(data)]
    assert found == ["a/x.csv", "again/x.csv", "b/a/x.csv", "published/t.csv"]


def whole(root):
    """Whether no report is half made: each is a complete page, each record can be read."""
    for page in (root / "reports").glob("*.html"):
        assert page.read_text().rstrip().endswith("</html>"), page
    for record in (root / "reports" / ".build").glob("*.json"):
        json.loads(record.read_text())


def killed(root, delays):
    """
    Kill the command at given times, and check after each what is there, and that the next run
    recovers.
    """
    for delay in delays:
        process = command(root, "--force", "--jobs", "2")
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(delay)
        process.kill()
        process.communicate()
        whole(root)
    checkout = Checkout.find(root)
    assert {one.state for one in publish(checkout=checkout)} <= {"built", "up to date"}
    assert {path.name for path in (root / "reports").iterdir()} == {
        ".build",
        "01_a.html",
        "02_b.html",
        "index.html",
    }
    assert {path.name for path in (root / "reports" / ".build").iterdir()} == {
        "01_a.json",
        "02_b.json",
    }
    assert [one.state for one in publish(checkout=checkout)] == ["up to date"] * 2
    whole(root)


def two_notebooks(tmp_path):
    root = make(tmp_path)
    for name in ("01_a", "02_b"):
        write(root, name, new_markdown_cell("# A\n\nWords."), new_code_cell(PICTURE % DOT))
    return root


def killed_while_writing(root):
    """Kill ten times a process that writes on a slow disk; its notebooks need no run."""
    publish(checkout=Checkout.find(root))
    rng = np.random.default_rng(1)
    context = multiprocessing.get_context("fork")
    for _ in range(10):
        child = context.Process(target=rewrite, args=(root,))
        child.start()
        child.join(rng.uniform(0.05, 0.4))
        child.kill()
        child.join()
        whole(root)
    killed(root, [])


def rewrite(root):
    """Publish again and again, the notebooks as if they had run."""

    def slowly(path, text, encoding):
        with path.open("w", encoding=encoding) as file:
            for start in range(0, len(text), 1 + len(text) // 20):
                file.write(text[start : start + 1 + len(text) // 20])
                file.flush()
                time.sleep(0.002)

    run = mock.patch(
        "trustlab.publishing.execution.execute", lambda path, *_: nbformat.read(path, as_version=4)
    )
    with run, mock.patch("pathlib.Path.write_text", slowly):
        while True:
            publish(checkout=Checkout.find(root), force=True)


@pytest.mark.slow
def test_ten_kills_leave_nothing_half_made(tmp_path):
    killed_while_writing(two_notebooks(tmp_path))


@pytest.mark.slow
def test_the_kills_find_a_write_that_is_not_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "trustlab.publishing.index_page.replace_file",
        lambda path, text: path.write_text(text, encoding="utf-8"),
    )
    with pytest.raises((AssertionError, json.JSONDecodeError)):
        killed_while_writing(two_notebooks(tmp_path))


@pytest.mark.long
def test_a_hundred_kills_of_the_command_leave_nothing_half_made(tmp_path):
    killed(two_notebooks(tmp_path), np.random.default_rng(2).uniform(0.5, 6.0, 100))
