"""Folders of logs: which files, in which order, with which header. Oracle: the files laid out."""

import pytest

from tests.cases import refused
from tests.sessions.logs import table_recipe
from trustlab.sessions import read_session, read_sessions
from trustlab.sessions.folders import logs_in

TABLE = "t,a\n0,0.5\n1,0.5\n"
COLUMNS = '[columns]\np_r = { column = "a" }\n'
INDEXED = f"""[files]
pattern = "p{{who:int}}/run{{trial:int}}.csv"
[header]
file = "p{{who}}/runs.csv"
keys = {{ trial = "run" }}
{COLUMNS}r = {{ from = "header.share", unit = "%" }}
beta = {{ from = "header.level", map = {{ low = 0.1, high = 0.9 }} }}
[metadata]
participant = {{ from = "who" }}
trial = {{ from = "trial" }}
"""
RUNS = (1, 2, 10)
HEADER = "run, share,level\n1,10,low\n2,20,low\n10,30,high\n"


def lay(folder, names, text=TABLE):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def lay_people(folder, *people):
    for who in people:
        lay(folder / f"p{who}", [f"run{run}.csv" for run in RUNS])
        lay(folder / f"p{who}", ["runs.csv"], HEADER)


def runs(sessions):
    return [(each.metadata.participant, each.metadata.more["trial"]) for each in sessions]


@pytest.mark.parametrize("below", [".", "study"])
def test_files_are_found_at_any_depth_and_ordered_by_number(tmp_path, monkeypatch, below):
    lay_people(tmp_path / "study" / "raw", 9, 10)
    recipe = table_recipe(INDEXED)
    sessions = read_sessions(tmp_path / below, recipe)
    assert runs(sessions) == [(who, run) for who in (9, 10) for run in RUNS]
    assert [each["r"][0] for each in sessions] == pytest.approx([0.1, 0.2, 0.3] * 2)
    assert [each["beta"][0] for each in sessions] == [0.1, 0.1, 0.9] * 2
    monkeypatch.chdir(tmp_path / "study" / "raw" / "p9")
    assert runs(read_sessions(".", recipe)) == [(9, 1), (9, 2), (9, 10)]
    assert read_session("run10.csv", recipe).metadata.more["trial"] == 10


def test_a_header_above_the_folder_names_other_sessions_too(tmp_path):
    lay_people(tmp_path / "raw", 9, 10)
    rows = "".join(f"{who},{run},10,low\n" for who in (9, 10) for run in RUNS)
    (tmp_path / "raw" / "index.csv").write_text("who,run,share,level\n" + rows)
    text = INDEXED.replace("p{who}/runs", "index").replace("keys = {", 'keys = { who = "who",')
    assert len(read_sessions(tmp_path / "raw", table_recipe(text))) == 6
    assert len(read_sessions(tmp_path / "raw" / "p9", table_recipe(text))) == 3


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (HEADER + "11,10,low\n", r"runs\.csv: names run 11, which has no file"),
        (HEADER.replace("run,", "rum,"), r"runs\.csv: needs one column 'run'; did you mean 'rum'"),
        (HEADER.replace("1,10,low", "1,,low"), r"run1\.csv.*no header\.share, or it is empty"),
        (None, r"runs\.csv: this header file cannot be read"),
    ],
)
def test_headers_and_files_correspond(tmp_path, header, words):
    lay_people(tmp_path, 9)
    path = tmp_path / "p9" / "runs.csv"
    path.write_text(header) if header else path.unlink()
    with refused(words):
        read_sessions(tmp_path, table_recipe(INDEXED))


def test_a_pattern_that_nothing_fits_names_what_is_there(tmp_path):
    lay(tmp_path, ["vpA.csv"])
    recipe = table_recipe(f'[files]\npattern = "vp{{participant:int}}.csv"\n{COLUMNS}')
    with refused(r"pattern '[^']*' \(there are .*vpA\.csv"):
        read_sessions(tmp_path, recipe)


def test_faults_are_raised_or_collected(tmp_path):
    lay(tmp_path, ["p10.csv", "p1.csv"], "t,p_r\n0,1\n1,2\n")
    lay(tmp_path, ["p2.csv", "notes.txt"], "t,p_r\n0,1\n1,x\n")
    sessions = read_sessions(tmp_path, on_error="collect")
    assert [each.metadata.source for each in sessions] == [f"{tmp_path}/p{k}.csv" for k in (1, 10)]
    assert sessions.faults["file"].tolist() == [str(tmp_path / "p2.csv")]
    assert "line 3, column 'p_r': 'x' is not" in sessions.faults["error"][0]
    with refused(r"p2\.csv: line 3"):
        read_sessions(tmp_path)


def test_a_doubt_about_many_files_is_told_once(tmp_path, recwarn):
    lay(tmp_path, [f"p{k}.csv" for k in range(15)], "t,p_r,p_h\n0,50,60\n1,70,80\n")
    assert len(read_sessions(tmp_path)) == 15
    start = f"{tmp_path / 'p0.csv'} (and 14 more of the files): column "
    for each, name in zip(recwarn.list, ("p_r", "p_h"), strict=True):
        assert str(each.message).startswith(start + name)
        assert each.filename == __file__


# Files being made, and those of JupyterLab, macOS and Excel.
NONE = [".trustlab-host-1-x/run1.csv", "run3.csv.partial-1"]
NONE += [".ipynb_checkpoints/run4.csv", "._run5.csv", "~$run6.csv"]


def test_files_being_written_and_loops_are_no_sessions(tmp_path):
    lay(tmp_path, ["run2.csv", *NONE])
    (tmp_path / "loop").symlink_to(tmp_path)
    recipe = table_recipe(f'[files]\npattern = "*run{{k:int}}.csv*"\n{COLUMNS}')
    sources = [each.metadata.source for each in read_sessions(tmp_path, recipe)]
    assert sources == [str(tmp_path / "run2.csv")]
    assert logs_in(str(tmp_path)) == sources
    (tmp_path / "run4.csv").symlink_to(tmp_path / "run4.csv")
    with refused(r"run4\.csv: there is no file at this path"):
        read_sessions(tmp_path, recipe)


@pytest.mark.parametrize("name", ["p9", "p11"])
def test_folders_that_are_links_are_read_and_no_folder_twice(tmp_path, name):
    """They were left out without a word."""
    (tmp_path / "study").mkdir()
    lay_people(tmp_path / "disk", name[1:])
    lay_people(tmp_path / "study", 10)
    (tmp_path / "study" / name).symlink_to(tmp_path / "disk" / name)
    links = {"loop": tmp_path, "a latest": tmp_path / "study" / "p10", "up/loop": tmp_path / "disk"}
    (tmp_path / "study" / "up").mkdir()
    for link, target in links.items():
        (tmp_path / "study" / link).symlink_to(target)
    (tmp_path / "disk" / name / "loop").symlink_to(tmp_path / "disk")
    sessions = read_sessions(tmp_path / "study", table_recipe(INDEXED))
    assert runs(sessions) == [(who, run) for who in sorted([10, int(name[1:])]) for run in RUNS]
